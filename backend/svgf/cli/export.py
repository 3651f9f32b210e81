# SPDX-License-Identifier: Apache-2.0
"""``svgf export``: a .blend file as a scene file that renders anywhere, without Blender."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .options import FramesOption, SizeOption, parse_size


def export(
    file: Annotated[Path, typer.Argument(help="A .blend file.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The .svgf file to write.")],
    frames: FramesOption = None,
    size: SizeOption = None,
) -> None:
    """Write the scene of a .blend file, frame by frame, to an .svgf file. A file of the same name is replaced."""
    from ..frame_range import format_frames, parse_frames
    from ..scene_file import SceneFile, save
    from .progress import progress_bar
    from .sources import open_scenes

    if output.suffix.lower() != ".svgf":
        raise InputError(f"{output} does not end in .svgf.", f"Write -o {output.with_suffix('.svgf')}")
    if output.resolve() == file.resolve():
        raise InputError(f"{output} would replace what it is made from.", "Choose another name.")
    image_size = parse_size(size)
    wanted = parse_frames(frames) if frames is not None else None
    with (
        progress_bar(file.name, len(wanted) if wanted is not None else None) as bar,
        open_scenes(file, wanted, image_size, bar.report) as scenes,
    ):
        save(output, scenes)
    with SceneFile(output) as saved:
        for warning in saved.scene(saved.frames[0]).warnings:
            typer.echo(f"Warning: {warning}", err=True)
        typer.echo(f"{output}: frames {format_frames(saved.frames)}, {output.stat().st_size / 1e6:.2f} MB")
