# SPDX-License-Identifier: Apache-2.0
"""Whether a sequence can be denoised, asked before anything is written: all headers, and the pixels of a few frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import InputError
from .image import Layout, MultilayerImage, read_layout
from .inputs import Reading, view
from .passes import LIGHT_PASSES, PASSES
from .seed import noise_is_repeated
from .vectors import measure_convention

# Methods that look at one frame alone.
_SPATIAL_METHODS = ("eaw", "none")
# Consecutive frames whose pixels are compared, spread over the sequence.
_MOST_PAIRS = 4


@dataclass(frozen=True)
class Plan:
    """width, height: of all frames. readings: how to read each layer that is denoised. warnings: sentences."""

    width: int
    height: int
    readings: tuple[Reading, ...]
    warnings: tuple[str, ...]


def check(frames: Mapping[int, Path], method: str, layer: str | None = None) -> Plan:
    """frames: files by frame number, ascending. layer: the one to denoise; all render layers by default.

    Raises InputError that names the first bad frame, the layer, what is missing and where Blender's user enables it.
    """
    first, *_ = frames
    layouts = {number: read_layout(path) for number, path in frames.items()}
    for number, layout in layouts.items():
        if layout.size != layouts[first].size:
            sizes = ["{}x{}".format(*layouts[n].size) for n in (number, first)]
            raise InputError(
                f"Frame {number} ({frames[number]}) is {sizes[0]}, but frame {first} is {sizes[1]}.",
                "Render all frames in one size.",
            )
    warnings: list[str] = []
    readings = _readings(layouts[first], frames[first], method, layer, warnings)
    for number, path in frames.items():
        for reading in readings:
            _check_passes(layouts[number], reading, f"Frame {number} ({path})")
    measured = tuple(_measure(frames, reading, warnings) if reading.motion else reading for reading in readings)
    return Plan(*layouts[first].size, measured, tuple(warnings))


def _readings(layout: Layout, path: Path, method: str, layer: str | None, warnings: list[str]) -> list[Reading]:
    names = [name for name in layout.layers if layout.has(name, "Combined")]
    if layer is not None and layer not in layout.layers:
        raise InputError(f'{path} has no layer "{layer}".', f"It has: {', '.join(layout.layers)}.")
    if not names and layer is None:
        raise InputError(
            f'{path} has no layer with the pass "Combined".',
            f"It has: {', '.join(layout.layers)}. In Blender, render to OpenEXR MultiLayer.",
        )
    if layer is None and len(names) > 1:
        # The compositor's own output, in files of Blender: a picture without passes.
        pictures = [name for name in names if layout.layers[name].keys() == {"Combined"}]
        if len(pictures) < len(names):
            names = [name for name in names if name not in pictures]
            warnings.extend(f'Layer "{name}" holds nothing but Combined and stays as it is.' for name in pictures)
    readings = []
    for name in [layer] if layer is not None else names:
        missing = [light for light in LIGHT_PASSES if not layout.has(name, light)]
        readings.append(Reading(name, light_passes=not missing, motion=method not in _SPATIAL_METHODS))
        if missing and len(missing) < len(LIGHT_PASSES):
            warnings.append(
                f'Layer "{name}" is denoised from Combined alone, as it lacks {_listed(missing)}. '
                f"{_enable(missing)} for two signals and a better picture."
            )
    return readings


def _check_passes(layout: Layout, reading: Reading, frame: str) -> None:
    needed = ["Combined", "Depth", *(["Vector"] if reading.motion else [])]
    needed += LIGHT_PASSES if reading.light_passes else ["Denoising Albedo"]
    if not layout.has(reading.layer, "Denoising Normal"):
        needed.append("Normal")
    missing = [name for name in needed if not layout.has(reading.layer, name)]
    if missing:
        raise InputError(
            f'{frame}: layer "{reading.layer}" has no pass {_listed(missing)}.', f"{_enable(missing)} and render again."
        )


def _listed(names: list[str]) -> str:
    quoted = [f'"{name}"' for name in names]
    return " and ".join(filter(None, [", ".join(quoted[:-1]), quoted[-1]]))


def _enable(names: list[str]) -> str:
    places = list(dict.fromkeys(PASSES[name].place for name in names))
    return f"In Blender, enable View Layer properties > Passes > {'; '.join(places)}"


def _measure(frames: Mapping[int, Path], reading: Reading, warnings: list[str]) -> Reading:
    """The reading with the signs that the vectors turn out to need."""
    second_frames = [number for number in frames if number - 1 in frames]
    step = max(1, -(-len(second_frames) // _MOST_PAIRS))
    pairs, repeated = [], []
    for number in second_frames[::step]:
        images = [MultilayerImage(frames[n]) for n in (number - 1, number)]
        before, now = (view(image, reading) for image in images)
        pairs.append((now, before))
        colors = [image.read(reading.layer, "Combined") for image in images]
        repeated.append(noise_is_repeated(*colors, before, now))
    signs, warning = measure_convention(pairs, reading.layer)
    if warning:
        warnings.append(warning)
    if any(repeated):
        warnings.append(
            f'Layer "{reading.layer}": frames {second_frames[repeated.index(True) * step] - 1} and '
            f"{second_frames[repeated.index(True) * step]} carry the same noise, which no denoiser can average away. "
            "In Blender, switch on Render properties > Sampling > Advanced > Use Animated Seed (the clock beside Seed)."
        )
    return replace(reading, vector_signs=(reading.vector_signs[0] * signs[0], reading.vector_signs[1] * signs[1]))
