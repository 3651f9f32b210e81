# SPDX-License-Identifier: Apache-2.0
"""``svgf denoise``: noisy EXR sequences of Cycles in, the same files with a denoised Combined out."""

from __future__ import annotations

import json
import time
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .options import DeviceOption, DiagnosticsOption, JsonOption


def denoise(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help="A folder, an .exr file, or a pattern: DIR/frame_####.exr.", show_default=False
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the denoised files, of the same names.")
    ],
    frames: Annotated[
        str | None, typer.Option("--frames", metavar="A-B", help="As 1-16, 7, 1-5,9. Default: all that are there.")
    ] = None,
    layer: Annotated[
        str | None, typer.Option("--layer", metavar="NAME", help="The layer to denoise. Default: all render layers.")
    ] = None,
    method: Annotated[str, typer.Option(metavar="NAME", help="svgf+, svgf, eaw or none.")] = "svgf+",
    device: DeviceOption = "auto",
    png: Annotated[bool, typer.Option("--png", help="Write a PNG beside each EXR, in the Standard view.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files of the same names.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Skip frames whose files are there; some before a gap warm up the history.")
    ] = False,
    diagnostics: DiagnosticsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Denoise an animation that Cycles rendered to multi-layer OpenEXR.

    Needs Combined, Depth, Normal, Vector, and either the light passes (Diffuse, Glossy, Transmission: Direct, Indirect,
    Color), which give the better picture, or Denoising Data. Everything but Combined passes through untouched.
    """
    from ..cycles import preflight
    from ..cycles.batch import SequenceDenoiser
    from ..cycles.image import MultilayerImage
    from ..devices import open_device
    from ..frame_range import format_frames, parse_frames, plan_resume
    from ..io import exr, files
    from ..io import png as png_file
    from ..sequence import check_targets, find_sequence
    from ..settings import METHODS, check_name
    from .progress import progress_bar, run_interruptibly, silence

    check_name("The method", method, METHODS)
    if overwrite and resume:
        raise InputError("--overwrite and --resume contradict each other.", "Choose one.")
    sequence = find_sequence(source)
    if frames is not None:
        wanted = parse_frames(frames)
        there = {number: sequence[number] for number in wanted if number in sequence}
        if not there:
            raise InputError(f"{source} has no frame {frames}.", f"It has {format_frames(sequence)}.")
        if len(there) < len(wanted):
            typer.echo(f"Warning: {source} has no frame {format_frames(set(wanted) - there.keys())}.", err=True)
        sequence = there

    start = time.perf_counter()
    with silence(1, 2):
        plan = preflight.check(sequence, method, layer)
    names = [reading.layer for reading in plan.readings]

    def png_path(number: int, name: str) -> Path:
        stem = sequence[number].stem if len(names) == 1 else f"{sequence[number].stem}_{name}"
        return output / f"{stem}.png"

    targets = {
        number: [output / path.name, *(png_path(number, name) for name in names if png)]
        for number, path in sequence.items()
    }
    check_targets(sequence, chain.from_iterable(targets.values()), may_exist=overwrite or resume)
    order, to_write = tuple(sequence), frozenset(sequence)
    if resume:
        with silence(1, 2):
            order, to_write = plan_resume(
                order,
                lambda number: exr.is_complete(targets[number][0]) and all(p.exists() for p in targets[number]),
            )
    for warning in plan.warnings:
        typer.echo(f"Warning: {warning}", err=True)

    opened = open_device(device)
    denoiser = SequenceDenoiser(plan, method, opened, diagnostics)
    written: list[dict[str, object]] = []
    with progress_bar(source.name, len(order)) as bar:
        for number in order:
            with silence(1, 2):
                image = MultilayerImage(sequence[number])
            result = run_interruptibly(partial(denoiser.denoise, number, image), opened.interrupt)
            for message in result.messages:
                bar.message(f"Warning: {message}")
            if number in to_write:
                files.make_folder(output)
                result.image.write(targets[number][0], denoiser.attributes(result))
                for name in names if png else ():
                    png_file.write(png_file.display(result.layers[name].color), png_path(number, name))
                written.append(
                    {
                        "frame": number,
                        "exr": str(targets[number][0]),
                        "png": [str(path) for path in targets[number][1:]],
                        "layers": {
                            name: {"reset": each.reset, "repaired": each.repaired, "unexplained": each.unexplained}
                            for name, each in result.layers.items()
                        },
                    }
                )
            bar.step()

    seconds = time.perf_counter() - start
    if as_json:
        summary = {"device": opened.name, "description": opened.description, "seconds": seconds}
        typer.echo(json.dumps({**summary, "warnings": plan.warnings, "frames": written}, indent=1))
    elif not written:
        typer.echo("All frames were there.")
    else:
        named = f"{written[0]['exr']} to {written[-1]['exr']}" if written[1:] else written[0]["exr"]
        typer.echo(
            f"{len(written)} frame{'s' * (len(written) > 1)} of {plan.width}x{plan.height} in {seconds:.1f} s "
            f"on {opened.name} ({opened.description}): {named}"
        )
