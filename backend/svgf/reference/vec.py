# SPDX-License-Identifier: Apache-2.0
"""Vectors along the last axis of arrays."""

from __future__ import annotations

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def normalize(v: np.ndarray) -> np.ndarray:
    """Unit vectors; a zero vector stays zero."""
    # Scaled first, so that neither tiny nor huge vectors lose their square.
    v = v / np.maximum(np.abs(v).max(axis=-1, keepdims=True), 1e-300)
    return v / np.maximum(np.sqrt(dot(v, v)), 1e-300)[..., None]


def luminance(color: np.ndarray) -> np.ndarray:
    return color @ LUMINANCE


def transform_point(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    """matrix: [..., 3, 4]."""
    return transform_vector(matrix, point) + matrix[..., 3]


def transform_vector(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.einsum("...ij,...j->...i", matrix[..., :3], vector)


def transform_normal(inverse: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """inverse: of the transform of points. The result is not normalized; what is outside stays outside under
    reflections."""
    return np.einsum("...ji,...j->...i", inverse[..., :3], normal)


def flip_towards(normal: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """normal, or its opposite where that is on direction's side."""
    return np.where((dot(normal, direction) < 0.0)[..., None], -normal, normal)
