# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs in time: the error that is left, beside the milliseconds that were spent.

Every way to spend them is rendered over the same frames and compared with the same converged images, which are traced
with another seed, so that nothing is compared with its own noise. Errors are means over the frames from ``first`` on,
when a temporal mean has had time to settle; the frames before them are rendered all the same. Times are the device's
own for a whole frame without the host's work on the scene: medians over the measured frames.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..devices import Device
from ..errors import InputError
from ..frame import Frame
from ..metrics import Flicker, flip, relative_mse, ssim
from ..renderer import Renderer
from ..scene import Scene
from ..settings import Settings

# What the denoiser was given, measured as if it were a result.
INPUT = "input"
VARIANTS = (
    *(("none", samples) for samples in (1, 2, 4, 8, 16, 32, 64)),
    *(("eaw", samples) for samples in (1, 4)),
    *(("svgf", samples) for samples in (1, 2, 4, 8)),
    *(("svgf+", samples) for samples in (1, 2, 4, 8)),
)


@dataclass(frozen=True)
class Accuracy:
    """One way to render one scene. method: "none", "eaw", "svgf", "svgf+", or INPUT for the noisy image that svgf was
    given at one sample. milliseconds: median per frame. Errors: means over the measured frames, as ``svgf.metrics``
    defines them."""

    scene: str
    method: str
    samples: int
    milliseconds: float
    relmse: float
    flip: float
    ssim: float
    flicker: float


def converge(
    device: Device,
    settings: Settings,
    scenes: Sequence[Scene],
    samples: int,
    render: Callable[[Renderer, Scene], Frame] = Renderer.render,
    step: Callable[[], None] | None = None,
) -> list[np.ndarray]:
    """The truth: each scene with this many samples per pixel, box-filtered and not denoised, [H, W, 3]."""
    truth = dataclasses.replace(settings, method="none", samples=samples, pixel_filter="box", seed=settings.seed + 1)
    renderer = Renderer(truth, device)
    images = []
    for scene in scenes:
        images.append(render(renderer, scene).color)
        if step:
            step()
    return images


def count_unmeasured(name: str, scenes: Sequence[Scene], references: Sequence[np.ndarray]) -> int:
    """How many frames come before those that are measured. Raises InputError with fewer than two references, as
    flicker is between two frames."""
    if not 2 <= len(references) <= len(scenes):
        raise InputError(
            f"{name} has {len(scenes)} frames and {len(references)} references.", "Measure at least two frames."
        )
    return len(scenes) - len(references)


def measure(
    device: Device,
    settings: Settings,
    name: str,
    scenes: Sequence[Scene],
    references: Sequence[np.ndarray],
    variants: Sequence[tuple[str, int]] = VARIANTS,
    render: Callable[[Renderer, Scene], Frame] = Renderer.render,
    step: Callable[[], None] | None = None,
) -> list[Accuracy]:
    """Renders the scenes once for each variant (method, samples per pixel).

    scenes: consecutive frames; the last len(references) of them are measured, against one reference each. name: what
    the rows call the scene. step: called after each frame. Raises InputError with fewer than two references.
    """
    unmeasured = count_unmeasured(name, scenes, references)
    rows: list[Accuracy] = []
    for method, samples in variants:
        renderer = Renderer(dataclasses.replace(settings, method=method, samples=samples), device)
        result = _Mean(name, method, samples)
        given = _Mean(name, INPUT, samples)
        for index, scene in enumerate(scenes):
            frame = render(renderer, scene)
            if index >= unmeasured:
                reference = references[index - unmeasured]
                before = ("update", "refit", "gbuffer", "path")
                denoising = sum(ms for stage, ms in frame.timings.items() if stage not in before)
                tracing = frame.timings["gbuffer"] + frame.timings["path"]
                result.add(frame.color, reference, tracing + denoising)
                given.add(frame.noisy, reference, tracing)
            if step:
                step()
        if (method, samples) == ("svgf", 1):
            rows.append(given.row())
        rows.append(result.row())
    return rows


class _Mean:
    """Gathers the frames of a row."""

    def __init__(self, scene: str, method: str, samples: int) -> None:
        self._name = (scene, method, samples)
        self._milliseconds: list[float] = []
        self._errors: list[tuple[float, float, float]] = []
        self._flicker = Flicker()

    def add(self, image: np.ndarray, reference: np.ndarray, milliseconds: float) -> None:
        self._milliseconds.append(milliseconds)
        self._errors.append((relative_mse(image, reference), flip(image, reference), ssim(image, reference)))
        self._flicker.add(image, reference)

    def row(self) -> Accuracy:
        errors = np.mean(self._errors, axis=0)
        return Accuracy(*self._name, statistics.median(self._milliseconds), *map(float, errors), self._flicker.value)


def plot(rows: Sequence[Accuracy], title: str) -> bytes:
    """A PNG: error against milliseconds, both logarithmic; a column for each scene, a line for each method."""
    import io

    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    scenes = list(dict.fromkeys(row.scene for row in rows))
    errors = (("relmse", "relMSE"), ("flip", "FLIP"), ("flicker", "flicker"))
    figure = Figure(figsize=(4 * len(scenes), 3 * len(errors)), layout="constrained")
    figure.suptitle(title)
    for column, scene in enumerate(scenes):
        for line, (field, label) in enumerate(errors):
            axes = figure.add_subplot(len(errors), len(scenes), line * len(scenes) + column + 1)
            for method in dict.fromkeys(row.method for row in rows if row.method != INPUT):
                points = [row for row in rows if row.scene == scene and row.method == method]
                axes.loglog(
                    [row.milliseconds for row in points], [getattr(row, field) for row in points], "o-", label=method
                )
                for row in points:
                    axes.annotate(
                        str(row.samples),
                        (row.milliseconds, getattr(row, field)),
                        textcoords="offset points",
                        xytext=(4, 4),
                        fontsize="x-small",
                    )
            axes.set_ylabel(label)
            axes.grid(visible=True, which="both", alpha=0.25)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                axis.set_major_formatter(StrMethodFormatter("{x:g}"))
                axis.set_minor_formatter(NullFormatter())
            if line == 0:
                axes.set_title(scene)
            if line == len(errors) - 1:
                axes.set_xlabel("ms per frame (beside the points: spp)")
            if line == column == 0:
                axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
