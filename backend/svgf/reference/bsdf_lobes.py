# SPDX-License-Identifier: Apache-2.0
"""From a material to its lobes: weight, Fresnel term, roughness and probability of each; see bsdf.py.

From the top of the surface down, each lobe takes its albedo from what is left for those below it.
"""

from __future__ import annotations

import numpy as np

from ..scene import MaterialKind
from .albedo import dielectric_share, lookup
from .bsdf import Bsdf
from .diffuse import oren_nayar_terms
from .layers import column, make_layers
from .microfacet import (
    dielectric_mean,
    fresnel_dielectric,
    glass_multiscatter_factor,
    interface,
    multiscatter_factor,
    normal_reflectance,
)
from .sampling import frame
from .shading_normal import orient
from .vec import dot, luminance, normalize


def make_bsdf(
    view: np.ndarray,
    normal: np.ndarray,
    geometric_normal: np.ndarray,
    rows: np.ndarray,
    smooth_normal: np.ndarray | None = None,
    tangent: np.ndarray | None = None,
    weight: np.ndarray | float = 1.0,
) -> Bsdf:
    """rows: [n, 48] of FlatScene.materials with the values of their maps, none of them a mix. normal: [n, 3], with the
    normal map; smooth_normal: without it. tangent: [n, 3], of anisotropy. weight: [n], of all lobes."""
    kind = column(rows, "kind")
    is_principled, is_glossy = kind == MaterialKind.PRINCIPLED, kind == MaterialKind.GLOSSY
    is_refractive = (kind == MaterialKind.GLASS) | (kind == MaterialKind.REFRACTION)
    oriented = orient(view, normal, geometric_normal, rows, smooth_normal)
    anisotropic = np.where(is_principled | is_glossy, column(rows, "anisotropic"), 0.0)
    x, y = _tangent_frame(oriented.normal, tangent, column(rows, "anisotropic_rotation"), anisotropic != 0.0)
    cos_view, cos_diffuse_view = dot(oriented.normal, view), dot(oriented.diffuse_normal, view)
    weight = np.broadcast_to(weight, kind.shape)

    layers = make_layers(rows, cos_diffuse_view, dot(oriented.coat_normal, view))
    below = layers.below * weight[:, None]
    alpha = _alphas(column(rows, "roughness"), anisotropic, is_glossy)
    # Of an anisotropic lobe the roughness that tables know is the fourth root of both alphas' product.
    mean_roughness = alpha.prod(axis=1) ** 0.25
    metallic = np.where(is_principled, column(rows, "metallic"), is_glossy)
    metal, metal_albedo = _metal(rows, below * metallic[:, None], mean_roughness, cos_view)
    transmission = np.where(is_principled, column(rows, "transmission"), is_refractive)
    below = below * (1.0 - metallic)[:, None]
    glass, glass_albedo = _glass(rows, below * transmission[:, None], cos_view, oriented.entering)
    below = below * (1.0 - transmission)[:, None]
    plastic, plastic_albedo, passed = _plastic(rows, below, mean_roughness, cos_view)
    diffuse, diffuse_albedo = _diffuse(rows, below * passed[:, None], cos_diffuse_view)
    sheen = layers.sheen * weight[:, None]
    coat_albedo = layers.coat_albedo * weight

    return Bsdf(
        view=view,
        x=x,
        y=y,
        z=oriented.normal,
        geometric_normal=oriented.geometric_normal,
        smooth_normal=oriented.smooth_normal,
        diffuse_normal=oriented.diffuse_normal,
        tilted_diffuse=oriented.tilted_diffuse,
        coat_normal=oriented.coat_normal,
        tilted_coat=oriented.tilted_coat,
        roughness=column(rows, "roughness"),
        alpha=alpha,
        **metal,
        **glass,
        **plastic,
        **diffuse,
        sheen=sheen,
        sheen_a=layers.sheen_a,
        sheen_b=layers.sheen_b,
        coat=layers.coat * weight,
        coat_alpha=layers.coat_alpha,
        coat_eta=layers.coat_eta,
        diffuse_albedo=diffuse_albedo + sheen,
        specular_albedo=metal_albedo + glass_albedo + plastic_albedo + coat_albedo[:, None],
        probability=_probability(diffuse_albedo, sheen, metal_albedo + plastic_albedo, coat_albedo, glass_albedo),
    )


def _metal(
    rows: np.ndarray, weight: np.ndarray, roughness: np.ndarray, cos_view: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Lobe S of metal, and of GLOSSY, whose Fresnel term is its colour from all directions: its fields, its albedo."""
    is_glossy = (column(rows, "kind") == MaterialKind.GLOSSY)[:, None]
    f0 = column(rows, "base_color")
    f90 = np.where(is_glossy, f0, np.ones_like(f0))
    # Schlick's term at 82 degrees, where the tint is what remains of it.
    schlick = (6.0 / 7.0) ** 5
    dip = (f0 + (1.0 - f0) * schlick) * (7.0 / (schlick * 6.0 / 7.0)) * (1.0 - column(rows, "specular_tint"))
    dip = np.where(is_glossy, 0.0, dip)
    mean = f0 + (f90 - f0) / 21.0 - dip / 126.0
    energy, factor = multiscatter_factor(roughness, cos_view, mean, column(rows, "multiscatter"))
    metal = weight * factor
    s = lookup("schlick", roughness, cos_view)[:, None]
    c = np.clip(cos_view, 0.0, 1.0)[:, None]
    single = np.clip(f0 + (f90 - f0) * s - dip * c * (1.0 - c) ** 6, 0.0, 1.0)
    return dict(metal=metal, metal_f0=f0, metal_f90=f90, metal_dip=dip), metal * energy[:, None] * single


def _glass(
    rows: np.ndarray, weight: np.ndarray, cos_view: np.ndarray, entering: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Lobe G: its fields, its albedo."""
    kind = column(rows, "kind")
    is_principled, is_glass, is_refraction = (
        (kind == which)[:, None] for which in (MaterialKind.PRINCIPLED, MaterialKind.GLASS, MaterialKind.REFRACTION)
    )
    base, roughness, ior = column(rows, "base_color"), column(rows, "roughness"), column(rows, "ior")
    eta = np.where(entering, ior, 1.0 / ior)
    f0 = normal_reflectance(ior)[:, None] * np.where(is_principled, column(rows, "specular_tint"), 1.0)
    transmission_tint = np.where(is_principled, np.sqrt(base), base)
    reflection_tint = np.where(is_glass, base, np.ones_like(base))
    factor = glass_multiscatter_factor(roughness, cos_view, eta, transmission_tint, column(rows, "multiscatter"))
    inside_out = fresnel_dielectric(cos_view, eta)
    outside_in = f0 + (1.0 - f0) * dielectric_share(roughness, cos_view, ior)[:, None]
    reflected = np.where(entering[:, None], outside_in, inside_out[:, None])
    reflected = np.where((eta == 1.0)[:, None], 0.0, reflected)
    passed = np.where(is_refraction, transmission_tint, (1.0 - reflected) * transmission_tint)
    both = np.where(is_refraction, 0.0, reflected * reflection_tint) + passed
    lobe = dict(
        glass=weight * np.where(is_refraction, 1.0, factor),
        glass_alpha=roughness**2,
        glass_f0=f0,
        glass_eta=eta,
        reflection_tint=reflection_tint,
        transmission_tint=transmission_tint,
        refracts_only=is_refraction[:, 0],
    )
    return lobe, weight * both


def _plastic(
    rows: np.ndarray, below: np.ndarray, roughness: np.ndarray, cos_view: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Lobe S of plastic: its fields, its albedo, and the share [n] that the base below it gets."""
    multiscatter = column(rows, "multiscatter")
    interface_f0, eta = interface(column(rows, "ior"), column(rows, "specular_ior_level"))
    there = (column(rows, "kind") == MaterialKind.PRINCIPLED) & (eta != 1.0) & (interface_f0 > 0.0)
    f0 = np.clip(interface_f0[:, None] * column(rows, "specular_tint"), 0.0, 1.0)
    real_f0 = normal_reflectance(eta)
    share = np.clip((dielectric_mean(eta) - real_f0) / (1.0 - real_f0), 0.0, 1.0)[:, None]
    energy, factor = multiscatter_factor(roughness, cos_view, f0 + (1.0 - f0) * share, multiscatter)
    plastic = np.where(there[:, None], below * factor, 0.0)
    single = f0 + (1.0 - f0) * dielectric_share(roughness, cos_view, eta)[:, None]
    # What multiscatter does not give back is not given to the base either.
    taken = (single * factor * np.where(multiscatter > 0.0, energy, 1.0)[:, None]).max(axis=1)
    passed = 1.0 - np.where(there, np.clip(taken, 0.0, 1.0), 0.0)
    return dict(plastic=plastic, plastic_f0=f0, plastic_eta=eta), plastic * energy[:, None] * single, passed


def _diffuse(rows: np.ndarray, below: np.ndarray, cos_view: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Lobe D: its fields, its albedo."""
    kind = column(rows, "kind")
    is_translucent = kind == MaterialKind.TRANSLUCENT
    there = (kind == MaterialKind.PRINCIPLED) | (kind == MaterialKind.DIFFUSE) | is_translucent
    base = column(rows, "base_color")
    diffuse = np.where(there[:, None], below * base, 0.0)
    roughness = np.where(is_translucent, 0.0, column(rows, "diffuse_roughness"))
    a, b, multiple, scale = oren_nayar_terms(roughness, cos_view, base)
    lobe = dict(
        diffuse=diffuse,
        transmits_diffuse=is_translucent,
        oren_nayar_a=a,
        oren_nayar_b=b,
        oren_nayar_multiple=multiple,
    )
    return lobe, diffuse * scale


def _probability(
    diffuse: np.ndarray, sheen: np.ndarray, specular: np.ndarray, coat: np.ndarray, glass: np.ndarray
) -> np.ndarray:
    """[n, 5], of choosing D, H, S, C, G: by their albedos, colours [n, 3] but for the coat's [n]."""
    weights = np.stack([luminance(diffuse), luminance(sheen), luminance(specular), coat, luminance(glass)], axis=1)
    total = weights.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), 0.0)


def _alphas(roughness: np.ndarray, anisotropic: np.ndarray, is_glossy: np.ndarray) -> np.ndarray:
    """GGX alpha along X and Y, [n, 2]."""
    alpha = roughness**2
    aspect = np.sqrt(1.0 - np.clip(anisotropic, 0.0, 1.0) * 0.9)
    ratio = 1.0 - np.minimum(np.abs(anisotropic), 0.99)
    narrow, wide = alpha * ratio, alpha / ratio
    below_zero = anisotropic < 0.0
    along_x = np.where(is_glossy, np.where(below_zero, wide, narrow), alpha / aspect)
    along_y = np.where(is_glossy, np.where(below_zero, narrow, wide), alpha * aspect)
    return np.clip(np.stack([along_x, along_y], axis=1), 0.0, 1.0)


def _tangent_frame(
    normal: np.ndarray, tangent: np.ndarray | None, rotation: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """X and Y. rotation: turns of the tangent around the normal. Where there is no tangent: any."""
    x, y = frame(normal)
    if tangent is None:
        return x, y
    across = np.cross(normal, tangent)
    there = wanted & (np.linalg.norm(across, axis=1) > 1e-6 * np.linalg.norm(tangent, axis=1))
    side = normalize(across)
    along = np.cross(side, normal)
    angle = (2.0 * np.pi * rotation)[:, None]
    turned = np.cos(angle) * along + np.sin(angle) * side
    x = np.where(there[:, None], turned, x)
    return x, np.where(there[:, None], np.cross(normal, x), y)
