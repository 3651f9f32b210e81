# SPDX-License-Identifier: Apache-2.0
"""``svgf bench``: measurements."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from .options import DeviceOption, JsonOption, parse_size

if TYPE_CHECKING:
    from ..bench.ablation import Ablation
    from ..bench.accuracy import Accuracy
    from ..bench.denoise import BufferSize, StageCost
    from ..bench.stages import StageTime
    from ..renderer import Renderer
    from ..scene import Scene

app = typer.Typer(help="Measure what a frame costs.", no_args_is_help=True)


@app.callback()
def bench() -> None:
    """Measure what a frame costs."""


@app.command()
def stages(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Scenes; those that come with svgf by default.", show_default=False)
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")] = "1920x1080",
    device: DeviceOption = "auto",
    method: Annotated[str, typer.Option(metavar="NAME", help="svgf+, svgf, eaw or none.")] = "svgf+",
    bounces: Annotated[
        int | None, typer.Option(metavar="N", help="Light bounces. Default: what the file says.")
    ] = None,
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Frames to measure.")] = 32,
    warm_up: Annotated[int, typer.Option(metavar="N", min=0, help="Frames before them.")] = 8,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Median milliseconds of every stage at one sample per pixel, for each scene."""
    from ..bench.stages import measure
    from ..devices import open_device
    from ..io.files import replacing
    from ..renderer import Renderer
    from ..settings import Settings
    from .progress import progress_bar, render_frame

    paths = _paths(files)
    image_size = parse_size(size)
    settings = Settings(*image_size, method=method, bounces=bounces)
    opened = open_device(device)
    times: list[StageTime] = []
    with progress_bar("Measuring", (warm_up + count) * len(paths)) as bar:
        for path in paths:
            scenes, export_ms = _read(path, image_size, warm_up + count)
            renderer: Renderer = Renderer(settings, opened)
            times += measure(
                renderer, path.stem, scenes, count, warm_up, export_ms, partial(render_frame, renderer), bar.step
            )
    if csv_file is not None:
        with replacing(csv_file) as file:
            file.write(_csv(times).encode())
    if as_json:
        result = {"device": opened.name, "description": opened.description, "size": list(image_size), "method": method}
        typer.echo(json.dumps({**result, "stages": [asdict(row) for row in times]}, indent=1))
    else:
        _print_table(times, f"{opened.description} ({opened.name}), {size}, {method}: median ms of {count} frames")


@app.command()
def accuracy(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Scenes; those that come with svgf by default.", show_default=False)
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")] = "960x540",
    device: DeviceOption = "auto",
    frames: Annotated[str, typer.Option("--frames", metavar="A-B", help="Consecutive frames to render.")] = "1-16",
    first: Annotated[int, typer.Option(metavar="N", help="The first frame that is measured.")] = 5,
    reference_spp: Annotated[int, typer.Option(metavar="N", min=1, help="Samples per pixel of the truth.")] = 1024,
    quick: Annotated[bool, typer.Option("--quick", help="Only 1 sample per pixel, and the input of svgf.")] = False,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")
    ] = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw error against time as a PNG.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """What accuracy costs in time: relMSE, FLIP and flicker against milliseconds, for each method and sample count."""
    from ..bench.accuracy import VARIANTS, converge, measure, plot
    from ..devices import open_device
    from ..frame_range import parse_frames
    from ..io.files import replacing
    from ..settings import Settings
    from .progress import progress_bar, render_frame
    from .sources import open_scenes

    paths = _paths(files)
    image_size = parse_size(size)
    settings = Settings(*image_size)
    opened = open_device(device)
    variants = [variant for variant in VARIANTS if not quick or variant[1] == 1]
    rows: list[Accuracy] = []
    for path in paths:
        with open_scenes(path, parse_frames(frames), image_size) as source:
            scenes = list(source)
        measured = [scene for scene in scenes if scene.frame >= first]
        with progress_bar(f"{path.stem}: truth", len(measured)) as bar:
            references = converge(opened, settings, measured, reference_spp, render_frame, bar.step)
        with progress_bar(f"{path.stem}: variants", len(scenes) * len(variants)) as bar:
            rows += measure(opened, settings, path.stem, scenes, references, variants, render_frame, bar.step)
    title = f"{opened.description} ({opened.name}), {size}, frames {first} on of {frames}, truth {reference_spp} spp"
    if csv_file is not None:
        with replacing(csv_file) as file:
            file.write(_csv(rows).encode())
    if plot_file is not None:
        with replacing(plot_file) as file:
            file.write(plot(rows, title))
    if as_json:
        typer.echo(json.dumps({"title": title, "rows": [asdict(row) for row in rows]}, indent=1))
    else:
        _print_accuracy(rows, title)


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
    if as_json:
        typer.echo(json.dumps([asdict(row) for row in rows], indent=1))
    else:
        _print_export(rows)


@app.command()
def denoise(
    sizes: Annotated[
        list[str] | None,
        typer.Option("--size", metavar="WxH", help="Pixels; may be given again. Default: 720p, 1080p and 2160p."),
    ] = None,
    device: DeviceOption = "auto",
    methods: Annotated[
        list[str] | None, typer.Option("--method", metavar="NAME", help="May be given again.", show_default=False)
    ] = None,
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Frames to measure.")] = 64,
    warm_up: Annotated[int, typer.Option(metavar="N", min=0, help="Frames before them.")] = 16,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")
    ] = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw milliseconds beside the copy's as a PNG.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """The denoiser alone: milliseconds, bytes and bandwidth of every stage beside a plain copy's, and its memory."""
    from ..bench.denoise import SIZES, BufferSize, StageCost, measure, plot
    from ..devices import open_device
    from ..io.files import replacing
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
    title = f"{opened.description} ({opened.name}): median ms of {count} frames"
    if csv_file is not None:
        with replacing(csv_file) as file:
            file.write(_csv(costs).encode())
    if plot_file is not None:
        with replacing(plot_file) as file:
            file.write(plot(costs, title))
    if as_json:
        rows = {"stages": [asdict(row) for row in costs], "buffers": [asdict(row) for row in buffers]}
        typer.echo(json.dumps({"title": title, **rows}, indent=1))
    else:
        _print_denoise(costs, buffers, title)


@app.command()
def ablation(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Scenes; those that come with svgf by default.", show_default=False)
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")] = "480x270",
    device: DeviceOption = "auto",
    methods: Annotated[
        list[str] | None,
        typer.Option("--method", metavar="NAME", help="May be given again. Default: all.", show_default=False),
    ] = None,
    frames: Annotated[str, typer.Option("--frames", metavar="A-B", help="Consecutive frames to render.")] = "1-16",
    first: Annotated[int, typer.Option(metavar="N", help="The first frame that is measured.")] = 5,
    reference_spp: Annotated[int, typer.Option(metavar="N", min=1, help="Samples per pixel of the truth.")] = 1024,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")
    ] = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw what each step gives as a PNG.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """What each step of the denoiser gives and costs: relMSE, FLIP, flicker and milliseconds without it."""
    from ..bench.ablation import STEPS, Ablation, measure, plot, rows_of
    from ..bench.accuracy import converge
    from ..devices import open_device
    from ..frame_range import parse_frames
    from ..io.files import replacing
    from ..settings import Settings, check_name
    from .progress import progress_bar, render_frame
    from .sources import open_scenes

    paths = _paths(files)
    image_size = parse_size(size)
    chosen = methods or list(STEPS)
    for method in chosen:
        check_name("The method", method, tuple(STEPS))
    settings = Settings(*image_size)
    opened = open_device(device)
    rows: list[Ablation] = []
    for path in paths:
        with open_scenes(path, parse_frames(frames), image_size) as source:
            scenes = list(source)
        measured = [scene for scene in scenes if scene.frame >= first]
        with progress_bar(f"{path.stem}: truth", len(measured)) as bar:
            references = converge(opened, settings, measured, reference_spp, render_frame, bar.step)
        with progress_bar(f"{path.stem}: steps", len(scenes) * len(rows_of(chosen))) as bar:
            rows += measure(opened, settings, path.stem, scenes, references, chosen, render_frame, bar.step)
    title = f"{opened.description} ({opened.name}), {size}, frames {first} on of {frames}, truth {reference_spp} spp"
    if csv_file is not None:
        with replacing(csv_file) as file:
            file.write(_csv(rows).encode())
    if plot_file is not None:
        with replacing(plot_file) as file:
            file.write(plot(rows, title))
    if as_json:
        typer.echo(json.dumps({"title": title, "rows": [asdict(row) for row in rows]}, indent=1))
    else:
        _print_ablation(rows, title)


@app.command()
def rays(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Scenes besides the generated ones.", show_default=False)
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="One ray of each kind per pixel.")] = "1920x1080",
    device: DeviceOption = "auto",
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Launches of each kind.")] = 16,
    mitsuba: Annotated[bool, typer.Option("--mitsuba", help="Trace the same rays with Mitsuba 3, too.")] = False,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")
    ] = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw rays per second as a PNG.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Rays per second in generated rooms, a Cornell box at three depths, and what scenes cost to build and update."""
    from ..bench.rays import measure, plot
    from ..devices import open_device

    image_size = parse_size(size)
    opened = open_device(device)
    scenes = [(path.stem, _read(path, image_size, 1)[0][0]) for path in files or ()]
    rows = measure(opened, scenes, image_size, count, mitsuba)
    title = f"{opened.description} ({opened.name}), {size}: medians of {count} launches"
    _write(rows, csv_file, plot_file, lambda: plot(rows, title))
    if as_json:
        typer.echo(json.dumps({"title": title, "rows": [asdict(row) for row in rows]}, indent=1))
        return
    _print_rows(
        title,
        ("scene", "what", "triangles", "ms", "Grays/s"),
        [
            (row.scene, row.what, f"{row.triangles:,}", f"{row.milliseconds:.3f}", f"{row.gigarays:.3f}" if row.rays else "")
            for row in rows
        ],
    )


@app.command()
def effects(
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="Scenes; Mitsuba's Cornell box and those that come with svgf by default.", show_default=False),
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")] = "1920x1080",
    device: DeviceOption = "auto",
    bounces: Annotated[
        int | None, typer.Option(metavar="N", help="Light bounces. Default: what the file says.")
    ] = None,
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Frames to measure, with and without.")] = 16,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")
    ] = None,
    plot_file: Annotated[Path | None, typer.Option("--plot", metavar="FILE", help="Draw them as a PNG.")] = None,
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
    scenes = [(path.stem, _read(path, image_size, 2)[0][-1]) for path in _paths(files)]
    if not files:
        scenes.insert(0, ("cornell_box", cornell_box(image_size)))
    rows = []
    with progress_bar("Measuring", len(scenes)) as bar:
        for name, scene in scenes:
            rows += measure(opened, name, scene, image_size, bounces, count)
            bar.step()
    title = f"{opened.description} ({opened.name}), {size}, 1 sample per pixel: medians of {count} frames"
    _write(rows, csv_file, plot_file, lambda: plot(rows, title))
    if as_json:
        typer.echo(json.dumps({"title": title, "rows": [asdict(row) for row in rows]}, indent=1))
        return
    _print_rows(
        title,
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
    )


def _write(rows: Sequence, csv_file: Path | None, plot_file: Path | None, plot: Callable[[], bytes]) -> None:
    from ..io.files import replacing

    if csv_file is not None:
        with replacing(csv_file) as file:
            file.write(_csv(rows).encode())
    if plot_file is not None:
        with replacing(plot_file) as file:
            file.write(plot())


def _print_rows(title: str, headings: Sequence[str], rows: Sequence[tuple[str, ...]]) -> None:
    """A table whose first two columns are names; a line between scenes."""
    from rich.console import Console
    from rich.table import Table

    table = Table()
    for index, heading in enumerate(headings):
        table.add_column(heading, justify="left" if index < 2 else "right")
    last = rows[0][0]
    for row in rows:
        if row[0] != last:
            table.add_section()
            last = row[0]
        table.add_row(*row)
    console = Console(highlight=False)
    console.print(title, markup=False, soft_wrap=True)
    console.print(table)


def _paths(files: list[Path] | None) -> list[Path]:
    from .sources import shipped_scenes

    paths = files or list(shipped_scenes().values())
    if not paths:
        raise InputError("This installation of svgf has no scenes.", "Install svgf again, or give files.")
    return paths


def _read(path: Path, size: tuple[int, int], most: int) -> tuple[list[Scene], list[float]]:
    """As many frames as will be rendered at most, and what each took to export (.blend only)."""
    from .sources import open_scenes

    with open_scenes(path, None, size) as scenes:
        timed = list(_timed(scenes, most))
    exported = path.suffix.lower() == ".blend"
    # The first frame opens the file and exports what later ones share.
    return [scene for scene, _ in timed], [ms for _, ms in timed[1:]] if exported else []


def _timed(scenes: Iterator[Scene], most: int) -> Iterator[tuple[Scene, float]]:
    for _ in range(most):
        start = time.perf_counter()
        scene = next(scenes, None)
        if scene is None:
            return
        yield scene, (time.perf_counter() - start) * 1e3


def _csv(rows: Sequence) -> str:
    """rows: of one dataclass."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(rows[0])], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return text.getvalue()


def _print_table(times: list[StageTime], title: str) -> None:
    from rich.console import Console
    from rich.table import Table

    from ..bench.stages import DENOISE_TOTAL

    medians = {(row.scene, row.stage): row.median for row in times}
    scenes = list(dict.fromkeys(row.scene for row in times))
    stages = list(dict.fromkeys(row.stage for row in times))
    # The sums of one scene may precede a stage that only a later scene has.
    stages.sort(key=lambda stage: stage in {row.stage for row in times[-2:]})
    table = Table()
    table.add_column("stage")
    for scene in scenes:
        table.add_column(scene, justify="right")
    for stage in stages:
        if stage == DENOISE_TOTAL:
            table.add_section()
        table.add_row(
            stage, *(f"{medians[scene, stage]:.3f}" if (scene, stage) in medians else "-" for scene in scenes)
        )
    console = Console(highlight=False)
    console.print(title, markup=False, soft_wrap=True)
    console.print(table)


def _print_accuracy(rows: list[Accuracy], title: str) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("scene", "method")
    for heading in ("spp", "ms", "relMSE", "FLIP", "SSIM", "flicker"):
        table.add_column(heading, justify="right")
    last = rows[0].scene
    for row in rows:
        if row.scene != last:
            table.add_section()
            last = row.scene
        errors = (f"{value:.4f}" for value in (row.relmse, row.flip, row.ssim, row.flicker))
        table.add_row(row.scene, row.method, str(row.samples), f"{row.milliseconds:.3f}", *errors)
    console = Console(highlight=False)
    console.print(title, markup=False, soft_wrap=True)
    console.print(table)


def _print_export(rows: Sequence[Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("change")
    for heading in ("ms", "processor ms", *(field.name for field in fields(rows[0])[3:])):
        table.add_column(heading, justify="right")
    for row in rows:
        change, milliseconds, processor_milliseconds, *counts = asdict(row).values()
        table.add_row(change, f"{milliseconds:.2f}", f"{processor_milliseconds:.2f}", *map(str, counts))
    Console(highlight=False).print(table)


def _print_ablation(rows: list[Ablation], title: str) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("scene", "method", "without")
    for heading in ("relMSE", "FLIP", "flicker", "ms"):
        table.add_column(heading, justify="right")
    last = rows[0]
    for row in rows:
        if (row.scene, row.method) != (last.scene, last.method):
            table.add_section()
            last = row
        figures = (f"{value:.4f}" for value in (row.relmse, row.flip, row.flicker, row.milliseconds))
        table.add_row(row.scene, row.method, row.off if row.off != "whole" else "-", *figures)
    console = Console(highlight=False)
    console.print(title, markup=False, soft_wrap=True)
    console.print(table)


def _print_denoise(costs: list[StageCost], buffers: list[BufferSize], title: str) -> None:
    from rich.console import Console
    from rich.table import Table

    from ..bench.denoise import ALL

    table = Table()
    for heading in ("method", "size", "signals", "stage"):
        table.add_column(heading, no_wrap=True)
    for heading in ("ms", "B/pixel", "GB/s", "copy, ms"):
        table.add_column(heading, justify="right", no_wrap=True)
    for cost in costs:
        table.add_row(
            cost.method,
            f"{cost.width}x{cost.height}",
            str(cost.signals),
            cost.stage,
            f"{cost.milliseconds:.4f}",
            f"{cost.bytes / (cost.width * cost.height):.0f}",
            f"{cost.bandwidth:.0f}",
            f"{cost.floor_milliseconds:.4f}",
            end_section=cost.stage == ALL,
        )
    memory = Table("method", "signals", "buffer")
    memory.add_column("B/pixel", justify="right")
    cases = list(dict.fromkeys((row.method, row.signals) for row in buffers))
    for method, signals in cases:
        # The largest image, where what does not grow with it counts least.
        rows = [row for row in buffers if (row.method, row.signals) == (method, signals)]
        rows = [row for row in rows if (row.width, row.height) == (rows[-1].width, rows[-1].height)]
        for row in rows:
            memory.add_row(method, str(signals), row.buffer, f"{row.bytes_per_pixel:.2f}")
        total = sum(row.bytes_per_pixel for row in rows)
        memory.add_row(method, str(signals), "all", f"{total:.2f}", end_section=True)
    console = Console(highlight=False, width=110)  # also in a file or a narrow window: figures are not cut
    console.print(title, markup=False, soft_wrap=True)
    console.print(table)
    console.print(memory)
