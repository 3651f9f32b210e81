# SPDX-License-Identifier: Apache-2.0
"""What the denoiser costs: milliseconds, bytes and achieved bandwidth per stage, beside what a plain copy reaches.

The inputs are made up: a floor that recedes, boxes in front of it, sky; half a pixel of motion; 1-spp noise. They lie
on the device already, so that times are the denoiser's alone. Bytes are those that a stage cannot do without: every
image that it reads or writes, once. Dividing them by the stage's time gives a bandwidth that no stage can push above
the copy's, unless the images fit into the cache.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..devices import Device
from ..errors import InputError
from ..settings import DenoiseSettings

SIZES = ((1280, 720), (1920, 1080), (3840, 2160))
ALL = "denoise, all"


@dataclass(frozen=True)
class StageCost:
    """One stage at one size. milliseconds: median over the frames. bytes: moved at least. bandwidth: bytes over time,
    in GB/s. floor_milliseconds: what a copy of as many bytes takes on this device."""

    method: str
    width: int
    height: int
    signals: int
    stage: str
    milliseconds: float
    bytes: int
    bandwidth: float
    floor_milliseconds: float


@dataclass(frozen=True)
class BufferSize:
    """One piece of memory that the denoiser keeps between frames."""

    method: str
    width: int
    height: int
    signals: int
    buffer: str
    bytes: int
    bytes_per_pixel: float


@dataclass(frozen=True)
class Growth:
    """What a larger image costs: its pixels and its milliseconds, all stages, as multiples of the smaller one's."""

    method: str
    signals: int
    smaller: str
    larger: str
    pixels: float
    milliseconds: float


def growths(costs: Sequence[StageCost]) -> list[Growth]:
    """For each method and number of signals, from each size that was measured to the next larger one."""
    cases: dict[tuple[str, int], list[StageCost]] = {}
    for cost in costs:
        if cost.stage == ALL:
            cases.setdefault((cost.method, cost.signals), []).append(cost)
    return [
        Growth(
            method,
            signals,
            f"{a.width}x{a.height}",
            f"{b.width}x{b.height}",
            b.width * b.height / (a.width * a.height),
            b.milliseconds / a.milliseconds,
        )
        for (method, signals), frames in cases.items()
        for a, b in pairwise(sorted(frames, key=lambda cost: cost.width * cost.height))
    ]


def make_inputs(
    width: int, height: int, signals: int, seed: int = 1, names: Sequence[str] = ("diffuse", "specular")
) -> dict[str, np.ndarray]:
    """A frame as ``Denoiser.denoise`` takes it, one or two signals by these names; about a tenth of it sky. seed: of
    the noise."""
    rng, noise_rng = np.random.default_rng(0), np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    u, v = x / width, y / height
    depth = 2.0 / np.maximum(v - 0.1, 1e-3)
    gradient = np.zeros((height, width, 2), np.float32)
    gradient[..., 1] = -depth * depth / (2.0 * height)
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (height, width, 3)).copy()
    object_id = np.ones((height, width), np.int32)
    for box in range(24):
        left, top, size = rng.uniform(0.0, 0.95), rng.uniform(0.1, 0.8), rng.uniform(0.03, 0.15)
        inside = (u >= left) & (u < left + size) & (v >= top) & (v < top + 1.5 * size)
        near = np.float32(rng.uniform(2.0, 6.0))
        direction = rng.normal(size=3).astype(np.float32)
        depth[inside] = near + (u[inside] - left)
        gradient[inside] = [1.0 / width, 0.0]
        normal[inside] = direction / np.linalg.norm(direction)
        object_id[inside] = box + 2
    sky = v < 0.1
    depth[sky], object_id[sky], gradient[sky], normal[sky] = 1e10, 0, 0.0, 0.0
    inputs = {"normal": normal, "depth": depth, "depth_gradient": gradient, "object_id": object_id}
    inputs["motion"] = np.broadcast_to(np.float32([0.5, 0.25, 0.0]), (height, width, 3)).copy()
    inputs["emission"] = np.where(sky[..., None], np.float32([0.4, 0.6, 0.9]), np.float32(0.0))
    for name, albedo_name in list(zip(names, ("diffuse_albedo", "specular_albedo"), strict=True))[:signals]:
        albedo = 0.2 + 0.6 * ((np.floor(u * 64) + np.floor(v * 36)) % 2).astype(np.float32)
        inputs[albedo_name] = np.repeat(albedo[..., None], 3, axis=-1)
        noise = noise_rng.standard_exponential((height, width, 1), dtype=np.float32) ** 2
        inputs[name] = np.where(sky[..., None], np.float32(0.0), inputs[albedo_name] * noise)
    return {name: np.ascontiguousarray(image) for name, image in inputs.items()}


def measure(
    device: Device,
    method: str,
    size: tuple[int, int],
    signals: int,
    frames: int = 64,
    warm_up: int = 16,
    settings: DenoiseSettings | None = None,
    step: Callable[[], None] | None = None,
) -> tuple[list[StageCost], list[BufferSize]]:
    """Denoises warm_up + frames frames and returns the stages in order, then their sum; and the denoiser's memory.

    step: called after each frame. Raises InputError where there is nothing to measure, and for the reference, whose
    stages say nothing about bytes.
    """
    if device.name == "reference" or frames < 1 or warm_up < 0 or signals not in (1, 2):
        raise InputError(
            f"There is nothing to measure with {frames} frames and {signals} signals on {device.name}.",
            "Use cuda or cpu, at least one frame, one signal or two.",
        )
    width, height = size
    denoiser: Any = device.denoiser(width, height, method, (settings or DenoiseSettings()).as_dict())
    samples = time_stages(device, denoiser, upload_inputs(device, size, signals), frames, warm_up, step)
    traffic = denoiser.traffic()
    traffic[ALL] = sum(traffic.values())
    # Far more than any cache holds.
    copied = device.copy_bandwidth(1 << 30 if device.name == "cuda" else 1 << 28)
    costs = []
    for stage, times in samples.items():
        milliseconds, size_bytes = statistics.median(times), traffic.get(stage, 0)
        bandwidth = size_bytes / (milliseconds * 1e-3) / 1e9 if milliseconds > 0.0 else 0.0
        costs.append(
            StageCost(
                method, width, height, signals, stage, milliseconds, size_bytes, bandwidth, size_bytes / copied * 1e3
            )
        )
    buffers = [
        BufferSize(method, width, height, signals, name, size_bytes, size_bytes / (width * height))
        for name, size_bytes in denoiser.buffers()
    ]
    return costs, buffers


def upload_inputs(
    device: Device, size: tuple[int, int], signals: int, names: Sequence[str] = ("diffuse", "specular")
) -> list[dict[str, Any]]:
    """Two frames of ``make_inputs`` that differ in their noise, on the device."""
    frames = [make_inputs(*size, signals, seed, names) for seed in range(1, 3)]
    return [{name: device.upload(image) for name, image in frame.items()} for frame in frames]


def time_stages(
    device: Device,
    denoiser: Any,
    inputs: Sequence[dict[str, Any]],
    frames: int,
    warm_up: int,
    step: Callable[[], None] | None = None,
) -> dict[str, list[float]]:
    """Milliseconds of each stage, and ALL, in so many frames after the first warm_up. inputs: taken in turns. step:
    called after each frame."""
    samples: dict[str, list[float]] = {}
    for index in range(warm_up + frames):
        device.take_timings()
        denoiser.denoise(inputs[index % len(inputs)], reset=False)
        timings = device.take_timings()
        if index >= warm_up:
            for stage, milliseconds in {**timings, ALL: sum(timings.values())}.items():
                samples.setdefault(stage, []).append(milliseconds)
        if step:
            step()
    return samples


def plot(costs: Sequence[StageCost], title: str) -> bytes:
    """A PNG: for each size and number of signals a bar of the stages' milliseconds, and beside it the copy's."""
    import io

    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.add_subplot()
    stages = list(dict.fromkeys(cost.stage for cost in costs if cost.stage != ALL))
    cases = list(dict.fromkeys((cost.method, cost.width, cost.height, cost.signals) for cost in costs))
    of = {(cost.method, cost.width, cost.height, cost.signals, cost.stage): cost for cost in costs}
    bottoms, floors = np.zeros(len(cases)), np.zeros(len(cases))
    for index, stage in enumerate(stages):
        found = [of.get((*case, stage)) for case in cases]
        heights = np.array([cost.milliseconds if cost else 0.0 for cost in found])
        floor = np.array([cost.floor_milliseconds if cost else 0.0 for cost in found])
        color = f"C{index}"
        axes.bar(np.arange(len(cases)) - 0.2, heights, 0.4, bottoms, color=color, label=stage)
        axes.bar(np.arange(len(cases)) + 0.2, floor, 0.3, floors, color=color, alpha=0.4)
        bottoms, floors = bottoms + heights, floors + floor
    labels = [
        f"{width}x{height}\n{method}, {signals} signal{'s' if signals > 1 else ''}"
        for method, width, height, signals in cases
    ]
    axes.set_xticks(range(len(cases)), labels, fontsize="small")
    axes.set_ylabel("ms (pale: a copy of as many bytes)")
    axes.set_title(title, fontsize="medium")
    axes.grid(axis="y", alpha=0.25)
    axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
