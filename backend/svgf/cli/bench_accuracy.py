# SPDX-License-Identifier: Apache-2.0
"""``svgf bench accuracy`` and ``svgf bench ablation``: the error that is left beside the time that was spent."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

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
from .report import CsvOption, PlotOption, print_json, publish, show, table, write_files

if TYPE_CHECKING:
    from ..bench.ablation import Ablation
    from ..devices import Device


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
    from ..devices import open_device
    from .progress import render_frame

    variants = [variant for variant in VARIANTS if not quick or variant[1] == 1]
    opened = open_device(device)
    title = _title(opened, size, frames, first, reference_spp)
    scenes = _measure_scenes(
        opened, files, size, frames, first, reference_spp, lambda count: count * len(variants),
        lambda *scene, step: measure(opened, *scene, variants, render_frame, step),
    )  # fmt: skip
    rows = [row for of_scene in scenes for row in of_scene]
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
    from ..bench.ablation import NOTES, STEPS, frames_of, measure, measure_times, plot
    from ..devices import open_device
    from ..settings import check_name
    from .progress import render_variants

    chosen = methods or list(STEPS)
    for method in chosen:
        check_name("The method", method, tuple(STEPS))
    opened = open_device(device)
    timed = timed_size or ("1920x1080" if opened.name == "cuda" else size)
    title = _title(opened, size, frames, first, reference_spp)
    title += f"; ms: two signals at {timed}; x: times what is left with every step, ms of a step: what it takes"
    times = measure_times(opened, parse_size(timed), chosen)
    scenes = _measure_scenes(
        opened, files, size, frames, first, reference_spp, lambda count: frames_of(chosen, count),
        lambda *scene, step: measure(opened, *scene, times, chosen, render_variants, step),
    )  # fmt: skip
    rows: list[Ablation] = []
    # Each scene's rows when they are there: all of them take minutes.
    for of_scene in scenes:
        if not as_json:
            show(*([] if rows else [title]), *_ablation_tables(of_scene))
        rows += of_scene
        write_files(title, rows, csv_file, plot_file, plot)
    if as_json:
        print_json(title, rows, notes=NOTES)
    else:
        show(*NOTES)


def _ablation_tables(rows: Sequence[Ablation]) -> list[Table]:
    from ..bench.ablation import WHOLE, gains

    lines: dict[str, list[tuple[str, ...]]] = {}
    for row, (*ratios, cost) in zip(rows, gains(rows), strict=True):
        whole = row.off == WHOLE
        errors = zip((row.relmse, row.flip, row.flicker), ratios, strict=True)
        figures = [text for error, ratio in errors for text in (f"{error:.4f}", "" if whole else f"{ratio:.2f}")]
        milliseconds = f"{row.milliseconds:.3f}" if whole else f"{cost:+.3f}"
        lines.setdefault(row.scene, []).append((row.method, "-" if whole else row.off, *figures, milliseconds))
    headings = ("without", "relMSE", "x", "FLIP", "x", "flicker", "x", "ms")
    return [
        table((scene, *headings), of_scene, names=2, section=lambda line: line[0]) for scene, of_scene in lines.items()
    ]


def _title(device: Device, size: str, frames: str, first: int, reference_spp: int) -> str:
    return f"{device.description} ({device.name}), {size}, frames {first} on of {frames}, truth {reference_spp} spp"


def _measure_scenes(
    device: Device,
    files: list[Path] | None,
    size: str,
    frames: str,
    first: int,
    reference_spp: int,
    frames_of: Callable[[int], int],
    measure: Callable[..., Sequence[Any]],
) -> Iterator[Sequence[Any]]:
    """The rows of each scene, of which measure(settings, name, scenes, references, step=) renders frames_of(its frames)
    frames."""
    from ..bench.accuracy import converge
    from ..settings import Settings
    from .progress import progress_bar, render_frame

    paths, image_size = scene_paths(files), parse_size(size)
    settings = Settings(*image_size)
    for path in paths:
        scenes, measured = read_animation(path, frames, first, image_size)
        with progress_bar(f"{path.stem}: truth", len(measured)) as bar:
            references = converge(device, settings, measured, reference_spp, render_frame, bar.step)
        with progress_bar(f"{path.stem}: denoised", frames_of(len(scenes))) as bar:
            rows = measure(settings, path.stem, scenes, references, step=bar.step)
        yield rows


def _four_digits(*values: float) -> list[str]:
    return [f"{value:.4f}" for value in values]
