# SPDX-License-Identifier: Apache-2.0
"""Diffuse reflection: Lambert's, or the improved Oren-Nayar model [Fujii12] with an energy-preserving term."""

from __future__ import annotations

import numpy as np

from .vec import dot

# Diffuse roughness below which a surface is Lambert's.
SMALLEST_DIFFUSE_ROUGHNESS = 1e-5


def oren_nayar_loss(cosine: np.ndarray) -> np.ndarray:
    """G of the improved Oren-Nayar model [Fujii12], with which the directional albedo is a pi + b G."""
    c = np.clip(cosine, 0.0, 1.0)
    s = np.sqrt(1.0 - c * c)
    with np.errstate(divide="ignore", invalid="ignore"):
        full = s * (np.arccos(c) - 2.0 / 3.0 - s * c) + 2.0 / 3.0 * (s / c) * (1.0 - s**3)
    return np.where(c < 1e-6, np.pi / 2.0 - 2.0 / 3.0 - c, full)


def oren_nayar_terms(roughness: np.ndarray, cos_view: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, ...]:
    """a, b, the factor of multiple scattering without the term of L, and the lobe's albedo towards V over its weight.

    [Fujii12] with an energy-preserving term; its strength is that of Cycles, which holds one factor of the colour more
    than [Portsmouth25, Eq. 20]."""
    a = 1.0 / (np.pi + roughness * (np.pi / 2.0 - 2.0 / 3.0))
    b = roughness * a
    mean = a * np.pi + (2.0 * np.pi - 5.6) / 3.0 * b
    strength = color**2 * (mean / np.maximum(1.0 - mean, 1e-9))[:, None] / (1.0 - color * (1.0 - mean)[:, None]) / np.pi
    view = a * np.pi + b * oren_nayar_loss(cos_view)
    multiple = strength * (1.0 - view)[:, None]
    is_lambert = roughness < SMALLEST_DIFFUSE_ROUGHNESS
    b = np.where(is_lambert, 0.0, b)
    multiple = np.where(is_lambert[:, None], 0.0, multiple)
    albedo = np.where(is_lambert[:, None], 1.0, view[:, None] + np.pi * multiple * (1.0 - mean)[:, None])
    return np.where(is_lambert, 1.0 / np.pi, a), b, multiple, albedo


def oren_nayar(a: np.ndarray, b: np.ndarray, multiple: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Value of the lobe over its weight, without the cosine, [n, 3]. a, b, multiple: of oren_nayar_terms. view, light:
    [n, 3], local."""
    cos_view, cos_light = np.maximum(view[:, 2], 0.0), np.abs(light[:, 2])
    t = dot(light, view) - cos_light * cos_view
    t = np.where(t > 0.0, t / np.maximum(np.maximum(cos_light, cos_view), 1e-30), t)
    single = a + b * np.where(b > 0.0, t, 0.0)
    loss = 1.0 - (a * np.pi + b * oren_nayar_loss(cos_light))
    return single[:, None] + multiple * loss[:, None]
