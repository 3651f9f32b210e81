# SPDX-License-Identifier: Apache-2.0
"""Perspective camera: image points to rays and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .vec import transform_vector


@dataclass(frozen=True)
class Camera:
    """to_world: [3, 4], looks along -Z, +Y up. window: [4] left, right, bottom, top on the plane z = -1. Image size in
    pixels."""

    to_world: np.ndarray
    window: np.ndarray
    width: int
    height: int

    def sees_as(self, other: Camera) -> bool:
        """Whether every point of the world has the same image point in both."""
        return np.array_equal(self.to_world, other.to_world) and np.array_equal(self.window, other.window)

    def direction(self, point: np.ndarray) -> np.ndarray:
        """World directions [..., 3] through image points [..., 2]; not unit: their planar depth is 1."""
        left, right, bottom, top = self.window
        x = left + (right - left) * point[..., 0] / self.width
        y = top + (bottom - top) * point[..., 1] / self.height
        return transform_vector(self.to_world, np.stack([x, y, -np.ones_like(x)], axis=-1))

    def to_camera(self, vector: np.ndarray) -> np.ndarray:
        """World vectors in camera space."""
        return vector @ self.to_world[:, :3]

    def depth(self, position: np.ndarray) -> np.ndarray:
        return -self.to_camera(position - self.to_world[:, 3])[..., 2]

    def project(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Image points [..., 2] and planar depths of vectors from the camera. Points are only valid where the depth is
        > 0."""
        x, y, z = np.moveaxis(self.to_camera(vector), -1, 0)
        left, right, bottom, top = self.window
        with np.errstate(divide="ignore", invalid="ignore"):
            column = (x / -z - left) / (right - left) * self.width
            row = (y / -z - top) / (bottom - top) * self.height
        return np.stack([column, row], axis=-1), -z

    def pixel_steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of a camera-space direction by the image point's x and y."""
        left, right, bottom, top = self.window
        return (
            np.array([(right - left) / self.width, 0.0, 0.0]),
            np.array([0.0, (bottom - top) / self.height, 0.0]),
        )


def pixel_centers(width: int, height: int) -> np.ndarray:
    """[height * width, 2], row by row."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x.ravel(), y.ravel()], axis=-1) + 0.5
