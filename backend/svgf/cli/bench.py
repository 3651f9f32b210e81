# SPDX-License-Identifier: Apache-2.0
"""``svgf bench``: measurements."""

from __future__ import annotations

from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from .bench_accuracy import ablation, accuracy
from .bench_scenes import (
    BouncesOption,
    CountOption,
    FilesArgument,
    ImageSizeOption,
    MethodOption,
    MethodsOption,
    SizesOption,
    WarmUpOption,
    read_frames,
    scene_paths,
)
from .options import DeviceOption, JsonOption, parse_size
from .report import CsvOption, PlotOption, publish, table

app = typer.Typer(help="Measure what a frame costs.", no_args_is_help=True)

@app.callback()
def bench() -> None:
    """Measure what a frame costs."""


@app.command()
def stages(
    files: FilesArgument = None,
    size: ImageSizeOption = "1920x1080",
    device: DeviceOption = "auto",
    method: MethodOption = "svgf+",
    bounces: BouncesOption = None,
    count: CountOption = 32,
    warm_up: WarmUpOption = 8,
    csv_file: CsvOption = None,
    as_json: JsonOption = False,
) -> None:
    """Median milliseconds of every stage at one sample per pixel, for each scene."""
    from ..bench.stages import DENOISE_TOTAL, WHOLE_FRAME, StageTime, measure
    from ..devices import open_device
    from ..renderer import Renderer
    from ..settings import Settings
    from .progress import progress_bar, render_frame

    paths = scene_paths(files)
    image_size = parse_size(size)
    settings = Settings(*image_size, method=method, bounces=bounces)
    opened = open_device(device)
    times: list[StageTime] = []
    with progress_bar("Measuring", (warm_up + count) * len(paths)) as bar:
        for path in paths:
            scenes, export_ms = read_frames(path, image_size, warm_up + count)
            renderer: Renderer = Renderer(settings, opened)
            times += measure(
                renderer, path.stem, scenes, count, warm_up, export_ms, partial(render_frame, renderer), bar.step
            )
    medians = {(row.scene, row.stage): f"{row.median:.3f}" for row in times}
    names = list(dict.fromkeys(row.scene for row in times))
    sums = (DENOISE_TOTAL, WHOLE_FRAME)
    rows = [stage for stage in dict.fromkeys(row.stage for row in times) if stage not in sums] + list(sums)
    publish(
        f"{opened.description} ({opened.name}), {size}, {method}: median ms of {count} frames",
        times,
        table(
            ("stage", *names),
            [(stage, *(medians.get((name, stage), "-") for name in names)) for stage in rows],
            section=lambda line: line[0] in sums,
        ),
        csv_file=csv_file,
        as_json=as_json,
    )


@app.command()
def resolution(
    files: FilesArgument = None,
    sizes: SizesOption = None,
    device: DeviceOption = "auto",
    method: MethodOption = "svgf+",
    bounces: BouncesOption = None,
    count: CountOption = 16,
    warm_up: WarmUpOption = 6,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """What resolution costs: milliseconds of tracing and denoising from 480x270 to 3840x2160."""
    from ..bench.resolution import SIZES, ResolutionCost, measure, plot
    from ..devices import open_device
    from ..settings import Settings
    from .progress import progress_bar, render_frame

    paths = scene_paths(files)
    image_sizes = [parse_size(size) for size in sizes] if sizes else SIZES
    opened = open_device(device)
    rows: list[ResolutionCost] = []
    with progress_bar("Measuring", (warm_up + count) * len(image_sizes) * len(paths)) as bar:
        for path in paths:
            scenes, _ = read_frames(path, image_sizes[0], warm_up + count)
            settings = Settings(*image_sizes[0], method=method, bounces=bounces)
            rows += measure(
                opened, settings, path.stem, scenes, image_sizes, count, warm_up, render_frame, bar.step
            )
    publish(
        f"{opened.description} ({opened.name}), {method}, 1 sample per pixel: median ms of {count} frames",
        rows,
        table(
            ("scene", "size", "trace", "denoise", "whole frame", "ns/pixel"),
            [
                (
                    row.scene,
                    f"{row.width}x{row.height}",
                    *(f"{ms:.3f}" for ms in (row.trace, row.denoise, row.whole)),
                    f"{row.nanoseconds_per_pixel():.2f}",
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


app.command()(accuracy)


@app.command()
def export(
    tries: Annotated[
        int, typer.Option(metavar="N", min=1, help="Each change is measured so often; the best counts.")
    ] = 5,
    as_json: JsonOption = False,
) -> None:
    """What it costs to bring a change in Blender to the renderer: milliseconds, and how much is exported."""
    from .progress import silence
    from .sources import load_export_timings

    with silence(1):
        rows = load_export_timings()(tries)
    lines = []
    for row in rows:
        change, milliseconds, processor_milliseconds, *counts = asdict(row).values()
        lines.append((change, f"{milliseconds:.2f}", f"{processor_milliseconds:.2f}", *map(str, counts)))
    publish(
        f"Changes in Blender, the best of {tries}",
        rows,
        table(("change", "ms", "processor ms", *(field.name for field in fields(rows[0])[3:])), lines),
        as_json=as_json,
    )


@app.command()
def denoise(
    sizes: SizesOption = None,
    device: DeviceOption = "auto",
    methods: MethodsOption = None,
    count: CountOption = 64,
    warm_up: WarmUpOption = 16,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """The denoiser alone: milliseconds, bytes and bandwidth of every stage beside a plain copy's, and its memory."""
    from ..bench.denoise import SIZES, BufferSize, StageCost, growths, measure, plot
    from ..devices import open_device
    from .progress import progress_bar

    opened = open_device(device)
    cases = [
        (method, size, signals)
        for method in methods or ["svgf+"]
        for size in ([parse_size(size) for size in sizes] if sizes else SIZES)
        for signals in (1, 2)
    ]
    costs: list[StageCost] = []
    buffers: list[BufferSize] = []
    with progress_bar("Measuring", (warm_up + count) * len(cases)) as bar:
        for method, image_size, signals in cases:
            more_costs, more_buffers = measure(opened, method, image_size, signals, count, warm_up, step=bar.step)
            costs += more_costs
            buffers += more_buffers
    stage_lines = [
        (
            cost.method,
            f"{cost.width}x{cost.height}",
            str(cost.signals),
            cost.stage,
            f"{cost.milliseconds:.4f}",
            f"{cost.bytes / (cost.width * cost.height):.0f}",
            f"{cost.bandwidth:.0f}",
            f"{cost.floor_milliseconds:.4f}",
        )
        for cost in costs
    ]
    # Of the largest image, where what does not grow with it counts least.
    largest = max((row.width, row.height) for row in buffers)
    memory: dict[tuple[str, str], dict[str, float]] = {}
    for row in buffers:
        if (row.width, row.height) == largest:
            memory.setdefault((row.method, str(row.signals)), {})[row.buffer] = row.bytes_per_pixel
    memory_lines = [
        (*case, buffer, f"{bytes_per_pixel:.2f}")
        for case, sizes_of in memory.items()
        for buffer, bytes_per_pixel in {**sizes_of, "all": sum(sizes_of.values())}.items()
    ]
    publish(
        f"{opened.description} ({opened.name}): median ms of {count} frames",
        costs,
        table(
            ("method", "size", "signals", "stage", "ms", "B/pixel", "GB/s", "copy, ms"),
            stage_lines,
            names=4,
            section=lambda line: line[:3],
        ),
        table(
            ("method", "signals", "from", "to", "pixels", "time"),
            [
                (
                    row.method,
                    str(row.signals),
                    row.smaller,
                    row.larger,
                    f"x {row.pixels:.2f}",
                    f"x {row.milliseconds:.2f}",
                )
                for row in growths(costs)
            ],
            names=4,
        ),
        table(("method", "signals", "buffer", "B/pixel"), memory_lines, names=3, section=lambda line: line[:2]),
        csv_file=csv_file,
        plot_file=plot_file,
        plot=plot,
        as_json=as_json,
        growths=[asdict(row) for row in growths(costs)],
        buffers=[asdict(row) for row in buffers],
    )


app.command()(ablation)


@app.command()
def rays(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Scenes besides the generated ones.", show_default=False)
    ] = None,
    size: ImageSizeOption = "1920x1080",
    device: DeviceOption = "auto",
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Launches of each kind.")] = 16,
    mitsuba: Annotated[bool, typer.Option("--mitsuba", help="Trace the same rays with Mitsuba 3, too.")] = False,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rays per second in generated rooms, a Cornell box at three depths, and what scenes cost to build and update."""
    from ..bench.rays import measure, plot
    from ..devices import open_device

    image_size = parse_size(size)
    opened = open_device(device)
    scenes = [(path.stem, read_frames(path, image_size, 1)[0][0]) for path in files or ()]
    rows = measure(opened, scenes, image_size, count, mitsuba)
    publish(
        f"{opened.description} ({opened.name}), {size}: medians of {count} launches",
        rows,
        table(
            ("scene", "what", "triangles", "ms", "Grays/s"),
            [
                (
                    row.scene,
                    row.what,
                    f"{row.triangles:,}",
                    f"{row.milliseconds:.3f}",
                    f"{row.gigarays:.3f}" if row.rays else "",
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


@app.command()
def effects(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Scenes; Mitsuba's Cornell box and those that come with svgf by default.", show_default=False
        ),
    ] = None,
    size: ImageSizeOption = "1920x1080",
    device: DeviceOption = "auto",
    bounces: BouncesOption = None,
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Frames to measure, with and without.")] = 16,
    csv_file: CsvOption = None,
    plot_file: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """What each effect of a scene costs, and what the kernel that simulates everything would."""
    from ..bench.effects import measure, plot
    from ..bench.generated import cornell_box
    from ..devices import open_device
    from .progress import progress_bar

    image_size = parse_size(size)
    opened = open_device(device)
    # The second frame: what moves in the scene has moved.
    scenes = [(path.stem, read_frames(path, image_size, 2)[0][-1]) for path in scene_paths(files)]
    if not files:
        scenes.insert(0, ("cornell_box", cornell_box(image_size)))
    rows = []
    with progress_bar("Measuring", len(scenes)) as bar:
        for name, scene in scenes:
            rows += measure(opened, name, scene, image_size, bounces, count)
            bar.step()
    publish(
        f"{opened.description} ({opened.name}), {size}, 1 sample per pixel: medians of {count} frames",
        rows,
        table(
            ("scene", "effect", "ms on", "ms off", "cost", "B/pixel on", "B/pixel off"),
            [
                (
                    row.scene,
                    row.what.lower().replace("_", " "),
                    f"{row.on_ms:.3f}",
                    f"{row.off_ms:.3f}",
                    f"{row.on_ms - row.off_ms:+.3f}",
                    f"{row.on_bytes:.0f}",
                    f"{row.off_bytes:.0f}",
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


@app.command()
def cycles(
    files: Annotated[list[Path], typer.Argument(metavar="FILE.blend...", help="Scenes.", show_default=False)],
    size: ImageSizeOption = "960x540",
    bounces: BouncesOption = None,
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Frames to measure with each renderer.")] = 5,
    csv_file: CsvOption = None,
    as_json: JsonOption = False,
) -> None:
    """Cycles against svgf on the CPU: the first frame of each file at one sample per pixel, in turns."""
    from ..bench.cycles import CyclesComparison, measure
    from ..devices import open_device
    from .progress import progress_bar, silence
    from .sources import load_exporter

    export_file = load_exporter()
    image_size = parse_size(size)
    rows: list[CyclesComparison] = []
    with progress_bar("Measuring", (1 + count) * len(files)) as bar:
        for path in files:
            with silence(1):
                rows.append(measure(path, export_file, image_size, bounces, count, bar.step))
    publish(
        f"{open_device('cpu').description}, {size}, 1 sample per pixel: median ms of {count} frames",
        rows,
        table(
            ("scene", "svgf", "Cycles", "faster", "svgf, all cores", "Cycles, all cores", "faster"),
            [
                (
                    row.scene,
                    f"{row.wall:.0f}",
                    f"{row.cycles_wall:.0f}",
                    f"{row.wall_ratio:.2f}x",
                    f"{row.processor:.0f}",
                    f"{row.cycles_processor:.0f}",
                    f"{row.processor_ratio:.2f}x",
                )
                for row in rows
            ],
        ),
        csv_file=csv_file,
        as_json=as_json,
    )
