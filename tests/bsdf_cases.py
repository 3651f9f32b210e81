# SPDX-License-Identifier: Apache-2.0
"""The reference's BSDF at one point, and directions to try it with."""

from __future__ import annotations

import numpy as np

from svgf.flatten import material_rows
from svgf.reference.bsdf import Bsdf
from svgf.reference.bsdf_lobes import make_bsdf
from svgf.scene import Material


def make(material: Material, view: np.ndarray, normal=(0, 0, 1), geometric_normal=(0, 0, 1), **changes) -> Bsdf:
    """One row per row of view. changes: see make_bsdf; the tangent is X unless said."""
    changes.setdefault("tangent", np.tile([1.0, 0.0, 0.0], (len(view), 1)))
    count = len(view)
    rows = np.repeat(material_rows((material,)), count, axis=0)
    normal, geometric_normal = (
        np.tile(np.asarray(n, dtype=np.float64), (count, 1)) for n in (normal, geometric_normal)
    )
    return make_bsdf(view, normal, geometric_normal, rows, **changes)


def repeat(bsdf: Bsdf, count: int) -> Bsdf:
    return bsdf.rows(np.zeros(count, dtype=np.int64))


def sphere_grid(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions in the middle of cells of equal angles, and the solid angles of the cells. Cell = row * columns +
    column."""
    edges = np.linspace(0, np.pi, rows + 1)
    theta, phi = np.meshgrid(
        (edges[1:] + edges[:-1]) / 2, 2 * np.pi * (np.arange(columns) + 0.5) / columns, indexing="ij"
    )
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    solid_angle = (np.cos(edges[:-1]) - np.cos(edges[1:])) * 2 * np.pi / columns
    return directions.reshape(-1, 3), np.repeat(solid_angle, columns)
