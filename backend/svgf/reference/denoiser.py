# SPDX-License-Identifier: Apache-2.0
"""The denoiser in float64: the order of the stages, and what goes from one frame to the next.

    method   stages
    svgf+    demodulate -> temporal -> atrous x levels -> modulate -> antialias     ours
    svgf     demodulate -> temporal -> variance -> atrous x levels -> modulate      [Schied17]
    eaw      demodulate -> atrous x levels -> modulate                              [Dammertz10]
    none     demodulate -> modulate
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..errors import InputError
from ..settings import METHODS, DenoiseSettings, PlusStep, check_name
from .antialias import Resolved, antialias
from .atrous import atrous, atrous_plus, edge_avoiding
from .demodulate import ALBEDO_FLOOR, demodulate, repair, signal_albedo
from .diagnose import motion_error, repaired_values, reset_reason
from .device import Device
from .guides import Guides, gloss_of, in_range, luminance, namespace, repair_guides
from .modulate import modulate
from .reprojection import reproject
from .resample import resample
from .temporal import History, temporal
from .temporal_plus import Fireflies, HistoryPlus, temporal_plus
from .variance import variance

# Every signal that can be denoised, and the albedos whose sum it is divided by.
SIGNAL_ALBEDOS = {
    "diffuse": ("diffuse_albedo",),
    "specular": ("specular_albedo",),
    "direct": ("diffuse_albedo", "specular_albedo"),
    "indirect": ("diffuse_albedo", "specular_albedo"),
    "color": ("albedo",),
}
MAX_SIGNALS = 2
# Blender's default camera on a square image; only "eaw" reads the window.
DEFAULT_WINDOW = (-0.36, 0.36, -0.36, 0.36)


class Denoiser:
    """Same methods as the native class. device: keeps the timings, may be None. settings: the fields of
    DenoiseSettings that differ from the defaults. Images may be numpy or CuPy arrays; results are float64 arrays of
    the same library.

    history, resolved: what the next frame starts from, None before the first.
    """

    def __init__(
        self, device: Any, width: int, height: int, method: str = "svgf+", settings: dict[str, float] | None = None
    ) -> None:
        check_name("Denoiser method", method, METHODS)
        self._device = device or Device()
        self.width, self.height, self.method = width, height, method
        self.settings = DenoiseSettings.from_dict(settings or {})
        self.history: History | HistoryPlus | None = None
        self.resolved: Resolved | None = None
        self._repaired = 0
        self._fireflies = Fireflies(0, 0.0)

    def set_settings(self, settings: dict[str, float]) -> None:
        """Takes effect at the next frame; history stays."""
        self.settings = DenoiseSettings.from_dict(settings)

    def resize(self, width: int, height: int) -> None:
        """The next frame is of another size; history goes on in it."""
        if self.history is not None:
            with self._device.stage("resample"):
                object_id = self.history.guides.object_id
                self.history = resample(self.history, object_id, width, height)
                self.resolved = self.resolved and resample(self.resolved, object_id, width, height)
        self.width, self.height = width, height

    def repaired(self) -> int:
        """How many values of the last frame's images and history were no numbers or out of range."""
        return self._repaired

    def fireflies(self) -> tuple[int, float]:
        """How many samples of the last frame svgf+ scaled down, and the luminance over albedo that was cut, summed."""
        return self._fireflies.samples, self._fireflies.light

    def history_images(self) -> dict[str, Any]:
        """As ``svgf.Denoiser.history``."""
        if self.history is None:
            return {}
        frames = self.history.frames if self.method == "svgf+" else []
        return {**_numbered("color", self.history.color), **_numbered("frames", frames)}

    def denoise(
        self,
        inputs: dict[str, Any],
        reset: bool = False,
        diagnostics: bool = False,
        unchanged: bool = False,
        interactive: bool = False,
    ) -> dict[str, Any]:
        """inputs: images as ``svgf.Denoiser.denoise`` takes them, and optionally `window`; others are not read.

        reset: forget the history first. unchanged: what is seen, its light and the camera, for as many frames as svgf+
        takes to settle. interactive: someone works in the view, which shows no noise meanwhile. Returns color
        [H, W, 3], variance [H, W] and history_length [H, W]; with diagnostics, also the images of
        ``svgf.diagnostics``.
        """
        signals = [name for name in SIGNAL_ALBEDOS if name in inputs]
        if reset or (self.history is not None and len(self.history.color) != len(signals)):
            self.history = self.resolved = None
        timed = self._device.stage
        with timed("demodulate"):
            color, albedo, guides, repaired = self._demodulate(inputs, signals)
        xp = namespace(guides.depth)
        before, fireflies = self.history, Fireflies(0, 0.0, xp.zeros(guides.depth.shape))
        spread = None
        length = guides.surface.astype(xp.float64)
        if self.method == "svgf+":
            with timed("temporal"):
                self.history, spread, fireflies, count = temporal_plus(
                    color, _specular(signals), guides, inputs.get("motion"), self.history, self.settings,
                    _with_reflections(signals), unchanged, [a.max(axis=-1) <= ALBEDO_FLOOR for a in albedo],
                )  # fmt: skip
            repaired += count
            color = self.history.color
            roughness = inputs.get("roughness") if self.settings.has(PlusStep.GLOSS) else None
            gloss, bad = _gloss(signals, roughness, guides)
            repaired += bad
            length = xp.minimum.reduce(self.history.frames)
            for level in range(self.settings.levels):
                with timed("atrous"):
                    color, spread = atrous_plus(color, spread, gloss, guides, level, self.settings)
            self.history = replace(self.history, filtered=[luminance(c) for c in color])
        elif self.method == "svgf":
            with timed("temporal"):
                new, count = temporal(color, guides, inputs.get("motion"), self.history, self.settings)
            repaired += count
            color, length = new.color, new.length
            with timed("variance"):
                spread = variance(new.moments, new.length, guides, self.settings)
            self.history = new
            for level in range(self.settings.levels):
                with timed("atrous"):
                    color, spread = atrous(color, spread, guides, level, self.settings)
                if level == 0:
                    self.history = replace(new, color=color)  # [Schied17, Sec. 4.3]
        elif self.method == "eaw":
            for level in range(self.settings.levels):
                with timed("atrous"):
                    color = edge_avoiding(color, guides, inputs.get("window", DEFAULT_WINDOW), level, self.settings)
        with timed("modulate"):
            radiance, spread, count = modulate(color, spread, albedo, inputs.get("emission"))
        self._repaired, self._fireflies = repaired + count, fireflies
        if self.method == "svgf+" and self.settings.antialias_frames > 1.0:
            with timed("antialias"):
                noisy, noise = self._noisy(inputs, signals), _noise(albedo, self.history.variance)
                changed = _any(self.history.changed)
                self.resolved = antialias(
                    radiance, noisy, noise, changed, guides.depth, inputs.get("motion"), self.resolved, self.settings,
                    unchanged, interactive,
                )  # fmt: skip
            radiance = self.resolved.color
        result = {"color": radiance, "variance": spread, "history_length": length}
        return {**result, **self._diagnose(inputs, signals, guides, before, fireflies)} if diagnostics else result

    def _diagnose(
        self, inputs: dict[str, Any], signals: list[str], guides: Guides, before: Any, fireflies: Fireflies
    ) -> dict[str, Any]:
        """before: the history that the frame started from."""
        point, changed = None, namespace(guides.depth).zeros(guides.depth.shape, bool)
        if before is not None:
            point = reproject(guides, before.guides, inputs.get("motion"), self.settings)
            changed = _any(self.history.changed) if self.method == "svgf+" else changed
        return {
            "motion_error": motion_error(guides, point, inputs.get("window", DEFAULT_WINDOW)),
            "reset_reason": reset_reason(guides, point, changed),
            "repaired_values": repaired_values(
                inputs, {signal: SIGNAL_ALBEDOS[signal] for signal in signals}, point is not None,
                self.method == "svgf+",
            ),  # fmt: skip
            "suppressed_light": fireflies.image,
        }

    def stage(self, name: str, arrays: dict[str, Any], level: int = 0) -> dict[str, Any]:
        """One stage alone. Names ending in a digit are one per signal, from 0.

        demodulate: the public images -> illumination0, guides.
        temporal: illumination0, guides, motion, and unless there is no history prev_ + guides, hist_color0,
            hist_moments0, hist_length -> color0, moments0, history_length. svgf+: moments are frames,
            variance, drift and changed, hist_filtered0 the luminance after the filter, variance0 goes with color0;
            signal 1 is the specular one.
        variance: moments0, history_length, guides -> variance0.
        atrous: color0, variance0, guides, (eaw: window; svgf+: signal 1 is the specular one, roughness) -> color0,
            variance0 (svgf).
        modulate: color0, variance0 (svgf), the public images -> color, variance.
        antialias: unresolved, moments0, the public images, depth, motion, resolved, resolved_frames
            -> color, resolved_frames.
        guides: normal, depth, depth_gradient, object_id.
        """
        signals = [signal for signal in SIGNAL_ALBEDOS if signal in arrays]
        if name == "demodulate":
            color, _, guides, self._repaired = self._demodulate(arrays, signals)
            return {**_numbered("illumination", color), **_guide_images(guides)}
        if name == "modulate":
            repairs = [self._albedo(arrays, signal) for signal in signals]
            albedos = [albedo for albedo, _ in repairs]
            radiance, spread, self._repaired = modulate(
                _listed(arrays, "color"), _listed(arrays, "variance") or None, albedos, arrays.get("emission")
            )
            return {"color": radiance, "variance": spread}
        if name == "antialias":
            history = Resolved(arrays["resolved"], arrays["resolved_frames"]) if "resolved" in arrays else None
            variances = [moments[..., 1] for moments in _listed(arrays, "moments")]
            noise = _noise([self._albedo(arrays, signal)[0] for signal in signals], variances)
            changed = _any([moments[..., 3] > 0.5 for moments in _listed(arrays, "moments")])
            new = antialias(
                arrays["unresolved"], self._noisy(arrays, signals), noise, changed, arrays["depth"],
                arrays.get("motion"), history, self.settings,
            )  # fmt: skip
            return {"color": new.color, "resolved_frames": new.frames}
        guides = _guides(arrays, "")
        if name == "temporal" and self.method == "svgf+":
            return self._temporal_plus_stage(arrays, guides)
        if name == "temporal":
            history = None
            if "hist_length" in arrays:
                history = History(
                    _listed(arrays, "hist_color"),
                    _listed(arrays, "hist_moments"),
                    arrays["hist_length"],
                    _guides(arrays, "prev_"),
                )
            new, self._repaired = temporal(
                _listed(arrays, "illumination"), guides, arrays.get("motion"), history, self.settings
            )
            return {
                **_numbered("color", new.color),
                **_numbered("moments", new.moments),
                "history_length": new.length,
            }
        if name == "variance":
            spread = variance(_listed(arrays, "moments"), arrays["history_length"], guides, self.settings)
            return _numbered("variance", spread)
        if name == "atrous":
            color = _listed(arrays, "color")
            if self.method == "eaw":
                window = arrays.get("window", DEFAULT_WINDOW)
                return _numbered("color", edge_avoiding(color, guides, window, level, self.settings))
            if self.method == "svgf+":
                gloss, _ = _gloss(["diffuse", "specular"][: len(color)], arrays.get("roughness"), guides)
                color, spread = atrous_plus(color, _listed(arrays, "variance"), gloss, guides, level, self.settings)
            else:
                color, spread = atrous(color, _listed(arrays, "variance"), guides, level, self.settings)
            return {**_numbered("color", color), **_numbered("variance", spread)}
        raise InputError(f'There is no denoiser stage "{name}".')

    def _temporal_plus_stage(self, arrays: dict[str, Any], guides: Guides) -> dict[str, Any]:
        history = None
        if "hist_length" in arrays:
            moments = _listed(arrays, "hist_moments")
            history = HistoryPlus(
                _listed(arrays, "hist_color"),
                [m[..., 0] for m in moments],
                [m[..., 1] for m in moments],
                [m[..., 2] for m in moments],
                [m[..., 3] > 0.5 for m in moments],
                _listed(arrays, "hist_filtered"),
                _guides(arrays, "prev_"),
            )
        illumination = _listed(arrays, "illumination")
        new, spread, self._fireflies, self._repaired = temporal_plus(
            illumination, [False, True][: len(illumination)], guides, arrays.get("motion"), history, self.settings,
            _with_reflections([signal for signal in SIGNAL_ALBEDOS if signal in arrays]),
        )  # fmt: skip
        xp = namespace(guides.depth)
        moments = [xp.stack(m, axis=-1) for m in zip(new.frames, new.variance, new.drift, new.changed, strict=True)]
        return {
            **_numbered("color", new.color),
            **_numbered("variance", spread),
            **_numbered("moments", moments),
            "history_length": xp.minimum.reduce(new.frames),
        }

    def _noisy(self, inputs: dict[str, Any], signals: list[str]) -> Any:
        lights = [inputs[name] for name in (*signals, "emission") if inputs.get(name) is not None]
        return sum(repair(light)[0] for light in lights)

    def _demodulate(self, inputs: dict[str, Any], signals: list[str]) -> tuple[list[Any], list[Any], Guides, int]:
        has_slope = self.method != "svgf+" or self.settings.has(PlusStep.PLANE_SLOPE)
        gradient = inputs.get("depth_gradient") if has_slope else None
        guides, repaired = repair_guides(inputs["normal"], inputs["depth"], gradient, inputs.get("object_id"))
        color, albedo = [], []
        for signal in signals:
            divisor, bad_albedos = self._albedo(inputs, signal)
            illumination, bad_radiances = demodulate(inputs[signal], divisor)
            color.append(illumination)
            albedo.append(divisor)
            repaired += bad_albedos + bad_radiances
        return color, albedo, guides, repaired

    def _albedo(self, inputs: dict[str, Any], signal: str) -> tuple[Any, int]:
        given = [inputs[name] for name in SIGNAL_ALBEDOS[signal] if name in inputs]
        return signal_albedo(given, (self.height, self.width, 3), namespace(inputs[signal]))


def _noise(albedos: list[Any], variances: list[Any]) -> Any:
    """Variance of a noisy frame's luminance, signals taken as independent."""
    return sum(variance * luminance(albedo) ** 2 for albedo, variance in zip(albedos, variances, strict=True))


def _any(masks: list[Any]) -> Any:
    return sum(masks) > 0


def _with_reflections(signals: list[str]) -> list[bool]:
    return [signal != "diffuse" for signal in signals]


def _gloss(signals: list[str], roughness: Any, guides: Guides) -> tuple[list[Any], int]:
    """Per signal as ``atrous_plus`` takes it; and on how many surfaces the roughness was none."""
    gloss: list[Any] = [1.0 if reflects else None for reflects in _with_reflections(signals)]
    if roughness is None or "specular" not in signals:
        return gloss, 0
    gloss[signals.index("specular")] = gloss_of(roughness)
    return gloss, int((guides.surface & ~in_range(roughness, 0.0, 1.0)).sum())


def _specular(signals: list[str]) -> list[bool]:
    return [signal == "specular" for signal in signals]


def _numbered(name: str, images: list[Any]) -> dict[str, Any]:
    return {f"{name}{signal}": image for signal, image in enumerate(images)}


def _listed(arrays: dict[str, Any], name: str) -> list[Any]:
    return [arrays[f"{name}{signal}"] for signal in range(MAX_SIGNALS) if f"{name}{signal}" in arrays]


def _guides(arrays: dict[str, Any], prefix: str) -> Guides:
    return Guides(*(arrays[prefix + name] for name in ("normal", "depth", "depth_gradient", "object_id")))


def _guide_images(guides: Guides) -> dict[str, Any]:
    return {
        "normal": guides.normal,
        "depth": guides.depth,
        "depth_gradient": guides.gradient,
        "object_id": guides.object_id,
    }
