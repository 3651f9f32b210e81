# SPDX-License-Identifier: Apache-2.0
"""Value and density of a material's lobes for a direction; see bsdf.py."""

from __future__ import annotations

import numpy as np

from .bsdf import Bsdf, coat_at, glass_events, lobe_alpha, specular_at, to_lobe, turned
from .diffuse import oren_nayar
from .microfacet import ggx_density, ggx_lambda
from .shading_normal import bump_shadowing
from .vec import dot, normalize


def evaluate(
    bsdf: Bsdf, light: np.ndarray, side: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diffuse and other lobes, times |cosine|, [n, 3] each, and the density [n] with which ``sample`` finds light.

    light: [n, 3], unit, world. side: [n], of the surface that it is on, > 0 for the viewer's; None: by the geometric
    normal. Smooth lobes have no part in any of the three.
    """
    side = dot(bsdf.geometric_normal, light) if side is None else side
    diffuse, pdf = _diffuse(bsdf, light, side)
    specular = np.zeros_like(diffuse)
    for value, density in (*_reflections(bsdf, light, side), _refraction(bsdf, light, side)):
        specular = specular + value
        pdf = pdf + density
    return diffuse, specular, pdf


def _diffuse(bsdf: Bsdf, light: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D and H: value [n, 3] and density [n]. What bumps hide they are found by all the same. side: [n], of light."""
    view, local = (to_lobe(bsdf, vector, bsdf.diffuse_normal, bsdf.tilted_diffuse) for vector in (bsdf.view, light))
    hidden, darkening = bump_shadowing(bsdf.smooth_normal, bsdf.diffuse_normal, light)
    cosine = local[:, 2]
    above = (cosine > 0.0) & (side > 0.0)
    lit = np.where(bsdf.transmits_diffuse, (cosine < 0.0) & (side < 0.0), above)
    cosine = np.where(lit, np.abs(cosine), 0.0)
    darkening = np.where(hidden, 0.0, np.where(bsdf.transmits_diffuse, 1.0, darkening))
    reflected = oren_nayar(bsdf.oren_nayar_a, bsdf.oren_nayar_b, bsdf.oren_nayar_multiple, view, local)
    density = np.where(above, sheen_density(bsdf, local, view), 0.0)
    value = bsdf.diffuse * reflected * (cosine * darkening)[:, None] + bsdf.sheen * (density * darkening)[:, None]
    return value, bsdf.probability[:, 0] * cosine / np.pi + bsdf.probability[:, 1] * density


def sheen_density(bsdf: Bsdf, local: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Density [n] of lobe H, which is also its value over its weight [Zeltner22, Eq. 3]."""
    x, y, z = turned(local, view).T
    a, b = bsdf.sheen_a, bsdf.sheen_b
    squared = (a * x + b * z) ** 2 + (a * y) ** 2 + z**2
    return np.maximum(z, 0.0) / np.pi * (a / np.maximum(squared, 1e-30)) ** 2


def _reflections(bsdf: Bsdf, light: np.ndarray, side: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """S, G and C as mirrors made of microfacets: value [n, 3] and density [n] of each."""
    _, _, of_specular, of_coat, of_glass = bsdf.probability.T
    view, local = bsdf.to_local(bsdf.view), bsdf.to_local(light)
    above = (local[:, 2] > 0.0) & (side > 0.0)
    cos_half_view = dot(view, normalize(view + local))
    reflectance, _, chance = glass_events(bsdf, cos_half_view)
    parts = []
    for value, probability, alpha, smooth in (
        (specular_at(bsdf, cos_half_view), of_specular, bsdf.alpha, bsdf.smooth),
        (bsdf.glass * reflectance, of_glass * chance, lobe_alpha(bsdf.glass_alpha), bsdf.smooth_glass),
    ):
        shadowed, masked = _ggx_reflection(view, local, alpha, above & ~smooth)
        parts.append((value * shadowed[:, None], probability * masked))

    # The coat's by its own normal; where that is not N, of the side of Ng alone.
    view, local = (to_lobe(bsdf, vector, bsdf.coat_normal, bsdf.tilted_coat) for vector in (bsdf.view, light))
    lit = np.where(bsdf.tilted_coat, (side > 0.0) & (local[:, 2] > 0.0), above) & (view[:, 2] > 0.0)
    shadowed, masked = _ggx_reflection(view, local, lobe_alpha(bsdf.coat_alpha), lit & ~bsdf.smooth_coat)
    coat = coat_at(bsdf, dot(view, normalize(view + local))) * shadowed
    return [*parts, (coat[:, None], of_coat * masked)]


def _ggx_reflection(
    view: np.ndarray, light: np.ndarray, alpha: np.ndarray, lit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """D G2 / (4 NV NL) times NL, G2 height-correlated [Heitz14, Eq. 99], and the density of mirrors among the normals
    that the viewer sees, D G1 / (4 NV): [n] each, 0 where not lit. Local vectors."""
    lambda_view, lambda_light = ggx_lambda(view, alpha), ggx_lambda(light, alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.where(lit, ggx_density(normalize(view + light), alpha) / (4.0 * view[:, 2]), 0.0)
    return spread / (1.0 + lambda_view + lambda_light), spread / (1.0 + lambda_view)


def _refraction(bsdf: Bsdf, light: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """G through microfacets [Walter07, Eq. 21] with the Jacobian of the half vector, Eq. 17: value and density."""
    view, local = bsdf.to_local(bsdf.view), bsdf.to_local(light)
    eta, alpha = bsdf.glass_eta, lobe_alpha(bsdf.glass_alpha)
    half = normalize(-(view + eta[:, None] * local))
    half = np.where((half[:, 2] < 0.0)[:, None], -half, half)
    cos_half_view, cos_half_light = dot(view, half), dot(local, half)
    below = (local[:, 2] < 0.0) & (side < 0.0)
    passes = below & ~bsdf.smooth_glass & (cos_half_view > 0.0) & (cos_half_light < 0.0)
    lambda_view, lambda_light = ggx_lambda(view, alpha), ggx_lambda(local, alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        jacobian = eta**2 * np.abs(cos_half_light) / (cos_half_view + eta * cos_half_light) ** 2
        spread = ggx_density(half, alpha) * cos_half_view / view[:, 2] * jacobian
    spread = np.where(passes, spread, 0.0)
    _, transmittance, chance = glass_events(bsdf, cos_half_view)
    value = bsdf.glass * transmittance * (spread / (1.0 + lambda_view + lambda_light))[:, None]
    return value, bsdf.probability[:, 4] * (1.0 - chance) * spread / (1.0 + lambda_view)
