# SPDX-License-Identifier: Apache-2.0
"""What resolution costs: the same frames at growing sizes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..devices import Device
from ..frame import Frame
from ..renderer import Renderer
from ..scene import Scene
from ..settings import Settings
from . import stages

SIZES = ((480, 270), (960, 540), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160))


@dataclass(frozen=True)
class ResolutionCost:
    """One scene at one size: medians in ms. trace: stages gbuffer and path. denoise: all of the denoiser's stages.
    whole: the clock around a frame, host work on the scene included."""

    scene: str
    width: int
    height: int
    trace: float
    denoise: float
    whole: float

    def nanoseconds_per_pixel(self) -> float:
        """Of tracing and denoising."""
        return (self.trace + self.denoise) * 1e6 / (self.width * self.height)


def measure(
    device: Device,
    settings: Settings,
    name: str,
    scenes: Sequence[Scene],
    sizes: Sequence[tuple[int, int]] = SIZES,
    frames: int = 16,
    warm_up: int = 6,
    render: Callable[[Renderer, Scene], Frame] = Renderer.render,
    step: Callable[[], None] | None = None,
) -> list[ResolutionCost]:
    """One row for each size, (width, height). The rest is as ``svgf.bench.stages.measure`` has it."""
    rows = []
    for width, height in sizes:
        renderer = Renderer(dataclasses.replace(settings, width=width, height=height), device)

        def render_one(scene: Scene, renderer: Renderer = renderer) -> Frame:
            return render(renderer, scene)

        measured = stages.measure(renderer, name, scenes, frames, warm_up, render=render_one, step=step)
        medians = {row.stage: row.median for row in measured}
        trace = medians["gbuffer"] + medians["path"]
        rows.append(
            ResolutionCost(name, width, height, trace, medians[stages.DENOISE_TOTAL], medians[stages.WHOLE_FRAME])
        )
    return rows


def plot(rows: Sequence[ResolutionCost], title: str) -> bytes:
    """A PNG: milliseconds of tracing and denoising against megapixels, a column for each scene."""
    import io

    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(row.scene for row in rows))
    figure = Figure(figsize=(4 * len(scenes), 3.5), layout="constrained")
    figure.suptitle(title)
    for column, scene in enumerate(scenes):
        axes = figure.add_subplot(1, len(scenes), column + 1)
        mine = [row for row in rows if row.scene == scene]
        megapixels = [row.width * row.height / 1e6 for row in mine]
        axes.plot(megapixels, [row.trace for row in mine], marker="o", label="trace")
        axes.plot(megapixels, [row.denoise for row in mine], marker="o", label="denoise")
        axes.set(title=scene, xlabel="megapixels", ylabel="ms", xscale="log", yscale="log")
        axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
