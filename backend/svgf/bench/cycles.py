# SPDX-License-Identifier: Apache-2.0
"""Cycles and svgf side by side on the CPU: the same .blend file, light paths and size at one sample per pixel.

Both render the same frame in one process, in turns, after one frame each that does not count: scenes are built by then,
and kept (Cycles' persistent data). Neither denoises. Cycles' time is that of ``bpy.ops.render.render``, with Blender's
synchronisation; svgf's that of ``Renderer.render`` and of reading the image.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from ..devices import open_device
from ..renderer import Renderer
from ..scene import Scene
from ..settings import Settings


@dataclass(frozen=True)
class CyclesComparison:
    """Medians in ms. wall: the clock's. processor: of all cores together, which other programs disturb less."""

    scene: str
    wall: float
    cycles_wall: float
    processor: float
    cycles_processor: float

    @property
    def wall_ratio(self) -> float:
        """Of the times: above 1 svgf is faster."""
        return self.cycles_wall / self.wall

    @property
    def processor_ratio(self) -> float:
        return self.cycles_processor / self.processor


def measure(
    path: Path,
    export_file: Callable[..., Generator[Scene]],
    size: tuple[int, int],
    bounces: int | None,
    count: int,
    step: Callable[[], None] | None = None,
) -> CyclesComparison:
    """The first frame of a .blend file, ``count`` times with each renderer.

    export_file: ``svgf_blender.export.export_file``; its errors are raised. bounces: in all, and of each kind; None:
    what the file says. step: called after each pair of frames, the one that does not count included.
    """
    kinds = () if bounces is None else ("diffuse_bounces", "glossy_bounces", "transmission_bounces")
    settings = Settings(*size, method="none", pixel_filter="box", bounces=bounces, **dict.fromkeys(kinds, bounces))
    renderer = Renderer(settings, open_device("cpu"))
    with closing(export_file(path, size=size)) as scenes:
        scene = next(scenes).at_rest()
        from svgf_blender.export.cycles_comparison import prepare_cycles  # needs bpy

        render_cycles = prepare_cycles(size, bounces)

        def render_svgf() -> None:
            _ = renderer.render(scene).noisy

        ours: list[tuple[float, float]] = []
        theirs: list[tuple[float, float]] = []
        for _ in range(1 + count):
            ours.append(_clock(render_svgf))
            theirs.append(_clock(render_cycles))
            if step:
                step()
    wall, processor = (statistics.median(values) for values in zip(*ours[1:], strict=True))
    cycles_wall, cycles_processor = (statistics.median(values) for values in zip(*theirs[1:], strict=True))
    return CyclesComparison(path.stem, wall, cycles_wall, processor, cycles_processor)


def _clock(render: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds of the clock and of all cores."""
    start, processor_start = time.perf_counter(), time.process_time()
    render()
    return (time.perf_counter() - start) * 1e3, (time.process_time() - processor_start) * 1e3
