# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotation and translation of matrices that may hold scale and shear as well."""

from __future__ import annotations

import numpy as np


def lengths(matrix: np.ndarray) -> np.ndarray:
    """[3] scale along each axis: the lengths of the columns of a [3 or 4, 4] matrix."""
    return np.linalg.norm(matrix[:3, :3], axis=0)


def rigid(matrix: np.ndarray) -> np.ndarray:
    """float64 [3, 4]: rotation and translation only.

    The Z axis keeps its direction, because cameras and lamps look along it, and Y stays as near to where it was as a
    rotation allows. X follows, so mirroring is lost. Axes of length zero become those of the world.
    """
    scale = lengths(matrix)
    axes = np.where(scale > 0, matrix[:3, :3] / np.where(scale > 0, scale, 1), np.eye(3))
    z = axes[:, 2]
    y = axes[:, 1] - z * (axes[:, 1] @ z)
    if y @ y < 1e-12:
        y = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    y = y / np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z, matrix[:3, 3]])
