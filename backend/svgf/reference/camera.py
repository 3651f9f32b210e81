# SPDX-License-Identifier: Apache-2.0
"""Cameras: image points to rays and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .sampling import concentric_disk, triangle_barycentrics
from .vec import transform_point, transform_vector


@dataclass(frozen=True)
class Camera:
    """to_world: [3, 4], looks along -Z, +Y up. window: [4] left, right, bottom, top on the plane z = -1, or in metres.
    lens: [6], see FlatScene. Image size in pixels."""

    to_world: np.ndarray
    window: np.ndarray
    lens: np.ndarray
    width: int
    height: int

    @property
    def is_orthographic(self) -> bool:
        return bool(self.lens[0])

    @property
    def has_aperture(self) -> bool:
        return bool(self.lens[1] > 0.0)

    def sees_as(self, other: Camera) -> bool:
        """Whether every point of the world has the same image point in both."""
        return (
            np.array_equal(self.to_world, other.to_world)
            and np.array_equal(self.window, other.window)
            and self.is_orthographic == other.is_orthographic
        )

    def on_window(self, point: np.ndarray) -> np.ndarray:
        """[..., 2] of image points [..., 2]."""
        left, right, bottom, top = self.window
        return np.stack(
            [
                left + (right - left) * point[..., 0] / self.width,
                top + (bottom - top) * point[..., 1] / self.height,
            ],
            axis=-1,
        )

    def local_direction(self, point: np.ndarray) -> np.ndarray:
        """Camera-space directions [..., 3] through image points; not unit: their planar depth is 1."""
        xy = self.on_window(point)
        if self.is_orthographic:
            xy = np.zeros_like(xy)
        return np.concatenate([xy, -np.ones_like(xy[..., :1])], axis=-1)

    def rays(self, point: np.ndarray, u: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """World origins and directions [n, 3] of planar depth 1 through image points [n, 2]: through the middle of the
        lens, or through its points chosen by u [n, 2], whose rays meet at the focus distance."""
        local = np.zeros((len(point), 3))
        if self.is_orthographic:
            local[:, :2] = self.on_window(point)
        origin = transform_point(self.to_world, local)
        direction = transform_vector(self.to_world, self.local_direction(point))
        if u is not None and self.has_aperture:
            on_lens = np.concatenate([self.sample_lens(u), np.zeros((len(u), 1))], axis=1)
            shift = transform_vector(self.to_world, on_lens)
            origin, direction = origin + shift, direction - shift / self.lens[2]
        return origin, direction

    def sample_lens(self, u: np.ndarray) -> np.ndarray:
        """Uniform points [n, 2] of the opening: a disk, or a regular polygon with its corners on the same circle, drawn
        out along one axis."""
        _, radius, _, blades, rotation, inverse_ratio = self.lens
        if blades < 3:
            p = concentric_disk(u)
        else:
            corner = np.floor(u[:, 0] * blades)
            share = triangle_barycentrics(np.stack([u[:, 0] * blades - corner, u[:, 1]], axis=1))
            half = np.pi / blades
            x = (share[:, 0] + share[:, 1]) * np.cos(half)
            y = (share[:, 0] - share[:, 1]) * np.sin(half)
            turn = rotation + 2.0 * half * corner
            p = np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=1)
        return p * [inverse_ratio, 1.0] * radius

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
        scale = 1.0 if self.is_orthographic else -z
        with np.errstate(divide="ignore", invalid="ignore"):
            column = (x / scale - left) / (right - left) * self.width
            row = (y / scale - top) / (bottom - top) * self.height
        return np.stack([column, row], axis=-1), -z

    def depth_gradient(self, point: np.ndarray, depth: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """[n, 2]: derivatives by the image point of the depth at which its ray meets a plane, given its world normal.

        The ray o + s d meets n (x - p) = 0 at s = n (p - o) / n d. Of a perspective camera only d changes,
        ds = -s (n dd) / (n d); of an orthographic one only o, ds = -(n do) / (n d).
        """
        left, right, bottom, top = self.window
        n = self.to_camera(normal)
        scale = -1.0 if self.is_orthographic else -depth
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = scale / np.einsum("ni,ni->n", n, self.local_direction(point))
            steps = np.array([(right - left) / self.width, (bottom - top) / self.height])
            return n[:, :2] * steps * scale[:, None]


def pixel_centers(width: int, height: int) -> np.ndarray:
    """[height * width, 2], row by row."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x.ravel(), y.ravel()], axis=-1) + 0.5
