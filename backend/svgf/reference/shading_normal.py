# SPDX-License-Identifier: Apache-2.0
"""Shading normals that are bent where their reflections would pass through the surface, and what a normal map hides."""

from __future__ import annotations

import numpy as np

from .vec import dot, normalize

# Shading normals are bent so that the viewer stays above the horizon.
SMALLEST_COSINE = 0.01


def valid_reflection(normal: np.ndarray, geometric_normal: np.ndarray, view: np.ndarray) -> np.ndarray:
    """The normal, turned towards the geometric one just as far as the mirror image of the view needs to be above the
    surface.

    With Ng as Z and N in the XZ plane, V = (Vx, ., Vz): 2 (N.V) Nz - Vz = t is quadratic in Nz^2.
    """
    height = dot(view, geometric_normal)
    threshold = np.minimum(0.9 * height, 0.01)
    mirrored = 2.0 * dot(normal, view)[:, None] * normal - view
    x = normal - dot(normal, geometric_normal)[:, None] * geometric_normal
    length = np.linalg.norm(x, axis=1)
    x = normalize(x)
    vx = dot(view, x)
    a = vx**2 + height**2
    b = 2.0 * (a + height * threshold)
    c = (threshold + height) ** 2
    root = np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))
    z2 = np.clip(0.25 * (b + np.where(vx < 0.0, root, -root)) / np.maximum(a, 1e-30), 0.0, 1.0)
    bent = np.sqrt(1.0 - z2)[:, None] * x + np.sqrt(z2)[:, None] * geometric_normal
    invalid = (dot(geometric_normal, mirrored) < threshold) & (length > 1e-6)
    return np.where(invalid[:, None], bent, normal)


def raise_viewer(normal: np.ndarray, view: np.ndarray) -> np.ndarray:
    cosine = dot(normal, view)
    bent = normalize(normal + view * (SMALLEST_COSINE - cosine)[:, None])
    return np.where((cosine < SMALLEST_COSINE)[:, None], bent, normal)


def bump_shadowing(smooth: np.ndarray, normal: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a normal map hides of surfaces with these normals without and with it, [n, 3]: bool [n], directions on the
    wrong side of the unperturbed surface, and the factor [n] that darkens diffuse reflection towards its horizon
    [Chiang19]."""
    mapped = (np.abs(smooth - normal) > 1e-6).any(axis=1)
    cos_light, cos_normal = dot(smooth, light), dot(smooth, normal)
    hidden = mapped & (cos_light * cos_normal * dot(normal, light) < 0.0)
    c, d = np.abs(cos_light), np.maximum(np.abs(cos_normal), 1e-6)
    tangent2 = np.maximum(1.0 / (d * d) - 1.0, 0.0)
    alpha2 = np.clip(0.125 * tangent2, 0.0, 1.0)
    slope2 = np.maximum(1.0 / np.maximum(c * c, 1e-12) - 1.0, 0.0)
    factor = 2.0 / (1.0 + np.sqrt(1.0 + alpha2 * slope2))
    return hidden, np.where(mapped, factor, 1.0)
