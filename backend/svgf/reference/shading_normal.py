# SPDX-License-Identifier: Apache-2.0
"""Which way a surface faces for shading: flipped to the viewer, bent where its reflections would pass through the
surface, and what a normal map hides. Arrays have one row per ray; normals and directions are [n, 3], world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import MaterialKind
from .layers import column, has_smooth_coat_normal
from .vec import dot, flip_towards, normalize

# Shading normals are bent until the viewer is this far above their horizon.
SMALLEST_COS_VIEW = 0.01


@dataclass
class Orientation:
    """Normals on the viewer's side. smooth_normal: before the normal map. diffuse_normal, coat_normal: of lobes D and H
    and of lobe C; tilted_diffuse, tilted_coat: bool [n], where they are not ``normal``. entering: the viewer is
    outside."""

    normal: np.ndarray
    geometric_normal: np.ndarray
    smooth_normal: np.ndarray
    diffuse_normal: np.ndarray
    tilted_diffuse: np.ndarray
    coat_normal: np.ndarray
    tilted_coat: np.ndarray
    entering: np.ndarray


def orient(
    view: np.ndarray,
    normal: np.ndarray,
    geometric_normal: np.ndarray,
    rows: np.ndarray,
    smooth_normal: np.ndarray | None = None,
) -> Orientation:
    """normal: with the normal map; smooth_normal: without it. rows: [n, 48] of materials, maps applied."""
    entering = dot(geometric_normal, view) > 0.0
    geometric_normal = flip_towards(geometric_normal, view)
    mapped = flip_towards(normal, geometric_normal)
    smooth_normal = mapped if smooth_normal is None else flip_towards(smooth_normal, geometric_normal)
    normal = np.where(has_reflection(rows)[:, None], make_reflecting(mapped, geometric_normal, view), mapped)
    # Reflections must stay above the surface; what a normal map makes of diffuse light may be below.
    tilted_diffuse = (column(rows, "normal_uv_layer") >= 0) & (normal != mapped).any(axis=1)
    tilted_coat = (
        (column(rows, "kind") == MaterialKind.PRINCIPLED)
        & has_smooth_coat_normal(rows)
        & (column(rows, "coat_weight") > 0.0)
    )
    return Orientation(
        normal=normal,
        geometric_normal=geometric_normal,
        smooth_normal=smooth_normal,
        diffuse_normal=np.where(tilted_diffuse[:, None], mapped, normal),
        tilted_diffuse=tilted_diffuse,
        coat_normal=np.where(tilted_coat[:, None], make_reflecting(smooth_normal, geometric_normal, view), normal),
        tilted_coat=tilted_coat,
        entering=entering,
    )


def has_reflection(rows: np.ndarray) -> np.ndarray:
    """bool [n]: the material has a lobe that mirrors, whose normal must then keep mirrored views above the surface."""
    kind = column(rows, "kind")
    mirrors = (kind == MaterialKind.GLOSSY) | (kind == MaterialKind.GLASS) | (kind == MaterialKind.REFRACTION)
    any_lobe = (column(rows, "ior") != 1.0) & (column(rows, "specular_ior_level") > 0.0)
    for weight in ("metallic", "transmission", "coat_weight", "sheen_weight"):
        any_lobe |= column(rows, weight) > 0.0
    return np.where(kind == MaterialKind.PRINCIPLED, any_lobe, mirrors)


def make_reflecting(normal: np.ndarray, geometric_normal: np.ndarray, view: np.ndarray) -> np.ndarray:
    """The normal of a lobe that mirrors: its reflections stay above the surface, and the viewer above its horizon."""
    normal = make_reflection_valid(normal, geometric_normal, view)
    cosine = dot(normal, view)
    bent = normalize(normal + view * (SMALLEST_COS_VIEW - cosine)[:, None])
    return np.where((cosine < SMALLEST_COS_VIEW)[:, None], bent, normal)


def make_reflection_valid(normal: np.ndarray, geometric_normal: np.ndarray, view: np.ndarray) -> np.ndarray:
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
