# SPDX-License-Identifier: Apache-2.0
"""What lies on the base of a Principled BSDF: sheen, and below it a coat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..flatten import MATERIAL_COLUMNS
from ..scene import MaterialKind
from .albedo import dielectric_share, lookup
from .microfacet import dielectric_mean, multiscatter_factor, normal_reflectance

# Below it the fits divide by almost 0.
SMALLEST_SHEEN_ROUGHNESS = 0.01


def column(rows: np.ndarray, name: str) -> np.ndarray:
    """[n], or [n, 3] of a colour."""
    start = MATERIAL_COLUMNS[name]
    colors = ("base_color", "specular_tint", "coat_tint", "sheen_tint", "emission", "light_emission", "normal")
    return rows[:, start : start + 3] if name in colors else rows[:, start]


@dataclass
class Layers:
    """What lies on the base of a Principled BSDF. below [n, 3]: share of light that reaches the base and comes back,
    which is also the base's share of what it emits. sheen, coat: [n, 3] and [n], weights of these lobes with all their
    factors; coat_albedo: [n], of the coat towards V."""

    below: np.ndarray
    sheen: np.ndarray
    sheen_a: np.ndarray
    sheen_b: np.ndarray
    coat: np.ndarray
    coat_alpha: np.ndarray
    coat_eta: np.ndarray
    coat_albedo: np.ndarray


def has_smooth_coat_normal(rows: np.ndarray) -> np.ndarray:
    """bool [n]: the coat is smooth over a base that a normal map bends."""
    return (column(rows, "normal_uv_layer") >= 0) & (column(rows, "coat_normal_mapped") == 0)


def make_layers(rows: np.ndarray, cos_sheen: np.ndarray, cos_coat: np.ndarray) -> Layers:
    """rows: [n, 48] of materials, maps applied. cos_sheen, cos_coat: [n], of V with the normals of sheen and coat."""
    principled = column(rows, "kind") == MaterialKind.PRINCIPLED
    below = np.ones((len(rows), 3))

    weight = np.where(principled, column(rows, "sheen_weight"), 0.0)[:, None] * column(rows, "sheen_tint")
    sheen_a, sheen_b, sheen_albedo = sheen_lobe(np.clip(cos_sheen, 0.0, 1.0), column(rows, "sheen_roughness"))
    sheen = weight * sheen_albedo[:, None]
    below = below * np.clip(1.0 - sheen.max(axis=1), 0.0, 1.0)[:, None]

    coat_weight = np.where(principled, column(rows, "coat_weight"), 0.0)
    coat_eta = np.maximum(column(rows, "coat_ior"), 1.0)
    roughness = column(rows, "coat_roughness")
    f0 = normal_reflectance(coat_eta)
    energy, factor = multiscatter_factor(roughness, cos_coat, dielectric_mean(coat_eta))
    single = f0 + (1.0 - f0) * dielectric_share(roughness, cos_coat, coat_eta)
    coat = coat_weight * below[:, 0] * factor
    coat_albedo = coat * energy * single
    below = below * np.clip(1.0 - coat_weight * factor * energy * single, 0.0, 1.0)[:, None]
    # Beer's law along the refracted ray; the tint is that of a ray along the normal.
    inside = np.sqrt(1.0 - (1.0 - np.clip(cos_coat, 0.0, 1.0) ** 2) / coat_eta**2)
    absorbed = column(rows, "coat_tint") ** (1.0 / np.maximum(inside, 1e-6))[:, None]
    below = below * (1.0 + coat_weight[:, None] * (absorbed - 1.0))
    return Layers(below, sheen, sheen_a, sheen_b, coat, roughness**2, coat_eta, coat_albedo)


def sheen_lobe(cosine: np.ndarray, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse linear transform (x, y, z) -> (a x + b z, a y, z) that makes the lobe a cosine [Zeltner22], by the fits
    of [MaterialX], and its albedo, by a table: the fit of that is off by up to 10 %."""
    x, y = cosine, np.clip(roughness, SMALLEST_SHEEN_ROUGHNESS, 1.0)
    a = (2.58126 * x + 0.813703 * y) * y / (1.0 + 0.310327 * x * x + 2.60994 * x * y)
    b = np.sqrt(1.0 - x) * (y - 1.0) * y**3 / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    return a, b, lookup("sheen", roughness, cosine)
