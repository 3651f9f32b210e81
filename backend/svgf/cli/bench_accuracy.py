# SPDX-License-Identifier: Apache-2.0
"""``svgf bench accuracy`` and ``svgf bench ablation``: the error that is left beside the time that was spent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from .bench_scenes import (
    FilesArgument,
    FirstOption,
    FramesOption,
    ImageSizeOption,
    MethodsOption,
    ReferenceOption,
    read_animation,
    scene_paths,
)
from .options import DeviceOption, JsonOption, parse_size
from .report import CsvOption, PlotOption, publish, table


def accuracy(
    files: FilesArgument = None,
    size: ImageSizeOption = "960x540",
    device: DeviceOption = "auto",
    frames: FramesOption = "1-16",
    first: FirstOption = 5,
    reference_spp: ReferenceOption = 1024,
    quick: Annotated[bool, typer.Option("--quick", help="Only 1 sample per pixel, and the input of svgf.")] = False,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """What accuracy costs in time: relMSE, FLIP and flicker against milliseconds, for each method and sample count."""
    from ..bench.accuracy import VARIANTS, measure, plot

    variants = [variant for variant in VARIANTS if not quick or variant[1] == 1]
    title, rows = _measure_scenes(
        files, size, device, frames, first, reference_spp, lambda count: count * len(variants),
        lambda opened, *scene, **progress: measure(opened, *scene, variants, **progress),
    )  # fmt: skip
    lines = [
        (
            row.scene, row.method, str(row.samples), f"{row.milliseconds:.3f}",
            *_four_digits(row.relmse, row.flip, row.ssim, row.flicker),
        )
        for row in rows
    ]  # fmt: skip
    headings = ("scene", "method", "spp", "ms", "relMSE", "FLIP", "SSIM", "flicker")
    figures = table(headings, lines, names=2, section=lambda line: line[0])
    publish(title, rows, figures, csv_file=csv_file, plot_file=plot_file, plot=plot, as_json=as_json)


def ablation(
    files: FilesArgument = None,
    size: ImageSizeOption = "480x270",
    device: DeviceOption = "auto",
    methods: MethodsOption = None,
    frames: FramesOption = "1-12",
    first: FirstOption = 5,
    reference_spp: ReferenceOption = 512,
    timed_size: Annotated[
        str | None,
        typer.Option(
            "--timed-size", metavar="WxH", show_default=False,
            help="Pixels of the frames that are timed. Default: 1920x1080 on a GPU, else --size.",
        ),
    ] = None,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """What each step of the denoiser gives and costs: relMSE, FLIP, flicker and milliseconds without it."""
    from ..bench.ablation import NOTES, STEPS, WHOLE, frames_of, gains, measure, measure_times, plot
    from ..devices import open_device
    from ..settings import check_name

    chosen = methods or list(STEPS)
    for method in chosen:
        check_name("The method", method, tuple(STEPS))
    opened = open_device(device)
    timed = timed_size or ("1920x1080" if opened.name == "cuda" else size)
    times = measure_times(opened, parse_size(timed), chosen)
    title, rows = _measure_scenes(
        files, size, device, frames, first, reference_spp, lambda count: frames_of(chosen, count),
        lambda opened, *scene, **progress: measure(opened, *scene, times, chosen, **progress),
    )  # fmt: skip
    title += f"; ms: two signals at {timed}; x: times what is left with every step, ms of a step: what it takes"
    lines: dict[str, list[tuple[str, ...]]] = {}
    for row, (*ratios, cost) in zip(rows, gains(rows), strict=True):
        whole = row.off == WHOLE
        errors = zip((row.relmse, row.flip, row.flicker), ratios, strict=True)
        figures = [text for error, ratio in errors for text in (f"{error:.4f}", "" if whole else f"{ratio:.2f}")]
        milliseconds = f"{row.milliseconds:.3f}" if whole else f"{cost:+.3f}"
        lines.setdefault(row.scene, []).append((row.method, "-" if whole else row.off, *figures, milliseconds))
    headings = ("without", "relMSE", "x", "FLIP", "x", "flicker", "x", "ms")
    tables = [
        table((scene, *headings), of_scene, names=2, section=lambda line: line[0]) for scene, of_scene in lines.items()
    ]
    publish(
        title, rows, *tables, *NOTES,
        csv_file=csv_file, plot_file=plot_file, plot=plot, as_json=as_json, notes=NOTES,
    )  # fmt: skip


def _measure_scenes(
    files: list[Path] | None,
    size: str,
    device_name: str,
    frames: str,
    first: int,
    reference_spp: int,
    frames_of: Callable[[int], int],
    measure: Callable[..., Sequence[Any]],
) -> tuple[str, list[Any]]:
    """A title, and the rows of all scenes, of which measure(device, settings, name, scenes, references, render=, step=)
    renders frames_of(its frames) frames."""
    from ..bench.accuracy import converge
    from ..devices import open_device
    from ..settings import Settings
    from .progress import progress_bar, render_frame

    paths, image_size = scene_paths(files), parse_size(size)
    settings = Settings(*image_size)
    device = open_device(device_name)
    rows: list[Any] = []
    for path in paths:
        scenes, measured = read_animation(path, frames, first, image_size)
        with progress_bar(f"{path.stem}: truth", len(measured)) as bar:
            references = converge(device, settings, measured, reference_spp, render_frame, bar.step)
        with progress_bar(f"{path.stem}: denoised", frames_of(len(scenes))) as bar:
            rows += measure(device, settings, path.stem, scenes, references, render=render_frame, step=bar.step)
    title = f"{device.description} ({device.name}), {size}, frames {first} on of {frames}, truth {reference_spp} spp"
    return title, rows


def _four_digits(*values: float) -> list[str]:
    return [f"{value:.4f}" for value in values]
