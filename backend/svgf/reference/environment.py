# SPDX-License-Identifier: Apache-2.0
"""The world: its radiance, and directions sampled by its image."""

from __future__ import annotations

import numpy as np

from ..scene import RayVisibility
from .texture import Texture


class World:
    """Columns of FlatScene. image, backdrop_image: the environments', or None."""

    def __init__(
        self, radiance=(0.0, 0.0, 0.0), visibility=int(RayVisibility.ALL), image: Texture | None = None, light=-1,
        to_environment=np.eye(3), row_cdf=(), column_cdf=(), backdrop_radiance=(0.0, 0.0, 0.0),
        backdrop_image: Texture | None = None,
    ) -> None:  # fmt: skip
        self.constant = np.asarray(radiance, dtype=np.float64)
        self.visibility = int(visibility)
        self.image = image
        self.backdrop = np.asarray(backdrop_radiance, dtype=np.float64), backdrop_image
        self.light = light
        self.rotation = np.asarray(to_environment, dtype=np.float64).reshape(3, 3)
        self.row_cdf = np.asarray(row_cdf, dtype=np.float64)
        self.column_cdf = np.asarray(column_cdf, dtype=np.float64)

    def radiance(self, direction: np.ndarray, kind: np.ndarray | int = 0) -> np.ndarray:
        """[n, 3] of unit directions [n, 3]. kind: of the rays, of RayVisibility."""
        lighting = self._picture(direction, self.constant, self.image)
        is_camera = np.broadcast_to(np.asarray(kind) == RayVisibility.CAMERA, len(direction))[:, None]
        return np.where(is_camera, self._picture(direction, *self.backdrop), lighting)

    def _picture(self, direction: np.ndarray, constant: np.ndarray, image: Texture | None) -> np.ndarray:
        if image is None:
            return np.broadcast_to(constant, direction.shape)
        return constant * image.lookup(equirectangular_uv(direction @ self.rotation.T))[:, :3]

    def density(self, direction: np.ndarray) -> np.ndarray:
        """[n]: with which ``sample`` finds unit directions."""
        if not len(self.row_cdf):
            return np.zeros(len(direction))
        local = direction @ self.rotation.T
        uv = equirectangular_uv(local)
        rows, columns = len(self.row_cdf) - 1, self.column_cdf.shape[1] - 1
        row = np.clip((uv[:, 1] * rows).astype(int), 0, rows - 1)
        column = np.clip((uv[:, 0] * columns).astype(int), 0, columns - 1)
        return self._cell_density(row, column, np.hypot(local[:, 0], local[:, 1]))

    def sample(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions [n, 3] and their densities: a row by u[:, 1], then one of its columns by u[:, 0]."""
        rows, columns = len(self.row_cdf) - 1, self.column_cdf.shape[1] - 1
        row, v = choose_interval(self.row_cdf, u[:, 1])
        column, across = np.zeros(len(u), dtype=np.int64), np.zeros(len(u))
        for number in np.unique(row):
            chosen = row == number
            column[chosen], across[chosen] = choose_interval(self.column_cdf[number], u[chosen, 0])
        elevation = ((row + v) / rows - 0.5) * np.pi
        azimuth = (0.5 - (column + across) / columns) * 2.0 * np.pi
        cosine = np.cos(elevation)
        local = np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.sin(elevation)], axis=1)
        return local @ self.rotation, self._cell_density(row, column, cosine)

    def _cell_density(self, row: np.ndarray, column: np.ndarray, cos_elevation: np.ndarray) -> np.ndarray:
        rows, columns = len(self.row_cdf) - 1, self.column_cdf.shape[1] - 1
        probability = np.diff(self.row_cdf)[row] * np.diff(self.column_cdf, axis=1)[row, column]
        with np.errstate(divide="ignore", invalid="ignore"):
            density = probability * rows * columns / (2.0 * np.pi**2 * cos_elevation)
        return np.where(cos_elevation > 0.0, density, 0.0)


def equirectangular_uv(direction: np.ndarray) -> np.ndarray:
    """[n, 2], Blender's map of unit directions in the environment's space."""
    x, y, z = direction.T
    return np.stack([0.5 - np.arctan2(y, x) / (2.0 * np.pi), 0.5 + np.arctan2(z, np.hypot(x, y)) / np.pi], axis=1)


def choose_interval(cdf: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The i with cdf[i] <= u < cdf[i + 1], and the place of u within it, in [0, 1)."""
    index = np.clip(np.searchsorted(cdf, u, side="right") - 1, 0, len(cdf) - 2)
    width = cdf[index + 1] - cdf[index]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(width > 0.0, (u - cdf[index]) / width, 0.0)
    return index, np.clip(place, 0.0, 1.0 - 2.0**-24)
