# SPDX-License-Identifier: Apache-2.0
"""What each step of a denoiser gives and costs: error and milliseconds with the step switched off, beside the whole
method.

All rows of a scene denoise the same noisy frames, traced once for several rows, and are compared with the same
converged images, traced with another seed. Errors are means over the measured frames. What is done where nothing moves
is measured on the last of them alone, standing still. Times are medians of the denoiser alone, on made-up inputs with
two signals (bench.denoise): they do not depend on the scene, and at the size that scenes are compared at, a GPU would
mostly wait.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..devices import Device
from ..frame import Frame
from ..metrics import Flicker, flip, relative_mse
from ..renderer import Renderer
from ..scene import Scene
from ..settings import DenoiseSettings, PlusStep, Settings
from .accuracy import count_unmeasured
from .denoise import ALL, time_stages, upload_inputs

WHOLE = "whole"
# Fields of DenoiseSettings, or else of Settings.
Changes = dict[str, Any]


def _without(step: PlusStep, **changes: float) -> Changes:
    return {"steps": int(DenoiseSettings().steps & ~step), **changes}


# Per method: what is switched off, and the settings that do it.
STEPS: dict[str, dict[str, Changes]] = {
    "none": {},
    "eaw": {
        "colour weight": {"eaw_sigma_color": 1e6},
        "normal weight": {"eaw_sigma_normal": 1e6},
        "position weight": {"eaw_sigma_position": 1e6},
    },
    "svgf+": {
        "temporal mean": _without(PlusStep.HISTORY),
        "tested taps": _without(PlusStep.TESTED_TAPS),
        "interpolated history": _without(PlusStep.INTERPOLATION),
        "plane's depth slope": _without(PlusStep.PLANE_SLOPE),
        "history fix": {"history_fix_radius": 1},
        "firefly limit": {"firefly_limit": 1e9},
        "temporal gradient": {"change_threshold": 1e6, "specular_change_threshold": 1e6},
        # One sample strays more than nine do.
        "3x3 mean in gradient": _without(
            PlusStep.MEAN_DRIFT, change_threshold=0.45, specular_change_threshold=0.45
        ),
        "history clamp": {"history_clamp": 1e6, "specular_history_clamp": 1e6},
        "3x3 mean of new light": _without(PlusStep.LOCAL_MEAN),
        "specular signal": {"signals": "direct_indirect"},
        "specular sharpness": {"specular_sharpness": 1.0},
        "structure is no noise": _without(PlusStep.STRUCTURE),
        "gloss": _without(PlusStep.GLOSS),
        "both variances": _without(PlusStep.BOTH_VARIANCES),
        "variance prefilter": _without(PlusStep.PREFILTER),
        "depth weight": {"plus_sigma_depth": 1e6},
        "normal weight": {"plus_sigma_normal": 1e-3},
        "luminance weight": {"plus_sigma_luminance": 1e6},
        "a-trous levels 3 to 5": {"levels": 2},
        "a-trous": {"levels": 0},
        "jitter": {"pixel_filter": "center"},
        "antialias": {"antialias_frames": 1.0},
        "Catmull-Rom": _without(PlusStep.CATMULL_ROM),
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
# Of svgf+, where nothing moves; and the frames until then.
STILL_STEPS: dict[str, Changes] = {
    "hand-over to noisy": _without(PlusStep.HAND_OVER),
    "antialias": {"antialias_frames": 1.0},
    "all history": _without(PlusStep.HISTORY, antialias_frames=1.0),
}
STILL_FRAMES = 64
# Rows for which a frame is traced once: so many histories are in memory at a time.
BATCH = 8
NOTES = (
    "Without a row: variance that never cancels (a sum of squares about a mean: there is no other to switch to);"
    " virtual hits (measured and refused, backend/native/denoise/temporal_plus.h); sky, emission, transmission, alpha"
    " and thin geometry (without what handles them the picture would be wrong).",
    "The temporal gradient and the history clamp are there for light that changes, which in these scenes it hardly"
    " does: tests/test_quality.py switches lamps.",
)


@dataclass(frozen=True)
class Ablation:
    """One scene denoised with one step off, or with all ("whole"). Errors: as ``svgf.metrics`` defines them.
    milliseconds: of a frame, whatever the scene."""

    scene: str
    method: str
    off: str
    relmse: float
    flip: float
    flicker: float
    milliseconds: float


def rows_of(methods: Sequence[str]) -> list[tuple[str, str, Changes]]:
    """(method, what is off, settings) of each row, the whole method first."""
    return [(method, off, changes) for method in methods for off, changes in {WHOLE: {}, **STEPS[method]}.items()]


def still_rows_of(methods: Sequence[str]) -> list[tuple[str, str, Changes]]:
    """As ``rows_of``, where nothing moves."""
    changes_of = {WHOLE: {}, **STILL_STEPS}
    return [("svgf+", off, changes) for off, changes in changes_of.items()] if "svgf+" in methods else []


def frames_of(methods: Sequence[str], frames: int) -> int:
    """How many frames ``measure`` renders of a scene that has so many."""
    return frames * len(rows_of(methods)) + STILL_FRAMES * len(still_rows_of(methods))


def changed(settings: Settings, method: str, changes: Changes) -> Settings:
    """The settings of a row."""
    names = {field.name for field in dataclasses.fields(DenoiseSettings)}
    denoise = {name: value for name, value in changes.items() if name in names}
    others = {name: value for name, value in changes.items() if name not in names}
    return replace(settings, method=method, denoise=replace(settings.denoise, **denoise), **others)


def measure_times(
    device: Device, size: tuple[int, int], methods: Sequence[str] = tuple(STEPS), frames: int = 16, warm_up: int = 4
) -> dict[tuple[str, str], float]:
    """Milliseconds by method and what is off."""
    inputs = {
        signals: upload_inputs(device, size, 2, signals.split("_"))
        for signals in ("diffuse_specular", "direct_indirect")
    }
    # Some are among both.
    rows = {(method, off): changes for method, off, changes in (*rows_of(methods), *still_rows_of(methods))}
    result = {}
    for (method, off), changes in rows.items():
        settings = changed(Settings(*size), method, changes)
        denoiser = device.denoiser(*size, method, settings.denoise.as_dict())
        times = time_stages(device, denoiser, inputs[settings.signals], frames, warm_up)
        result[method, off] = statistics.median(times[ALL])
    return result


def measure(
    device: Device,
    settings: Settings,
    name: str,
    scenes: Sequence[Scene],
    references: Sequence[np.ndarray],
    milliseconds: dict[tuple[str, str], float],
    methods: Sequence[str] = tuple(STEPS),
    render: Callable[[Renderer, Scene, Sequence[Settings]], list[Frame]] = Renderer.render_variants,
    step: Callable[[], None] | None = None,
) -> list[Ablation]:
    """scenes: consecutive frames; the last len(references) of them are measured, against one reference each. name: what
    the rows call the scene. milliseconds: of ``measure_times``. step: called after each frame. Raises InputError with
    fewer than two references."""
    count_unmeasured(name, scenes, references)
    still = [scenes[-1].at_rest()] * STILL_FRAMES
    sequences = {name: (scenes, references), f"{name}, still": (still, [references[-1]] * 2)}
    cases = [
        (sequence, method, off, changed(settings, method, changes))
        for sequence, rows in zip(sequences, (rows_of(methods), still_rows_of(methods)), strict=True)
        for method, off, changes in rows
    ]

    def denoise(frames: Sequence[Scene], batch: Sequence[Settings], measured: int) -> list[list[np.ndarray]]:
        """The last images of each of the batch."""
        renderer = Renderer(batch[0], device)
        images: list[list[np.ndarray]] = [[] for _ in batch]
        for index, scene in enumerate(frames):
            for of_row, frame in zip(images, render(renderer, scene, batch), strict=True):
                if index >= len(frames) - measured:
                    of_row.append(frame.color)
                if step:
                    step()
        return images

    # FLIP takes longer than rendering does, on one processor: other processes compare while frames are rendered.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max(1, (os.cpu_count() or 1) - 1), context, _use_one_thread) as pool:
        errors: dict[tuple[str, Settings], Future] = {}
        for sequence, (frames, truths) in sequences.items():
            for batch in _batches(row for of, _, _, row in cases if of == sequence):
                for row, images in zip(batch, denoise(frames, batch, len(truths)), strict=True):
                    errors[sequence, row] = pool.submit(_errors, images, list(truths))
        return [
            Ablation(sequence, method, off, *errors[sequence, row].result(), milliseconds[method, off])
            for sequence, method, off, row in cases
        ]


def _batches(rows: Iterable[Settings]) -> Iterator[list[Settings]]:
    """Those that trace the same frames, at most BATCH at once."""
    alike: dict[tuple[str, str], list[Settings]] = {}
    for settings in rows:
        alike.setdefault((settings.signals, settings.resolved_pixel_filter), []).append(settings)
    for group in alike.values():
        for start in range(0, len(group), BATCH):
            yield group[start : start + BATCH]


def _use_one_thread() -> None:
    """In each process that compares, before it loads flip_evaluator: there is a process for every processor, and with
    as many threads in each they would mostly wait for one another."""
    os.environ["OMP_NUM_THREADS"] = "1"


def _errors(images: Sequence[np.ndarray], references: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """relMSE and FLIP, means over the frames, and flicker."""
    errors, flicker = [], Flicker()
    for image, reference in zip(images, references, strict=True):
        errors.append((relative_mse(image, reference), flip(image, reference)))
        flicker.add(image, reference)
    relmse, seen = map(float, np.mean(errors, axis=0))
    return relmse, seen, flicker.value


def gains(rows: Sequence[Ablation]) -> list[tuple[float, float, float, float]]:
    """For each row how many times relMSE, FLIP and flicker of the whole method are left without the step, and the
    milliseconds that the step takes."""
    whole = {(row.scene, row.method): row for row in rows if row.off == WHOLE}
    result = []
    for row in rows:
        on = whole[row.scene, row.method]
        ratios = (getattr(row, metric) / max(getattr(on, metric), 1e-12) for metric in ("relmse", "flip", "flicker"))
        result.append((*ratios, on.milliseconds - row.milliseconds))
    return result


def plot(rows: Sequence[Ablation], title: str) -> bytes:
    """A PNG: for each scene and metric, how many times the error of the whole method is left with each step off."""
    import io

    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(row.scene for row in rows))
    steps = list(dict.fromkeys((row.method, row.off) for row in rows if row.off != WHOLE))
    of = {(row.scene, row.method, row.off): gain for row, gain in zip(rows, gains(rows), strict=True)}
    figure = Figure(figsize=(2.6 * len(scenes) + 2.5, 0.3 * len(steps) + 1.6), layout="constrained")
    figure.suptitle(title, fontsize="medium")
    places = np.arange(len(steps))[::-1]
    for column, scene in enumerate(scenes):
        axes = figure.add_subplot(1, len(scenes), column + 1)
        for index, metric in enumerate(("relmse", "flip", "flicker")):
            ratios = [of[scene, *step][index] if (scene, *step) in of else np.nan for step in steps]
            axes.barh(places + 0.25 - 0.25 * index, ratios, 0.22, label=metric)
        axes.axvline(1.0, color="black", linewidth=0.8)
        axes.set_xscale("log")
        axes.set_yticks(places, [f"{method} without {off}" for method, off in steps] if column == 0 else [])
        axes.set_ylim(-0.7, len(steps) - 0.3)
        axes.set_title(scene)
        axes.set_xlabel("error over that of the whole method")
        axes.grid(axis="x", which="both", alpha=0.25)
        if column == 0:
            axes.legend(fontsize="small")
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
