# SPDX-License-Identifier: Apache-2.0
"""The files of an image sequence, as a folder, a pattern or a single file names them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from .errors import InputError

# printf's %d and %04d, and Blender's ####: all stand for a frame number.
_DIGITS = re.compile(r"%0?\d*d|#+")


def find_sequence(path: Path) -> dict[int, Path]:
    """The .exr files that a path names, by frame number, ascending. A single file may have none: it is frame 0.

    path: a folder, a file, or a file name with ####, %04d or wildcards in it. Raises InputError where it names no file,
    or two files of one frame.
    """
    if path.is_file():
        return {frame_number(path) or 0: path}
    if path.is_dir():
        found = sorted(path.glob("*.exr"))
    elif re.search(rf"[*?\[]|{_DIGITS.pattern}", path.name):
        found = _matching(path)
    else:
        raise InputError(f"Cannot read {path}: there is no such file or folder.", "Check the path.")
    if not found:
        raise InputError(f"{path} names no .exr file.", "Check the path.")
    sequence: dict[int, Path] = {}
    for file in found:
        number = frame_number(file)
        if number is None:
            raise InputError(f"{file} has no frame number at the end of its name.", "Name files as image_0001.exr.")
        if number in sequence:
            raise InputError(
                f"{sequence[number]} and {file} are both frame {number}.", "Name one sequence: DIR/name_*.exr"
            )
        sequence[number] = file
    return dict(sorted(sequence.items()))


def frame_number(path: Path) -> int | None:
    """The number at the end of a file's name."""
    match = re.search(r"(\d{1,9})$", path.stem)
    return int(match[1]) if match else None


def check_targets(sequence: Mapping[int, Path], targets: Iterable[Path], may_exist: bool) -> None:
    """Raises InputError where a file to write is one of the sequence, or (unless may_exist) is there already."""
    sources = {path.resolve() for path in sequence.values()}
    there = []
    for path in targets:
        if path.resolve() in sources:
            raise InputError(
                f"{path} is a frame of the input.", "Choose another folder: svgf never writes over its input."
            )
        if path.exists():
            there.append(path)
    if there and not may_exist:
        others = f" (and {len(there) - 1} more)" if len(there) > 1 else ""
        raise InputError(f"{there[0]}{others} is there already.", "Add --resume to keep what is there, or --overwrite.")


def _matching(pattern: Path) -> list[Path]:
    digits = re.compile(
        ".*".join(
            r"\d+".join(map(re.escape, _DIGITS.split(piece))) for piece in re.split(r"[*?]|\[[^\]]*\]", pattern.name)
        )
    )
    found = sorted(pattern.parent.glob(_DIGITS.sub("*", pattern.name)))
    return [file for file in found if digits.fullmatch(file.name)]
