# SPDX-License-Identifier: Apache-2.0
"""Denoises the frames of a sequence, one after the other, each layer with a history of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..denoiser import Denoiser
from ..devices import Device
from .image import MultilayerImage
from .inputs import Reading, layer_inputs
from .preflight import Plan
from .reprojection import View, agreement

# Cycles' vectors lead to the same surface for nine pixels of ten, and in a fast pan for half of them.
_CUT_AGREEMENT = 0.2
_CUT = "the view was cut"
# Light that the light passes may miss, as a share, before the user should know that it stays noisy.
_UNEXPLAINED = 0.01


@dataclass(frozen=True)
class LayerResult:
    """color [H, W, 3]: the denoised Combined. reset: why this frame starts without history, else empty. repaired: how
    many values were no numbers or out of range. unexplained: see ``LayerInputs``."""

    color: np.ndarray
    reset: str
    repaired: int
    unexplained: float


@dataclass(frozen=True)
class DenoisedFrame:
    """image: the file's, with Combined replaced. layers: by name. messages: sentences for the user."""

    frame: int
    image: MultilayerImage
    layers: dict[str, LayerResult]
    messages: tuple[str, ...]


class SequenceDenoiser:
    """plan: of ``preflight.check``. method: of ``svgf.Denoiser``. diagnostics: add "History Length", "Variance" and the
    passes of ``svgf.diagnostics`` to the images. Raises as Denoiser does."""

    def __init__(self, plan: Plan, method: str, device: Device, diagnostics: bool = False) -> None:
        self.plan, self.method, self.device = plan, method, device
        self._layers = [
            _Layer(reading, Denoiser(plan.width, plan.height, device, method, diagnostics=diagnostics), diagnostics)
            for reading in plan.readings
        ]
        self._last: int | None = None
        self._noted_unexplained = False

    def denoise(self, frame: int, image: MultilayerImage) -> DenoisedFrame:
        """The next frame: any number above the last one; what lies between is a gap. Raises InputError, DeviceError."""
        messages: list[str] = []
        gap = ""
        if self._last is not None and frame != self._last + 1:
            gap = f"it follows frame {self._last}"
            if any(reading.motion for reading in self.plan.readings):
                messages.append(f"Frame {frame} starts without history: {gap}, not {frame - 1}.")
        self._last = frame
        results = {layer.reading.layer: layer.denoise(image, gap) for layer in self._layers}
        for layer, result in results.items():
            if result.reset == _CUT:
                messages.append(f'Frame {frame}, layer "{layer}", starts without history: {_CUT}.')
            if result.repaired:
                messages.append(
                    f'Frame {frame}, layer "{layer}": {result.repaired} values were no numbers or out of range; '
                    "they were repaired."
                )
            if result.unexplained > _UNEXPLAINED and not self._noted_unexplained:
                self._noted_unexplained = True
                messages.append(
                    f'Frame {frame}, layer "{layer}": {100 * result.unexplained:.0f} % of the light is in Combined but '
                    "in no light pass (volumes, for instance); it is kept, and stays noisy."
                )
        return DenoisedFrame(frame, image, results, tuple(messages))

    def attributes(self, frame: DenoisedFrame) -> dict[str, str]:
        """How a frame was made, for the header of its file."""
        from .. import __version__

        described = {
            "svgf.version": __version__,
            "svgf.method": self.method,
            "svgf.device": self.device.name,
        }
        for reading in self.plan.readings:
            prefix = f"svgf.{reading.layer}".rstrip(".")
            described[f"{prefix}.signals"] = "diffuse, specular" if reading.light_passes else "Combined"
            if reading.motion:
                described[f"{prefix}.vector"] = "motion to the right, down = {:+g} X, {:+g} Y".format(
                    *reading.vector_signs
                )
            described[f"{prefix}.reset"] = frame.layers[reading.layer].reset
        return described


class _Layer:
    """One layer and its history."""

    def __init__(self, reading: Reading, denoiser: Denoiser, diagnoses: bool) -> None:
        self.reading = reading
        self._denoiser, self._diagnoses = denoiser, diagnoses
        self._before: View | None = None

    def denoise(self, image: MultilayerImage, gap: str) -> LayerResult:
        """Replaces Combined in the image. gap: why the last frame is not the one before, else empty."""
        inputs = layer_inputs(image, self.reading)
        if self.reading.motion:
            if gap:
                self._denoiser.reset(gap)
            elif self._before is not None and agreement(inputs.view, self._before) < _CUT_AGREEMENT:
                self._denoiser.reset(_CUT)
            self._before = inputs.view
        result = self._denoiser.denoise(inputs.images)
        color = result["color"] + inputs.deficit
        if self._diagnoses:
            shown = {"history_length": result["history_length"], "variance": result["variance"]}
            for name, plane in {**shown, **self._denoiser.diagnostics}.items():
                image.add(self.reading.layer, name.replace("_", " ").title(), plane)
        cut_to_half = image.replace(self.reading.layer, "Combined", color)
        return LayerResult(color, self._denoiser.last_reset, result["repaired"] + cut_to_half, inputs.unexplained)
