# SPDX-License-Identifier: GPL-3.0-or-later
"""The integer hashes behind Blender's procedural textures: Jenkins' lookup3 [Jenkins06] and PCG [Jarzynski20]."""

from __future__ import annotations

import numpy as np

_LOOKUP3_SEED = 0xDEADBEEF + 13
_PCG_FACTOR, _PCG_INCREMENT = np.int32(1664525), np.int32(1013904223)
_FINAL_ROTATIONS = (14, 11, 25, 16, 4, 14, 24)


def _rotate(value: np.ndarray, bits: int) -> np.ndarray:
    return (value << np.uint32(bits)) | (value >> np.uint32(32 - bits))


def hash_integers(*keys: np.ndarray) -> np.ndarray:
    """uint32 of one to four uint32 arrays."""
    seed = np.uint32((_LOOKUP3_SEED + 4 * len(keys)) & 0xFFFFFFFF)
    shape = np.broadcast_shapes(*(key.shape for key in keys))
    state = [np.full(shape, seed) for _ in range(3)]
    for index, key in enumerate(keys[:3]):
        state[index] += key
    if len(keys) == 4:
        _mix(state)
        state[0] += keys[3]
    # Each step takes the word before: c from b, a from c, b from a, ...
    for step, bits in enumerate(_FINAL_ROTATIONS):
        target, other = (2 + step) % 3, (1 + step) % 3
        state[target] ^= state[other]
        state[target] -= _rotate(state[other], bits)
    return state[2]


def _mix(state: list[np.ndarray]) -> None:
    for step, bits in enumerate((4, 6, 8, 16, 19, 4)):
        a, b, c = step % 3, (step + 1) % 3, (step + 2) % 3
        state[a] -= state[c]
        state[a] ^= _rotate(state[c], bits)
        state[c] += state[b]


def hash_floats(*keys: np.ndarray) -> np.ndarray:
    """float32 in [0, 1] of the bits of one to four float32 arrays."""
    keys = [np.atleast_1d(np.asarray(key, np.float32)).view(np.uint32) for key in keys]
    return hash_integers(*keys).astype(np.float32) * np.float32(1 / 0xFFFFFFFF)


def hash_cells(cells: np.ndarray) -> np.ndarray:
    """float32 [n, d] in [0, 1] of int32 cells [n, d], d in 2..4."""
    values = [np.array(column, np.int32) * _PCG_FACTOR + _PCG_INCREMENT for column in cells.T]
    for last_round in (False, True):
        _pcg_round(values)
        if not last_round:
            for value in values:
                value ^= value >> 16
    return np.stack([(value & 0x7FFFFFFF).astype(np.float32) for value in values], 1) * np.float32(1 / 0x7FFFFFFF)


def _pcg_round(values: list[np.ndarray]) -> None:
    if len(values) == 2:
        x, y = values
        x += y * _PCG_FACTOR
        y += x * _PCG_FACTOR
    elif len(values) == 3:
        x, y, z = values
        x += y * z
        y += z * x
        z += x * y
    else:
        x, y, z, w = values
        x += y * w
        y += z * x
        z += x * y
        w += y * z
