# SPDX-License-Identifier: Apache-2.0
"""What a user may set. Values out of range raise InputError where they are made, not where they are used."""

from __future__ import annotations

import difflib
import enum
import math
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from .errors import InputError
from .light_paths import LIGHT_PATH_RANGES, LightPaths

METHODS = ("svgf+", "svgf", "eaw", "none")
SIGNALS = ("diffuse_specular", "direct_indirect")
PIXEL_FILTERS = ("auto", "box", "center")


class PlusStep(enum.IntFlag):
    """Bits of DenoiseSettings.steps; PlusStep in backend/native/denoise/settings.h says what they are."""

    LOCAL_MEAN = 1
    STRUCTURE = 2
    BOTH_VARIANCES = 4
    GLOSS = 8
    HAND_OVER = 16
    HISTORY = 32
    TESTED_TAPS = 64
    INTERPOLATION = 128
    PLANE_SLOPE = 256
    MEAN_DRIFT = 512
    PREFILTER = 1024
    CATMULL_ROM = 2048


def _setting(
    default: float, minimum: float, maximum: float, meaning: str, *, unit: str = "", symbol: str = ""
) -> Any:
    """A field that knows its range (inclusive), unit, symbol in the paper and meaning."""
    return field(
        default=default,
        metadata={"minimum": minimum, "maximum": maximum, "unit": unit, "symbol": symbol, "meaning": meaning},
    )


@dataclass(frozen=True)
class DenoiseSettings:
    """How to denoise. The same list as backend/native/denoise/settings.h; each field's metadata holds its minimum,
    maximum (inclusive), unit, symbol in the paper and meaning. Symbols are those of [Schied17]; eaw_*: of [Dammertz10].

    Raises InputError naming the field and its range.
    """

    alpha: float = _setting(
        0.2, 0.0, 1.0,
        "Least weight of the new frame in the temporal mean of colour; 0 keeps the plain mean of all frames.",
        symbol="alpha",
    )  # fmt: skip
    alpha_moments: float = _setting(
        0.2, 0.0, 1.0, "Least weight of the new frame in the temporal moments of luminance.", symbol="alpha"
    )
    sigma_depth: float = _setting(
        1.0, 0.0, 1e6, "Depth differences that the depth gradient does not explain: larger blurs across them.",
        symbol="sigma_z",
    )  # fmt: skip
    sigma_normal: float = _setting(
        128.0, 1e-3, 1e6, "Exponent of the cosine between normals: smaller blurs across creases.", symbol="sigma_n"
    )
    sigma_luminance: float = _setting(
        4.0, 0.0, 1e6, "Luminance differences that count as noise: larger blurs more.",
        unit="standard deviations", symbol="sigma_l",
    )  # fmt: skip
    levels: int = _setting(
        5, 0, 8, "Levels of the a-trous wavelet transform; level i has taps 2^i pixels apart.", symbol="i"
    )
    spatial_variance_frames: int = _setting(
        4, 1, 64, "Variance is estimated over 7x7 pixels while history is shorter than this.", unit="frames"
    )
    depth_tolerance: float = _setting(
        0.02, 0.0, 1.0, "Reprojection accepts history whose plane misses the expected depth by at most this.",
        unit="share of depth",
    )  # fmt: skip
    normal_tolerance: float = _setting(
        0.9, -1.0, 1.0, "Reprojection accepts history whose normal has at least this cosine with the new one.",
        unit="cosine",
    )  # fmt: skip
    history_frames: float = _setting(
        20.0, 1.0, 4096.0,
        "svgf+: longest history where something moves; what stands still has no limit.", unit="frames",
    )  # fmt: skip
    history_seconds: float = _setting(
        0.0, 0.0, 3600.0,
        "svgf+: the same in seconds, so that lag is the same at any frame_rate. 0: history_frames counts.",
        unit="s",
    )  # fmt: skip
    frame_rate: float = _setting(
        24.0, 0.01, 1e5,
        "svgf+: frames in a second of the sequence, or of a view as it is drawn, for history_seconds.",
        unit="frames/s",
    )  # fmt: skip
    history_clamp: float = _setting(
        3.0, 0.0, 1e6,
        "svgf+: how far history may be from the 3x3 new samples before it is drawn to them. 1e6: however far.",
        unit="standard deviations",
    )  # fmt: skip
    specular_history_clamp: float = _setting(
        0.4, 0.0, 1e6, "svgf+: the same of the specular signal, which moves otherwise than its surface.",
        unit="standard deviations",
    )  # fmt: skip
    change_threshold: float = _setting(
        0.2, 1e-3, 1e6,
        "svgf+: samples this far from history, over a few frames and pixels, are a change. 1e6: nothing is.",
        unit="standard deviations",
    )  # fmt: skip
    specular_change_threshold: float = _setting(
        0.3, 1e-3, 1e6,
        "svgf+: the same of the specular signal, whose deviation leaves out what looks like structure.",
        unit="standard deviations",
    )  # fmt: skip
    history_fix_radius: int = _setting(
        16, 1, 256,
        "svgf+: how far around what has just appeared its surface is looked for a frame ago. 1: beside it.",
        unit="pixels",
    )  # fmt: skip
    firefly_limit: float = _setting(
        60.0, 1.0, 1e9,
        "svgf+: brightest sample, over what history and neighbours say; what is above is cut. 1e9: nothing.",
    )  # fmt: skip
    specular_sharpness: float = _setting(
        1.4, 1.0, 1e3, "svgf+: the specular signal is filtered as if sigma_luminance were smaller by this."
    )
    plus_sigma_luminance: float = _setting(
        4.5, 0.0, 1e6, "svgf+: luminance differences that count as noise; larger blurs more.",
        unit="standard deviations of the mean", symbol="sigma_l",
    )  # fmt: skip
    plus_sigma_depth: float = _setting(
        3.0, 0.0, 1e6, "svgf+: depth differences that the depth gradient does not explain: larger blurs across them.",
        symbol="sigma_z",
    )  # fmt: skip
    plus_sigma_normal: float = _setting(
        20.0, 1e-3, 1e6, "svgf+: sharpness of the lobe around the normal; smaller blurs across creases.",
        symbol="sigma_n",
    )  # fmt: skip
    antialias_frames: float = _setting(
        4.0, 1.0, 1024.0, "svgf+: frames over which the picture is resolved where something moves. 1: not at all.",
        unit="frames",
    )  # fmt: skip
    steps: int = _setting(
        4095, 0, 4095,
        "svgf+: a bit for each step that no other setting switches off, to measure what it gives; see PlusStep.",
    )  # fmt: skip
    eaw_sigma_color: float = _setting(
        4.0, 1e-6, 1e6, "Colour differences that count as noise at level 0; halved at each level.",
        unit="demodulated radiance", symbol="sigma_rt",
    )  # fmt: skip
    eaw_sigma_normal: float = _setting(
        0.3, 1e-6, 1e6, "Distance between normals, over the tap spacing, that the filter crosses.", symbol="sigma_n"
    )
    eaw_sigma_position: float = _setting(
        0.3, 1e-6, 1e6, "Distance between world positions that the filter crosses.", unit="m", symbol="sigma_x"
    )

    def __post_init__(self) -> None:
        for item in fields(self):
            _check_number(
                f"DenoiseSettings.{item.name}",
                getattr(self, item.name),
                item.metadata["minimum"],
                item.metadata["maximum"],
                whole=item.type == "int",
            )

    @classmethod
    def from_dict(cls, values: dict[str, float]) -> DenoiseSettings:
        """The inverse of ``as_dict``; fields that are not given keep their defaults. InputError for unknown names."""
        names = [item.name for item in fields(cls)]
        for name in values:
            if name not in names:
                raise InputError(f'There is no denoise setting "{name}".', _suggestion(name, names))
        return cls(**values)

    def as_dict(self) -> dict[str, float]:
        return asdict(self)

    def has(self, step: PlusStep) -> bool:
        return bool(self.steps & step)

    @property
    def longest_history(self) -> float:
        """svgf+: in frames, where something moves."""
        if self.history_seconds <= 0.0:
            return self.history_frames
        return min(max(self.history_seconds * self.frame_rate, 1.0), 4096.0)


@dataclass(frozen=True)
class Settings:
    """How to render. Raises InputError naming the field and its range.

    width, height: pixels, >= 1; None: the scene's. bounces: light bounces after the first hit, >= 0 (0: direct light
    only); None: the scene's. samples: paths per pixel and frame, >= 1. seed: of the random numbers, [0, 2^32).
    method: "svgf+" (ours), "svgf" [Schied17], "eaw" [Dammertz10] or "none". signals: "diffuse_specular" or
    "direct_indirect", what is filtered apart. pixel_filter: "box" (the mean over the pixel), "center" (its middle) or
    "auto": center for the papers' methods, whose edges flicker where a G-buffer jitters, else box. exposure: factor on
    radiance, >= 0;
    None: the scene's. diffuse_bounces ... filter_glossy: see ``LightPaths``; None: the scene's. transparent_film: the
    world is left out behind the scene; None: the scene's. denoise: DenoiseSettings. diagnostics: also make the images
    of ``svgf.diagnostics``.
    """

    width: int | None = None
    height: int | None = None
    bounces: int | None = None
    samples: int = 1
    seed: int = 0
    method: str = "svgf+"
    signals: str = "diffuse_specular"
    pixel_filter: str = "auto"
    exposure: float | None = None
    diffuse_bounces: int | None = None
    glossy_bounces: int | None = None
    transmission_bounces: int | None = None
    transparent_bounces: int | None = None
    reflective_caustics: bool | None = None
    refractive_caustics: bool | None = None
    clamp_direct: float | None = None
    clamp_indirect: float | None = None
    filter_glossy: float | None = None
    transparent_film: bool | None = None
    denoise: DenoiseSettings = field(default_factory=DenoiseSettings)
    diagnostics: bool = False

    def __post_init__(self) -> None:
        for name, minimum, maximum in (
            ("width", 1, 65536),
            ("height", 1, 65536),
            ("bounces", 0, 1024),
            ("samples", 1, 2**31 - 1),
            ("seed", 0, 2**32 - 1),
        ):
            value = getattr(self, name)
            if value is not None or name in ("samples", "seed"):
                _check_number(f"Settings.{name}", value, minimum, maximum, whole=True)
        if self.exposure is not None:
            _check_number("Settings.exposure", self.exposure, 0.0, 1e6, whole=False)
        for name, (minimum, maximum) in LIGHT_PATH_RANGES.items():
            value = getattr(self, name)
            if value is not None:
                _check_number(f"Settings.{name}", value, minimum, maximum, whole=isinstance(maximum, int))
        if self.diagnostics not in (True, False):
            raise InputError(f"Settings.diagnostics is {self.diagnostics!r}.", "Give True or False.")
        for name in ("reflective_caustics", "refractive_caustics", "transparent_film"):
            if getattr(self, name) not in (None, True, False):
                raise InputError(f"Settings.{name} is {getattr(self, name)!r}.", "Give True, False or None.")
        check_name("Settings.method", self.method, METHODS)
        check_name("Settings.signals", self.signals, SIGNALS)
        check_name("Settings.pixel_filter", self.pixel_filter, PIXEL_FILTERS)
        if not isinstance(self.denoise, DenoiseSettings):
            raise InputError(
                f"Settings.denoise is a {type(self.denoise).__name__}.", "Give a svgf.DenoiseSettings (svgf.settings)."
            )

    def light_paths(self, of_scene: LightPaths) -> LightPaths:
        """The scene's, with what is set here."""
        own = {item.name: getattr(self, item.name) for item in fields(LightPaths)}
        return replace(of_scene, **{name: value for name, value in own.items() if value is not None})

    @property
    def resolved_pixel_filter(self) -> str:
        """pixel_filter with "auto" decided."""
        if self.pixel_filter != "auto":
            return self.pixel_filter
        return "box" if self.method in ("none", "svgf+") else "center"


def check_name(what: str, name: Any, names: tuple[str, ...]) -> None:
    """Raises InputError unless name is one of names; the hint lists them and says which one was probably meant."""
    if name not in names:
        raise InputError(f"{what} is {name!r}.", _suggestion(name, names))


def _suggestion(name: Any, names: tuple[str, ...] | list[str]) -> str:
    close = difflib.get_close_matches(str(name), names, n=1)
    listed = f"Choose one of {', '.join(names)}."
    return f'Did you mean "{close[0]}"? {listed}' if close else listed


def _check_number(what: str, value: Any, minimum: float, maximum: float, *, whole: bool) -> None:
    kind = "a whole number" if whole else "a number"
    hint = f"Give {kind} from {minimum:g} to {maximum:g}." if maximum < 1e6 else f"Give {kind} of at least {minimum:g}."
    if isinstance(value, bool) or not hasattr(value, "__float__" if not whole else "__index__"):
        raise InputError(f"{what} is {value!r}.", hint)
    if not math.isfinite(value) or not minimum <= value <= maximum:
        raise InputError(f"{what} is {value!r}.", hint)
