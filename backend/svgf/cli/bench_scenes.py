# SPDX-License-Identifier: Apache-2.0
"""What the commands of ``svgf bench`` have in common: options, and the scenes that they measure."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError

if TYPE_CHECKING:
    from ..scene import Scene

FilesArgument = Annotated[
    list[Path] | None, typer.Argument(help="Scenes; those that come with svgf by default.", show_default=False)
]
ImageSizeOption = Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")]
SizesOption = Annotated[list[str] | None, typer.Option("--size", metavar="WxH", help="Pixels; may be given again.")]
MethodOption = Annotated[str, typer.Option(metavar="NAME", help="svgf+, svgf, eaw or none.")]
MethodsOption = Annotated[
    list[str] | None, typer.Option("--method", metavar="NAME", help="May be given again.", show_default=False)
]
BouncesOption = Annotated[
    int | None, typer.Option(metavar="N", help="Light bounces. Default: what the file says.")
]
CountOption = Annotated[int, typer.Option(metavar="N", min=1, help="Frames to measure.")]
WarmUpOption = Annotated[int, typer.Option(metavar="N", min=0, help="Frames before them.")]
FramesOption = Annotated[str, typer.Option("--frames", metavar="A-B", help="Consecutive frames to render.")]
FirstOption = Annotated[int, typer.Option(metavar="N", help="The first frame that is measured.")]
ReferenceOption = Annotated[int, typer.Option(metavar="N", min=1, help="Samples per pixel of the truth.")]


def scene_paths(files: list[Path] | None) -> list[Path]:
    """The files, or the scenes that come with svgf."""
    from .sources import shipped_scenes

    paths = files or list(shipped_scenes().values())
    if not paths:
        raise InputError("This installation of svgf has no scenes.", "Install svgf again, or give files.")
    return paths


def read_animation(path: Path, frames: str, first: int, size: tuple[int, int]) -> tuple[list[Scene], list[Scene]]:
    """The frames "A-B" of a file, and those of them that are measured."""
    from ..frame_range import parse_frames
    from .sources import open_scenes

    with open_scenes(path, parse_frames(frames), size) as source:
        scenes = list(source)
    return scenes, [scene for scene in scenes if scene.frame >= first]


def read_frames(path: Path, size: tuple[int, int], most: int) -> tuple[list[Scene], list[float]]:
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
