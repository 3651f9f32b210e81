# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share, and how their text is read."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from ..errors import InputError

DeviceOption = Annotated[str, typer.Option("--device", metavar="NAME", help="auto, cuda, cpu or reference.")]
FramesOption = Annotated[
    str | None,
    typer.Option("--frames", metavar="A-B", help="As 1-16, 7, 1-5,9 or 1-250:10. Default: all that the file says."),
]
SizeOption = Annotated[
    str | None, typer.Option("--size", metavar="WxH", help="Pixels, as 960x540. Default: what the file says.")
]
DiagnosticsOption = Annotated[
    bool,
    typer.Option(
        "--diagnostics",
        help="Write passes that say how far each pixel's motion misses, why it has no history, what was repaired and "
        "which light the firefly limit cut.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


def parse_size(text: str | None) -> tuple[int, int] | None:
    """(width, height) of "960x540". Raises InputError for anything else; Settings checks the range."""
    if text is None:
        return None
    match = re.fullmatch(r"(-?\d{1,9})[xX](-?\d{1,9})", text.strip())
    if match is None:
        raise InputError(f'"{text}" is not an image size.', "Write it as 960x540.")
    width, height = int(match[1]), int(match[2])
    if not (1 <= width <= 65536 and 1 <= height <= 65536):
        raise InputError(f"The image size is {width}x{height}.", "Both sides must be 1 to 65536 pixels.")
    return width, height
