# SPDX-License-Identifier: Apache-2.0
"""``svgf bench accuracy`` and ``svgf bench ablation``: the error that is left beside the time that was spent."""

from __future__ import annotations

from typing import Annotated

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
    from ..bench.accuracy import VARIANTS, Accuracy, converge, measure, plot
    from ..devices import open_device
    from ..settings import Settings
    from .progress import progress_bar, render_frame

    paths = scene_paths(files)
    image_size = parse_size(size)
    settings = Settings(*image_size)
    opened = open_device(device)
    variants = [variant for variant in VARIANTS if not quick or variant[1] == 1]
    rows: list[Accuracy] = []
    for path in paths:
        scenes, measured = read_animation(path, frames, first, image_size)
        with progress_bar(f"{path.stem}: truth", len(measured)) as bar:
            references = converge(opened, settings, measured, reference_spp, render_frame, bar.step)
        with progress_bar(f"{path.stem}: variants", len(scenes) * len(variants)) as bar:
            rows += measure(opened, settings, path.stem, scenes, references, variants, render_frame, bar.step)
    publish(
        f"{opened.description} ({opened.name}), {size}, frames {first} on of {frames}, truth {reference_spp} spp",
        rows,
        table(
            ("scene", "method", "spp", "ms", "relMSE", "FLIP", "SSIM", "flicker"),
            [
                (
                    row.scene,
                    row.method,
                    str(row.samples),
                    f"{row.milliseconds:.3f}",
                    *(f"{value:.4f}" for value in (row.relmse, row.flip, row.ssim, row.flicker)),
                )
                for row in rows
            ],
            names=2,
            section=lambda line: line[0],
        ),
        csv_file=csv_file,
        plot_file=plot_file,
        plot=plot,
        as_json=as_json,
    )


def ablation(
    files: FilesArgument = None,
    size: ImageSizeOption = "480x270",
    device: DeviceOption = "auto",
    methods: MethodsOption = None,
    frames: FramesOption = "1-16",
    first: FirstOption = 5,
    reference_spp: ReferenceOption = 1024,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """What each step of the denoiser gives and costs: relMSE, FLIP, flicker and milliseconds without it."""
    from ..bench.ablation import STEPS, Ablation, measure, plot, rows_of
    from ..bench.accuracy import converge
    from ..devices import open_device
    from ..settings import Settings, check_name
    from .progress import progress_bar, render_frame

    paths = scene_paths(files)
    image_size = parse_size(size)
    chosen = methods or list(STEPS)
    for method in chosen:
        check_name("The method", method, tuple(STEPS))
    settings = Settings(*image_size)
    opened = open_device(device)
    rows: list[Ablation] = []
    for path in paths:
        scenes, measured = read_animation(path, frames, first, image_size)
        with progress_bar(f"{path.stem}: truth", len(measured)) as bar:
            references = converge(opened, settings, measured, reference_spp, render_frame, bar.step)
        with progress_bar(f"{path.stem}: steps", len(scenes) * len(rows_of(chosen))) as bar:
            rows += measure(opened, settings, path.stem, scenes, references, chosen, render_frame, bar.step)
    publish(
        f"{opened.description} ({opened.name}), {size}, frames {first} on of {frames}, truth {reference_spp} spp",
        rows,
        table(
            ("scene", "method", "without", "relMSE", "FLIP", "flicker", "ms"),
            [
                (
                    row.scene,
                    row.method,
                    row.off if row.off != "whole" else "-",
                    *(f"{value:.4f}" for value in (row.relmse, row.flip, row.flicker, row.milliseconds)),
                )
                for row in rows
            ],
            names=3,
            section=lambda line: line[:2],
        ),
        csv_file=csv_file,
        plot_file=plot_file,
        plot=plot,
        as_json=as_json,
    )
