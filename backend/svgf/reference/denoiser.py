# SPDX-License-Identifier: Apache-2.0
"""The denoiser in float64: the order of the stages, and what goes from one frame to the next.

    method   stages
    svgf     demodulate -> temporal -> variance -> atrous x levels -> modulate      [Schied17]
    eaw      demodulate -> atrous x levels -> modulate                              [Dammertz10]
    none     demodulate -> modulate
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..errors import InputError
from ..settings import METHODS, DenoiseSettings, check_name
from .atrous import atrous, edge_avoiding
from .demodulate import demodulate, signal_albedo
from .device import Device
from .guides import Guides, namespace, repair_guides
from .modulate import modulate
from .temporal import History, temporal
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
    """Same methods as the native class. device: keeps the timings, may be None. settings: the fields of DenoiseSettings that differ from the
    defaults. Images may be numpy or CuPy arrays; results are float64 arrays of the same library.

    history: what the next frame starts from, None before the first.
    """

    def __init__(
        self, device: Any, width: int, height: int, method: str = "svgf", settings: dict[str, float] | None = None
    ) -> None:
        check_name("Denoiser method", method, METHODS)
        self._device = device or Device()
        self.width, self.height, self.method = width, height, method
        self.settings = DenoiseSettings.from_dict(settings or {})
        self.history: History | None = None
        self._repaired = 0

    def set_settings(self, settings: dict[str, float]) -> None:
        """Takes effect at the next frame; history stays."""
        self.settings = DenoiseSettings.from_dict(settings)

    def repaired(self) -> int:
        """How many values of the last frame's images and history were no numbers or out of range."""
        return self._repaired

    def denoise(self, inputs: dict[str, Any], reset: bool = False) -> dict[str, Any]:
        """inputs: images as ``svgf.Denoiser.denoise`` takes them, and optionally `window`; others are not read.

        reset: forget the history first. Returns color [H, W, 3], variance [H, W] and history_length [H, W].
        """
        signals = [name for name in SIGNAL_ALBEDOS if name in inputs]
        if reset or (self.history is not None and len(self.history.color) != len(signals)):
            self.history = None
        timed = self._device.stage
        with timed("demodulate"):
            color, albedo, guides, repaired = self._demodulate(inputs, signals)
        xp = namespace(guides.depth)
        spread = None
        length = guides.surface.astype(xp.float64)
        if self.method == "svgf":
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
        self._repaired = repaired + count
        return {"color": radiance, "variance": spread, "history_length": length}

    def stage(self, name: str, arrays: dict[str, Any], level: int = 0) -> dict[str, Any]:
        """One stage alone. Names ending in a digit are one per signal, from 0.

        demodulate: the public images -> illumination0, guides.
        temporal: illumination0, guides, motion, and unless there is no history prev_ + guides, hist_color0,
            hist_moments0, hist_length -> color0, moments0, history_length.
        variance: moments0, history_length, guides -> variance0.
        atrous: color0, variance0, guides, (eaw: window) -> color0, variance0 (svgf).
        modulate: color0, variance0 (svgf), the public images -> color, variance.
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
        guides = _guides(arrays, "")
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
            color, spread = atrous(color, _listed(arrays, "variance"), guides, level, self.settings)
            return {**_numbered("color", color), **_numbered("variance", spread)}
        raise InputError(f'There is no denoiser stage "{name}".')

    def _demodulate(self, inputs: dict[str, Any], signals: list[str]) -> tuple[list[Any], list[Any], Guides, int]:
        guides, repaired = repair_guides(
            inputs["normal"], inputs["depth"], inputs.get("depth_gradient"), inputs.get("object_id")
        )
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
