# SPDX-License-Identifier: Apache-2.0
"""``svgf render``: scenes in, denoised frames out."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from .options import DeviceOption, DiagnosticsOption, FramesOption, JsonOption, SizeOption, parse_size

if TYPE_CHECKING:
    from ..frame import Frame
    from ..renderer import Renderer
    from ..scene import Scene


def render(
    file: Annotated[Path, typer.Argument(help="A .blend or .svgf file.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for NAME_0001.exr and so on.")],
    frames: FramesOption = None,
    size: SizeOption = None,
    samples: Annotated[int, typer.Option("--spp", metavar="N", help="Paths per pixel and frame.")] = 1,
    bounces: Annotated[
        int | None, typer.Option(metavar="N", help="Light bounces; 0: direct light only. Default: what the file says.")
    ] = None,
    method: Annotated[str, typer.Option(metavar="NAME", help="svgf+, svgf, eaw or none.")] = "svgf+",
    device: DeviceOption = "auto",
    seed: Annotated[int, typer.Option(metavar="N", help="Of the random numbers.")] = 0,
    png: Annotated[bool, typer.Option("--png", help="Write a PNG beside each EXR, in the Standard view.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Skip frames whose files are there; some before a gap warm up the history.")
    ] = False,
    diagnostics: DiagnosticsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Render an animation to multi-layer OpenEXR. Files of the same name are replaced."""
    from ..frame_range import parse_frames, plan_resume
    from ..io import exr, files
    from ..io import png as png_file
    from ..renderer import Renderer
    from ..settings import Settings
    from .progress import progress_bar, render_frame, silence
    from .sources import open_scenes

    image_size = parse_size(size)
    width, height = image_size or (None, None)
    settings = Settings(
        width, height, bounces=bounces, samples=samples, seed=seed, method=method, diagnostics=diagnostics
    )
    wanted = parse_frames(frames) if frames is not None else None

    def name(frame: int, suffix: str) -> Path:
        return output / f"{file.stem}_{frame:04d}{suffix}"

    to_write = wanted
    if resume:
        with silence(1, 2):
            wanted, to_write = plan_resume(
                _known_frames(file, wanted), lambda frame: exr.is_complete(name(frame, ".exr"))
            )

    written: list[dict[str, object]] = []
    warned: set[str] = set()
    start = time.perf_counter()
    with (
        progress_bar(file.name, len(wanted) if wanted is not None else None) as bar,
        open_scenes(file, wanted, image_size, bar.report) as scenes,
    ):
        renderer = Renderer(settings, device)
        for scene in scenes:
            files.make_folder(output)
            for warning in sorted(set(scene.warnings) - warned):
                bar.message(f"Warning: {warning}")
            warned.update(scene.warnings)
            frame = render_frame(renderer, scene, bar.part)
            if to_write is not None and scene.frame not in to_write:
                continue
            exr.write(frame, name(scene.frame, ".exr"), metadata=describe(renderer, scene, frame))
            entry: dict[str, object] = {"frame": scene.frame, "exr": str(name(scene.frame, ".exr"))}
            if png:
                png_file.write(png_file.display(frame.color), name(scene.frame, ".png"))
                entry["png"] = str(name(scene.frame, ".png"))
            written.append({**entry, "reset": frame.reset, "milliseconds": frame.timings})
            last = frame

    seconds = time.perf_counter() - start
    if as_json:
        summary = {"device": renderer.device.name, "description": renderer.device.description, "seconds": seconds}
        typer.echo(json.dumps({**summary, "frames": written}, indent=1))
    elif not written:
        typer.echo("All frames were there.")
    else:
        names = f"{written[0]['exr']} to {written[-1]['exr']}" if written[1:] else written[0]["exr"]
        typer.echo(
            f"{len(written)} frame{'s' * (len(written) > 1)} of {last.width}x{last.height} in {seconds:.1f} s "
            f"on {renderer.device.name} ({renderer.device.description}): {names}"
        )


def describe(renderer: Renderer, scene: Scene, frame: Frame) -> dict[str, str | int]:
    """How a frame was made, for the header of its file."""
    from .. import __version__

    settings = renderer.settings
    return {
        "Software": f"svgf {__version__}",
        "Scene": scene.name,
        "svgf.device": renderer.device.name,
        "svgf.method": settings.method,
        "svgf.samples": settings.samples,
        "svgf.bounces": scene.defaults.bounces if settings.bounces is None else settings.bounces,
        "svgf.seed": str(settings.seed),  # an EXR integer ends at 2^31
        "svgf.reset": frame.reset,
    }


def _known_frames(file: Path, wanted: tuple[int, ...] | None) -> tuple[int, ...]:
    from ..scene_file import SceneFile

    if wanted is not None:
        return wanted
    if file.suffix.lower() != ".svgf":
        raise InputError(f"To resume {file.name}, svgf must know the frames.", "Add --frames A-B.")
    with SceneFile(file) as scenes:
        return scenes.frames
