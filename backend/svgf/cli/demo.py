# SPDX-License-Identifier: Apache-2.0
"""``svgf demo``: one command to a denoised picture."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import DeviceOption

if TYPE_CHECKING:
    from ..frame import Frame

_SIZE = (384, 216)
# Enough for the temporal mean to settle, and for the reference's own noise to be small beside what is measured.
_FRAMES = 12
_REFERENCE_SAMPLES = 128


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the pictures.")] = Path(
        "svgf-demo"
    ),
    scene: Annotated[str, typer.Option(metavar="NAME", help="A scene that comes with svgf.")] = "cornell",
    device: DeviceOption = "auto",
) -> None:
    """Render a small animation at one sample per pixel, and show it noisy, denoised and with many samples."""
    from rich.console import Console
    from rich.table import Table

    from ..devices import open_device
    from ..io import exr, files, label, png
    from ..metrics import relative_mse
    from ..renderer import Renderer
    from ..scene_file import SceneFile
    from ..settings import Settings
    from .progress import progress_bar, render_frame
    from .render import describe
    from .sources import open_scenes, shipped_scene

    start = time.perf_counter()
    path = shipped_scene(scene)
    opened = open_device(device)
    files.make_folder(output)
    with SceneFile(path) as file:
        frames = file.frames[:_FRAMES]

    renderer = Renderer(Settings(*_SIZE), opened)
    with (
        progress_bar("1 sample per pixel", len(frames)) as bar,
        open_scenes(path, frames, _SIZE, bar.report) as scenes,
    ):
        for current in scenes:
            frame = render_frame(renderer, current, bar.part)
    with progress_bar(f"{_REFERENCE_SAMPLES} samples per pixel", 1) as bar:
        settings = replace(renderer.settings, samples=_REFERENCE_SAMPLES, method="none", pixel_filter="center", seed=1)
        reference = render_frame(Renderer(settings, opened), current, bar.part)

    panels = {
        "1 sample per pixel": frame.noisy,
        "denoised": frame.color,
        f"{_REFERENCE_SAMPLES} samples per pixel": reference.color,
    }
    picture, image = output / "comparison.png", output / f"{scene}_{frame.frame:04d}.exr"
    png.write(label.beside([(text, png.display(pixels)) for text, pixels in panels.items()], scale=2), picture)
    png.write(png.display(frame.color), image.with_suffix(".png"))
    exr.write(frame, image, metadata=describe(renderer, current, frame))

    noisy_error, error = relative_mse(frame.noisy, reference.color), relative_mse(frame.color, reference.color)
    table = Table(show_header=False)
    table.add_column(justify="left")
    table.add_column(justify="right")
    table.add_row("device", f"{opened.name}: {opened.description}")
    table.add_row("relMSE, 1 sample per pixel", f"{noisy_error:.4f}")
    table.add_row("relMSE, denoised", f"{error:.4f} ({noisy_error / error:.0f} times less)" if error > 0 else "0")
    for name, milliseconds in _times(frame).items():
        table.add_row(f"{name}, last frame", f"{milliseconds:.1f} ms")
    table.add_row(f"{_REFERENCE_SAMPLES} samples per pixel", f"{sum(reference.timings.values()):.0f} ms")
    table.add_row("whole demo", f"{time.perf_counter() - start:.1f} s")
    console = Console(highlight=False)
    console.print(f"{scene}, frame {frame.frame}, {_SIZE[0]}x{_SIZE[1]}")
    console.print(table)
    for written in (picture, image.with_suffix(".png"), image):
        console.print(str(written), markup=False, soft_wrap=True)


def _times(frame: Frame) -> dict[str, float]:
    traced = {name: ms for name, ms in frame.timings.items() if name in ("update", "gbuffer", "path")}
    return {"tracing": sum(traced.values()), "denoising": sum(frame.timings.values()) - sum(traced.values())}
