# SPDX-License-Identifier: Apache-2.0
"""Captions on images: a bitmap font of 5x7 pixels, so that a labelled picture needs no font on the machine."""

from __future__ import annotations

import numpy as np

# One character a line: seven rows from top to bottom, each five pixels as a hexadecimal number (bit 4 is the left one).
_GLYPHS = {
    "A": "0e 11 11 1f 11 11 11",
    "B": "1e 11 11 1e 11 11 1e",
    "C": "0e 11 10 10 10 11 0e",
    "D": "1e 11 11 11 11 11 1e",
    "E": "1f 10 10 1e 10 10 1f",
    "F": "1f 10 10 1e 10 10 10",
    "G": "0e 11 10 17 11 11 0f",
    "H": "11 11 11 1f 11 11 11",
    "I": "0e 04 04 04 04 04 0e",
    "J": "07 02 02 02 02 12 0c",
    "K": "11 12 14 18 14 12 11",
    "L": "10 10 10 10 10 10 1f",
    "M": "11 1b 15 15 11 11 11",
    "N": "11 19 15 13 11 11 11",
    "O": "0e 11 11 11 11 11 0e",
    "P": "1e 11 11 1e 10 10 10",
    "Q": "0e 11 11 11 15 12 0d",
    "R": "1e 11 11 1e 14 12 11",
    "S": "0f 10 10 0e 01 01 1e",
    "T": "1f 04 04 04 04 04 04",
    "U": "11 11 11 11 11 11 0e",
    "V": "11 11 11 11 11 0a 04",
    "W": "11 11 11 15 15 1b 11",
    "X": "11 11 0a 04 0a 11 11",
    "Y": "11 11 0a 04 04 04 04",
    "Z": "1f 01 02 04 08 10 1f",
    "0": "0e 11 13 15 19 11 0e",
    "1": "04 0c 04 04 04 04 0e",
    "2": "0e 11 01 06 08 10 1f",
    "3": "1f 02 04 06 01 11 0e",
    "4": "02 06 0a 12 1f 02 02",
    "5": "1f 10 1e 01 01 11 0e",
    "6": "06 08 10 1e 11 11 0e",
    "7": "1f 01 02 04 08 08 08",
    "8": "0e 11 11 0e 11 11 0e",
    "9": "0e 11 11 0f 01 02 0c",
    ".": "00 00 00 00 00 0c 0c",
    ",": "00 00 00 00 0c 04 08",
    ":": "00 0c 0c 00 0c 0c 00",
    "-": "00 00 00 1f 00 00 00",
    "/": "01 01 02 04 08 10 10",
    "%": "18 19 02 04 08 13 03",
    " ": "00 00 00 00 00 00 00",
}
_UNKNOWN = "1f 11 11 11 11 11 1f"
HEIGHT = 13


def caption(text: str, width: int, scale: int = 1) -> np.ndarray:
    """A black bar with the text in white: uint8 [HEIGHT * scale, width, 3]. Capitals; what does not fit is cut off."""
    bar = np.zeros((HEIGHT, max(width, 1) + 6 * len(text) + 4), np.uint8)
    for index, character in enumerate(text.upper()):
        rows = [int(row, 16) for row in _GLYPHS.get(character, _UNKNOWN).split()]
        for y, row in enumerate(rows):
            for x in range(5):
                bar[3 + y, 4 + 6 * index + x] = 255 * (row >> (4 - x) & 1)
    enlarged = bar.repeat(scale, axis=0).repeat(scale, axis=1)[:, :width]
    return np.repeat(enlarged[..., None], 3, axis=2)


def beside(images: list[tuple[str, np.ndarray]], scale: int = 1) -> np.ndarray:
    """Captioned images in a row. images: (text, uint8 [H, W, 3]) of one size. Returns uint8 [H + bar, sum of W, 3]."""
    return np.concatenate(
        [np.concatenate([caption(text, pixels.shape[1], scale), pixels], axis=0) for text, pixels in images], axis=1
    )
