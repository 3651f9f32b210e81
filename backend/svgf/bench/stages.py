# SPDX-License-Identifier: Apache-2.0
"""What each stage of a frame costs, in milliseconds.

Frames of a sequence are rendered in order and again from the start, so that objects and camera move as they do in use;
the jump back only empties the history for one frame. Times of stages are the device's own (events on cuda, the clock
around a launch on cpu); "update" is host work; "whole frame" is the clock around ``Renderer.render``, with downloads.
The first frames are not counted: they build what later ones keep.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..errors import InputError
from ..frame import Frame
from ..renderer import Renderer
from ..scene import Scene

WHOLE_FRAME = "whole frame"
EXPORT = "export"
# Every other stage of a frame belongs to the denoiser.
_BEFORE_DENOISING = ("update", "refit", "gbuffer", "path")
DENOISE_TOTAL = "denoise, all"


@dataclass(frozen=True)
class StageTime:
    """One stage of one scene over ``frames`` frames, in ms."""

    scene: str
    stage: str
    median: float
    minimum: float
    maximum: float
    frames: int


def measure(
    renderer: Renderer,
    name: str,
    scenes: Sequence[Scene],
    frames: int = 32,
    warm_up: int = 8,
    export_ms: Sequence[float] = (),
    render: Callable[[Scene], Frame] | None = None,
    step: Callable[[], None] | None = None,
) -> list[StageTime]:
    """Renders warm_up + frames frames and returns the stages in the order in which they ran, then the sums.

    name: what the rows call the scene. export_ms: what each frame took to export, where that is known. render: how one
    frame is rendered, ``renderer.render`` by default. step: called after each frame. Raises InputError where there is
    nothing to measure, and whatever rendering raises.
    """
    if not scenes or frames < 1 or warm_up < 0:
        raise InputError(f"There is nothing to measure in {name}: {len(scenes)} scenes, {frames} frames.")
    render = render or renderer.render
    samples: dict[str, list[float]] = {EXPORT: list(export_ms)} if export_ms else {}
    for index in range(warm_up + frames):
        start = time.perf_counter()
        frame = render(scenes[index % len(scenes)])
        whole = (time.perf_counter() - start) * 1e3
        if index >= warm_up:
            denoise = sum(ms for stage, ms in frame.timings.items() if stage not in _BEFORE_DENOISING)
            for stage, ms in {**frame.timings, DENOISE_TOTAL: denoise, WHOLE_FRAME: whole}.items():
                samples.setdefault(stage, []).append(ms)
        if step:
            step()
    # Sums come last, whichever stages later frames added.
    for stage in (DENOISE_TOTAL, WHOLE_FRAME):
        samples[stage] = samples.pop(stage)
    return [
        StageTime(name, stage, statistics.median(times), min(times), max(times), len(times))
        for stage, times in samples.items()
    ]
