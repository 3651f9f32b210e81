# SPDX-License-Identifier: Apache-2.0
"""``svgf compare``: how far images are from a reference, and how much a sequence flickers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from ..sequence import find_sequence, frame_number
from .options import JsonOption

if TYPE_CHECKING:
    import numpy as np


def compare(
    image: Annotated[
        Path, typer.Argument(metavar="A", help="An .exr file, a folder of them, or a pattern as DIR/name_*.exr.")
    ],
    reference: Annotated[Path, typer.Argument(metavar="B", help="The truth: the same for each image of A.")],
    frames: Annotated[
        str | None, typer.Option("--frames", metavar="A-B", help="Default: all frames that both sequences have.")
    ] = None,
    image_pass: Annotated[str, typer.Option("--pass", metavar="NAME", help="The pass of A.")] = "Combined",
    reference_pass: Annotated[
        str, typer.Option("--reference-pass", metavar="NAME", help="The pass of B.")
    ] = "Combined",
    as_json: JsonOption = False,
) -> None:
    """Measure images against a reference: relMSE, PSNR, SSIM, FLIP, and flicker where there are consecutive frames."""
    from .. import metrics
    from ..frame_range import parse_frames
    from .progress import progress_bar

    pairs = _pair(image, reference, parse_frames(frames) if frames is not None else None)
    measures: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
        "relMSE": metrics.relative_mse,
        "PSNR": metrics.psnr,
        "SSIM": metrics.ssim,
        "FLIP": metrics.flip,
    }
    flicker = metrics.Flicker()
    rows: list[dict[str, object]] = []
    last: int | None = None
    with progress_bar("Comparing", len(pairs)) as bar:
        for number, path, reference_path in pairs:
            pixels, truth = _color(path, image_pass), _color(reference_path, reference_pass)
            if pixels.shape != truth.shape:
                sizes = (f"{array.shape[1]}x{array.shape[0]}" for array in (pixels, truth))
                raise InputError(
                    "{} is {}, but {} is {}.".format(*_interleave((path, reference_path), sizes)),
                    "Render both at one size.",
                )
            rows.append({"frame": number, **{name: measure(pixels, truth) for name, measure in measures.items()}})
            if number is None or last is None or number != last + 1:
                flicker.cut()
            flicker.add(pixels, truth)
            last = number
            bar.step()

    means = {name: sum(row[name] for row in rows) / len(rows) for name in measures}
    if flicker.value is not None:
        means["flicker"] = flicker.value
    if as_json:
        result = {"image": str(image), "reference": str(reference), "mean": means, "frames": rows}
        typer.echo(json.dumps(_finite(result), indent=1, allow_nan=False))
    else:
        _print_table(means, rows, pairs)


def _print_table(
    means: dict[str, float], rows: list[dict[str, object]], pairs: list[tuple[int | None, Path, Path]]
) -> None:
    from rich.console import Console
    from rich.table import Table

    title = f"{pairs[0][1]} against {pairs[0][2]}"
    if len(rows) > 1:
        title += f" and {len(rows) - 1} more"
    table = Table()
    table.add_column("metric")
    table.add_column("mean" if len(rows) > 1 else "value", justify="right")
    if len(rows) > 1:
        table.add_column("worst", justify="right")
        table.add_column("at frame", justify="right")
    for name, value in means.items():
        cells = [name, _format(value)]
        if len(rows) > 1:
            worst = (min if name in ("PSNR", "SSIM") else max)(rows, key=lambda row: row.get(name, 0.0))
            cells += [_format(worst[name]), str(worst["frame"])] if name in worst else ["", ""]
        table.add_row(*cells)
    console = Console(highlight=False)
    console.print(title, markup=False, soft_wrap=True)
    console.print(table)


def _pair(image: Path, reference: Path, frames: tuple[int, ...] | None) -> list[tuple[int | None, Path, Path]]:
    """(frame, image, reference): two files, or what two sequences have in common."""
    images, references = find_sequence(image), find_sequence(reference)
    if image.is_file() and reference.is_file():
        return [(frame_number(image), image, reference)]
    common = sorted(
        images.keys() & references.keys() if frames is None else images.keys() & references.keys() & set(frames)
    )
    if not common:
        raise InputError(
            f"{image} and {reference} have no frame in common.", "Frames are paired by the number at the end."
        )
    left_out = len(images.keys() ^ references.keys())
    if left_out and frames is None:
        typer.echo(f"Warning: {left_out} frames are in one of the sequences only.", err=True)
    return [(number, images[number], references[number]) for number in common]


def _color(path: Path, name: str) -> np.ndarray:
    from ..io import exr
    from .progress import silence

    with silence(1, 2):
        passes = exr.read(path)
    pixels = exr.find_pass(passes, name, path)
    if pixels.ndim != 3 or pixels.shape[2] < 3:
        raise InputError(f'{path}: pass "{name}" has no three channels.', "Choose a colour pass.")
    return pixels[..., :3]


def _interleave(first, second) -> list[object]:
    return [item for pair in zip(first, second, strict=True) for item in pair]


def _finite(value):
    """JSON knows neither NaN nor infinity: null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _format(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
