# SPDX-License-Identifier: Apache-2.0
"""What each step of a denoiser gives: error and milliseconds with the step switched off, beside the whole method.

All rows denoise the same noisy frames and are compared with the same converged images, traced with another seed. Errors
are means over the measured frames; times are medians of the denoiser's stages alone, as the device reports them.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..devices import Device
from ..frame import Frame
from ..metrics import Flicker, flip, relative_mse
from ..renderer import Renderer
from ..scene import Scene
from ..settings import Settings
from .accuracy import count_unmeasured

WHOLE = "whole"
# Per method: what is switched off, and the settings that do it.
STEPS: dict[str, dict[str, dict[str, float]]] = {
    "none": {},
    "eaw": {
        "colour weight": {"eaw_sigma_color": 1e6},
        "normal weight": {"eaw_sigma_normal": 1e6},
        "position weight": {"eaw_sigma_position": 1e6},
    },
    "svgf+": {
        "temporal mean": {"history_frames": 1.0},
        "firefly limit": {"firefly_limit": 1e9},
        "history fix": {"history_fix_radius": 1},
        "temporal gradient": {"change_threshold": 1e6},
        "history clamp": {"history_clamp": 1e6, "specular_history_clamp": 1e6},
        "specular sharpness": {"specular_sharpness": 1.0},
        "antialias": {"antialias_frames": 1.0},
        "depth weight": {"sigma_depth": 1e6},
        "normal weight": {"plus_sigma_normal": 1e-3},
        "luminance weight": {"plus_sigma_luminance": 1e6},
        "a-trous levels 3 to 5": {"levels": 2},
        "a-trous": {"levels": 0},
    },
    "svgf": {
        "temporal mean": {"alpha": 1.0},
        "spatial variance": {"spatial_variance_frames": 1},
        "depth weight": {"sigma_depth": 1e6},
        "normal weight": {"sigma_normal": 1e-3},
        "luminance weight": {"sigma_luminance": 1e6},
        "a-trous levels 3 to 5": {"levels": 2},
        "a-trous": {"levels": 0},
    },
}
_BEFORE_DENOISING = ("update", "gbuffer", "path")


@dataclass(frozen=True)
class Ablation:
    """One scene denoised with one step off, or with all ("whole"). Errors: as ``svgf.metrics`` defines them."""

    scene: str
    method: str
    off: str
    relmse: float
    flip: float
    flicker: float
    milliseconds: float


def rows_of(methods: Sequence[str]) -> list[tuple[str, str, dict[str, float]]]:
    """(method, what is off, settings) of each row, the whole method first."""
    return [(method, off, changes) for method in methods for off, changes in {WHOLE: {}, **STEPS[method]}.items()]


def measure(
    device: Device,
    settings: Settings,
    name: str,
    scenes: Sequence[Scene],
    references: Sequence[np.ndarray],
    methods: Sequence[str] = tuple(STEPS),
    render: Callable[[Renderer, Scene], Frame] = Renderer.render,
    step: Callable[[], None] | None = None,
) -> list[Ablation]:
    """scenes: consecutive frames; the last len(references) of them are measured, against one reference each. name: what
    the rows call the scene. step: called after each frame. Raises InputError with fewer than two references."""
    unmeasured = count_unmeasured(name, scenes, references)
    result = []
    for method, off, changes in rows_of(methods):
        changed = replace(settings, method=method, denoise=dataclasses.replace(settings.denoise, **changes))
        renderer = Renderer(changed, device)
        errors, milliseconds, flicker = [], [], Flicker()
        for index, scene in enumerate(scenes):
            frame = render(renderer, scene)
            if index >= unmeasured:
                reference = references[index - unmeasured]
                errors.append((relative_mse(frame.color, reference), flip(frame.color, reference)))
                flicker.add(frame.color, reference)
                milliseconds.append(sum(ms for stage, ms in frame.timings.items() if stage not in _BEFORE_DENOISING))
            if step:
                step()
        means = map(float, np.mean(errors, axis=0))
        result.append(Ablation(name, method, off, *means, flicker.value, statistics.median(milliseconds)))
    return result


def plot(rows: Sequence[Ablation], title: str) -> bytes:
    """A PNG: for each scene and metric, how many times the error of the whole method is left with each step off."""
    import io

    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(row.scene for row in rows))
    steps = list(dict.fromkeys((row.method, row.off) for row in rows if row.off != WHOLE))
    of = {(row.scene, row.method, row.off): row for row in rows}
    figure = Figure(figsize=(3.2 * len(scenes) + 2.5, 0.3 * len(steps) + 1.6), layout="constrained")
    figure.suptitle(title, fontsize="medium")
    for column, scene in enumerate(scenes):
        axes = figure.add_subplot(1, len(scenes), column + 1)
        for shift, metric in ((0.25, "relmse"), (0.0, "flip"), (-0.25, "flicker")):
            ratios = [
                getattr(of[scene, method, off], metric) / max(getattr(of[scene, method, WHOLE], metric), 1e-12)
                for method, off in steps
            ]
            axes.barh(np.arange(len(steps))[::-1] + shift, ratios, 0.22, label=metric)
        axes.axvline(1.0, color="black", linewidth=0.8)
        axes.set_xscale("log")
        axes.set_yticks(
            np.arange(len(steps))[::-1], [f"{method} without {off}" for method, off in steps] if column == 0 else []
        )
        axes.set_title(scene)
        axes.set_xlabel("error over that of the whole method")
        axes.grid(axis="x", which="both", alpha=0.25)
        if column == 0:
            axes.legend(fontsize="small")
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
