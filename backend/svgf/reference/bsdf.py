# SPDX-License-Identifier: Apache-2.0
"""The materials as Cycles defines them, as a sum of five lobes.

D, diffuse: Lambert or Oren-Nayar, in reflection, or in transmission for TRANSLUCENT. H, sheen: a linearly transformed
cosine. S, specular: GGX reflection, of the interface of plastic and of metal. C, coat: GGX reflection of its own
roughness. G, glass: GGX reflection and refraction.

Sheen, coat and interface lie on each other in this order; each takes its albedo away from what lies below. Of light
that GGX loses between microfacets, each lobe is given back what Fresnel's term leaves of it, as a factor [Kulla17].

All arrays have one row per ray. V is the direction to the viewer, L the sampled one; both point away from the surface.
Local directions are in a frame whose Z is the shading normal N and whose X is the tangent. What lies on the wrong side
of the geometric normal Ng is black. Under a normal map D and H have the map's normal, of which S and G take what keeps
their reflections above the surface, and C the smooth one unless told otherwise: such lobes are tilted.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..scene import MaterialKind
from .albedo import dielectric_share, lookup
from .diffuse import oren_nayar, oren_nayar_terms
from .layers import column, has_smooth_coat_normal, make_layers
from .microfacet import (
    dielectric_mean,
    fresnel_dielectric,
    fresnel_metal,
    fresnel_tinted,
    ggx_density,
    ggx_lambda,
    glass_multiscatter_factor,
    interface,
    multiscatter_factor,
    normal_reflectance,
    reflect,
    refract,
    sample_visible_normal,
)
from .sampling import cosine_hemisphere, frame
from .shading_normal import bump_shadowing, raise_viewer, valid_reflection
from .vec import dot, flip_towards, luminance, normalize

# GGX alpha below which a lobe is a mirror.
SMOOTH_ALPHA = 1e-3

# Events of BsdfSample.
NONE, DIFFUSE, GLOSSY, TRANSMISSION = range(4)


@dataclass
class Bsdf:
    """One material at each hit. Colours [n, 3], the rest [n], alpha [n, 2].

    x, y, z: axes of the local frame; z is N. smooth_normal: N before the normal map. diffuse_normal, coat_normal: of D
    and C; tilted_diffuse, tilted_coat: whether they are not N.
    diffuse, plastic, metal, glass: weights of the lobes, with all factors but those below. oren_nayar_*: see
    oren_nayar. transmits_diffuse: D is in transmission. plastic_f0, plastic_eta, metal_f0, metal_f90, metal_dip: of
    Fresnel's terms. glass_eta: IOR beyond the surface over that on the viewer's side. refracts_only: G without
    Fresnel's term and reflection.
    *_albedo: of the lobes towards V, D and H, and the others. probability: [n, 5], of choosing D, H, S, C, G.
    """

    view: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    geometric_normal: np.ndarray
    smooth_normal: np.ndarray
    diffuse_normal: np.ndarray
    tilted_diffuse: np.ndarray
    coat_normal: np.ndarray
    tilted_coat: np.ndarray
    roughness: np.ndarray
    diffuse: np.ndarray
    transmits_diffuse: np.ndarray
    oren_nayar_a: np.ndarray
    oren_nayar_b: np.ndarray
    oren_nayar_multiple: np.ndarray
    alpha: np.ndarray
    plastic: np.ndarray
    plastic_f0: np.ndarray
    plastic_eta: np.ndarray
    metal: np.ndarray
    metal_f0: np.ndarray
    metal_f90: np.ndarray
    metal_dip: np.ndarray
    glass: np.ndarray
    glass_alpha: np.ndarray
    glass_f0: np.ndarray
    glass_eta: np.ndarray
    reflection_tint: np.ndarray
    transmission_tint: np.ndarray
    refracts_only: np.ndarray
    sheen: np.ndarray
    sheen_a: np.ndarray
    sheen_b: np.ndarray
    coat: np.ndarray
    coat_alpha: np.ndarray
    coat_eta: np.ndarray
    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    probability: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        return self.z

    @property
    def smooth(self) -> np.ndarray:
        """bool [n]: lobe S is a mirror."""
        return self.alpha.max(axis=1) < SMOOTH_ALPHA

    @property
    def smooth_coat(self) -> np.ndarray:
        return self.coat_alpha < SMOOTH_ALPHA

    @property
    def smooth_glass(self) -> np.ndarray:
        """bool [n]: lobe G is a mirror, or there is no interface and it goes straight on."""
        return (self.glass_alpha < SMOOTH_ALPHA) | (self.glass_eta == 1.0)

    def to_local(self, vector: np.ndarray) -> np.ndarray:
        return np.stack([dot(vector, axis) for axis in (self.x, self.y, self.z)], axis=1)

    def to_world(self, local: np.ndarray) -> np.ndarray:
        return local[:, 0:1] * self.x + local[:, 1:2] * self.y + local[:, 2:3] * self.z

    def rows(self, chosen: np.ndarray) -> Bsdf:
        return Bsdf(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


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
    is_glass, is_refraction = kind == MaterialKind.GLASS, kind == MaterialKind.REFRACTION
    is_translucent = kind == MaterialKind.TRANSLUCENT
    base, roughness, ior = column(rows, "base_color"), column(rows, "roughness"), column(rows, "ior")
    tint = column(rows, "specular_tint")
    multiscatter = column(rows, "multiscatter")

    metallic = np.where(is_principled, column(rows, "metallic"), is_glossy)
    transmission = np.where(is_principled, column(rows, "transmission"), is_glass | is_refraction)
    interface_f0, plastic_eta = interface(ior, column(rows, "specular_ior_level"))
    has_interface = is_principled & (plastic_eta != 1.0) & (interface_f0 > 0.0)
    glass_share = (1.0 - metallic) * transmission
    plastic_share = np.where(has_interface, (1.0 - metallic) * (1.0 - transmission), 0.0)
    is_layered = is_principled & ((column(rows, "sheen_weight") > 0.0) | (column(rows, "coat_weight") > 0.0))
    has_specular = is_layered | (metallic > 0.0) | (transmission > 0.0) | has_interface

    entering = dot(geometric_normal, view) > 0.0
    geometric_normal = flip_towards(geometric_normal, view)
    flipped = flip_towards(normal, geometric_normal)
    smooth_normal = flipped if smooth_normal is None else flip_towards(smooth_normal, geometric_normal)
    reflecting = raise_viewer(valid_reflection(flipped, geometric_normal, view), view)
    normal = np.where(has_specular[:, None], reflecting, flipped)
    # Reflections must stay above the surface; what a normal map makes of diffuse light may be below.
    tilted_diffuse = (column(rows, "normal_uv_layer") >= 0) & (normal != flipped).any(axis=1)
    diffuse_normal = np.where(tilted_diffuse[:, None], flipped, normal)
    anisotropic = np.where(is_principled | is_glossy, column(rows, "anisotropic"), 0.0)
    x, y = _tangent_frame(normal, tangent, column(rows, "anisotropic_rotation"), anisotropic != 0.0)
    cos_view = dot(normal, view)

    smooth_coat_normal = raise_viewer(valid_reflection(smooth_normal, geometric_normal, view), view)
    tilted_coat = is_principled & has_smooth_coat_normal(rows) & (column(rows, "coat_weight") > 0.0)
    coat_normal = np.where(tilted_coat[:, None], smooth_coat_normal, normal)
    layers = make_layers(rows, dot(diffuse_normal, view), dot(coat_normal, view))
    below = layers.below * np.broadcast_to(weight, kind.shape)[:, None]
    n = len(rows)
    ones = np.ones((n, 3))

    # Metal, and GLOSSY, whose Fresnel term is its colour from all directions.
    metal_f0 = base
    metal_f90 = np.where(is_glossy[:, None], base, 1.0)
    schlick = (6.0 / 7.0) ** 5
    dip = (base + (1.0 - base) * schlick) * (7.0 / (schlick * 6.0 / 7.0)) * (1.0 - tint)
    metal_dip = np.where(is_glossy[:, None], 0.0, dip)
    mean = metal_f0 + (metal_f90 - metal_f0) / 21.0 - metal_dip / 126.0
    # Of an anisotropic lobe Cycles' roughness is the fourth root of both alphas' product, clamped as they are.
    alpha = _alphas(roughness, anisotropic, is_glossy)
    mean_roughness = alpha.prod(axis=1) ** 0.25
    energy, factor = multiscatter_factor(mean_roughness, cos_view, mean, multiscatter)
    metal = below * metallic[:, None] * factor
    s = lookup("schlick", mean_roughness, cos_view)[:, None]
    c = np.clip(cos_view, 0.0, 1.0)[:, None]
    metal_albedo = np.clip(metal_f0 + (metal_f90 - metal_f0) * s - metal_dip * c * (1.0 - c) ** 6, 0.0, 1.0)
    specular_albedo = metal * energy[:, None] * metal_albedo

    # Glass.
    glass_eta = np.where(entering, ior, 1.0 / ior)
    glass_f0 = normal_reflectance(ior)[:, None] * np.where(is_principled[:, None], tint, 1.0)
    transmission_tint = np.where(is_principled[:, None], np.sqrt(base), base)
    reflection_tint = np.where(is_glass[:, None], base, 1.0)
    glass_factor = glass_multiscatter_factor(roughness, cos_view, glass_eta, transmission_tint, multiscatter)
    glass_factor = np.where(is_refraction[:, None], 1.0, glass_factor)
    glass = below * glass_share[:, None] * glass_factor
    inside_out = fresnel_dielectric(cos_view, glass_eta)
    outside_in = glass_f0 + (1.0 - glass_f0) * dielectric_share(roughness, cos_view, ior)[:, None]
    reflected = np.where(entering[:, None], outside_in, inside_out[:, None])
    reflected = np.where((glass_eta == 1.0)[:, None], 0.0, reflected)
    passed = np.where(is_refraction[:, None], transmission_tint, (1.0 - reflected) * transmission_tint)
    both = np.where(is_refraction[:, None], 0.0, reflected * reflection_tint) + passed
    glass_albedo = below * glass_share[:, None] * both
    specular_albedo = specular_albedo + glass_albedo

    # The interface of plastic, and the diffuse base below it.
    plastic_f0 = np.clip(interface_f0[:, None] * tint, 0.0, 1.0)
    f0 = normal_reflectance(plastic_eta)
    share = np.clip((dielectric_mean(plastic_eta) - f0) / (1.0 - f0), 0.0, 1.0)[:, None]
    mean = plastic_f0 + (1.0 - plastic_f0) * share
    energy, factor = multiscatter_factor(mean_roughness, cos_view, mean, multiscatter)
    plastic = below * plastic_share[:, None] * factor
    s = dielectric_share(mean_roughness, cos_view, plastic_eta)[:, None]
    plastic_albedo = plastic * energy[:, None] * (plastic_f0 + (1.0 - plastic_f0) * s)
    # What multiscatter does not give back is not given to the base either.
    counted = np.where(multiscatter > 0.0, energy, 1.0)[:, None]
    taken = ((plastic_f0 + (1.0 - plastic_f0) * s) * factor * counted).max(axis=1)
    taken = np.where(has_interface, np.clip(taken, 0.0, 1.0), 0.0)
    has_diffuse = is_principled | is_translucent | (kind == MaterialKind.DIFFUSE)
    diffuse_share = np.where(has_diffuse, (1.0 - metallic) * (1.0 - transmission) * (1.0 - taken), 0.0)
    diffuse = below * diffuse_share[:, None] * base
    a, b, multiple, diffuse_scale = oren_nayar_terms(np.where(is_translucent, 0.0, column(rows, "diffuse_roughness")),
                                                      dot(diffuse_normal, view), base)  # fmt: skip
    diffuse_albedo = diffuse * diffuse_scale
    sheen = layers.sheen * np.broadcast_to(weight, kind.shape)[:, None]
    coat = layers.coat * weight

    weights = np.stack(
        [
            luminance(diffuse_albedo),
            luminance(sheen),
            luminance(specular_albedo - glass_albedo + plastic_albedo),
            layers.coat_albedo * weight,
            luminance(glass_albedo),
        ],
        axis=1,
    )
    total = weights.sum(axis=1, keepdims=True)
    probability = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), 0.0)
    coat_albedo = (layers.coat_albedo * weight)[:, None]
    return Bsdf(
        view=view,
        x=x,
        y=y,
        z=normal,
        geometric_normal=geometric_normal,
        smooth_normal=smooth_normal,
        diffuse_normal=diffuse_normal,
        tilted_diffuse=tilted_diffuse,
        coat_normal=coat_normal,
        tilted_coat=tilted_coat,
        roughness=roughness,
        diffuse=diffuse,
        transmits_diffuse=is_translucent,
        oren_nayar_a=a,
        oren_nayar_b=b,
        oren_nayar_multiple=multiple,
        alpha=alpha,
        plastic=plastic,
        plastic_f0=plastic_f0,
        plastic_eta=plastic_eta,
        metal=metal,
        metal_f0=metal_f0,
        metal_f90=metal_f90 * ones,
        metal_dip=metal_dip,
        glass=glass,
        glass_alpha=roughness**2,
        glass_f0=glass_f0,
        glass_eta=glass_eta,
        reflection_tint=reflection_tint * ones,
        transmission_tint=transmission_tint,
        refracts_only=is_refraction,
        sheen=sheen,
        sheen_a=layers.sheen_a,
        sheen_b=layers.sheen_b,
        coat=coat,
        coat_alpha=layers.coat_alpha,
        coat_eta=layers.coat_eta,
        diffuse_albedo=diffuse_albedo + sheen,
        specular_albedo=specular_albedo + plastic_albedo + coat_albedo,
        probability=probability,
    )


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


# Below it the fits divide by almost 0.
SMALLEST_SHEEN_ROUGHNESS = 0.01


def glass_events(bsdf: Bsdf, cos_half_view: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of lobe G at a microfacet: tinted reflectance and transmittance, [n, 3], and the chance of choosing
    reflection."""
    reflectance = fresnel_tinted(cos_half_view, bsdf.glass_eta, bsdf.glass_f0)
    reflectance = np.where((bsdf.glass_eta == 1.0)[:, None], 0.0, reflectance)
    blocked = (fresnel_dielectric(cos_half_view, bsdf.glass_eta) == 1.0) & (bsdf.glass_eta != 1.0)
    only = bsdf.refracts_only[:, None]
    transmittance = np.where(only, ~blocked[:, None], 1.0 - reflectance) * bsdf.transmission_tint
    reflectance = np.where(only, 0.0, reflectance * bsdf.reflection_tint)
    total = (reflectance + transmittance).sum(axis=1)
    return reflectance, transmittance, np.where(total > 0.0, reflectance.sum(axis=1) / np.maximum(total, 1e-300), 1.0)


def specular_at(bsdf: Bsdf, cos_half_view: np.ndarray) -> np.ndarray:
    """Fresnel's terms of lobe S with their weights, [n, 3]."""
    plastic = fresnel_tinted(cos_half_view, bsdf.plastic_eta, bsdf.plastic_f0)
    metal = fresnel_metal(bsdf.metal_f0, bsdf.metal_f90, bsdf.metal_dip, cos_half_view)
    return bsdf.plastic * plastic + bsdf.metal * metal


def coat_at(bsdf: Bsdf, cos_half_view: np.ndarray) -> np.ndarray:
    return bsdf.coat * fresnel_dielectric(cos_half_view, bsdf.coat_eta)


@dataclass
class SmoothBounce:
    """The mirrored or the refracted direction [n, 3] of surfaces that are smooth and not diffuse, whichever carries
    more. event: [n], NONE where the surface scatters. weight: [n, 3], of all mirrors that lead there. elsewhere:
    [n, 3], albedo of the rest. eta: [n], of refraction."""

    event: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    elsewhere: np.ndarray
    eta: np.ndarray


def smooth_bounce(bsdf: Bsdf) -> SmoothBounce:
    view = bsdf.to_local(bsdf.view)
    cosine = view[:, 2]
    reflectance, transmittance, _ = glass_events(bsdf, cosine)
    has_glass = (bsdf.smooth_glass & (bsdf.probability[:, 4] > 0.0))[:, None]
    reflected = np.where(bsdf.smooth[:, None], specular_at(bsdf, cosine), 0.0)
    reflected = reflected + np.where(bsdf.smooth_coat & ~bsdf.tilted_coat, coat_at(bsdf, cosine), 0.0)[:, None]
    reflected = reflected + np.where(has_glass, bsdf.glass * reflectance, 0.0)
    refracted = np.where(has_glass, bsdf.glass * transmittance, 0.0)
    rough = np.maximum(bsdf.specular_albedo - reflected - refracted, 0.0)
    refracts = luminance(refracted) > luminance(reflected)
    weight = np.where(refracts[:, None], refracted, reflected)
    elsewhere = rough + np.where(refracts[:, None], reflected, refracted)

    half = np.broadcast_to([0.0, 0.0, 1.0], view.shape)
    bent = np.where((bsdf.glass_eta == 1.0)[:, None], -view, refract(view, half, bsdf.glass_eta))
    local = np.where(refracts[:, None], bent, reflect(view, half))
    direction = normalize(bsdf.to_world(local))
    side = np.where(refracts, -1.0, 1.0)
    follows = (luminance(weight) > luminance(elsewhere)) & (bsdf.diffuse_albedo.max(axis=1, initial=0.0) == 0.0)
    follows &= (local[:, 2] * side > 0.0) & (dot(bsdf.geometric_normal, direction) * side > 0.0)
    event = np.where(follows, np.where(refracts, TRANSMISSION, GLOSSY), NONE)
    return SmoothBounce(event, direction, weight, elsewhere, bsdf.glass_eta)


def _uniform(alpha: np.ndarray) -> np.ndarray:
    return np.repeat(alpha[:, None], 2, axis=1)


def evaluate(bsdf: Bsdf, light: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diffuse and other lobes, times |cosine|, [n, 3] each, and the density [n] with which ``sample`` finds light.

    Smooth lobes have no part in any of the three.
    """
    local, view = bsdf.to_local(light), bsdf.to_local(bsdf.view)
    cos_light = local[:, 2]
    side = dot(bsdf.geometric_normal, light)
    above, below = (cos_light > 0.0) & (side > 0.0), (cos_light < 0.0) & (side < 0.0)
    of_diffuse, of_sheen, of_specular, of_coat, of_glass = bsdf.probability.T

    diffuse_view, diffuse_light = (
        _to_lobe(bsdf, vector, bsdf.diffuse_normal, bsdf.tilted_diffuse) for vector in (bsdf.view, light)
    )
    hidden, darkening = bump_shadowing(bsdf.smooth_normal, bsdf.diffuse_normal, light)
    cosine = diffuse_light[:, 2]
    diffuse_above = (cosine > 0.0) & (side > 0.0)
    lit = np.where(bsdf.transmits_diffuse, (cosine < 0.0) & (side < 0.0), diffuse_above)
    cosine = np.where(lit, np.abs(cosine), 0.0)
    darkening = np.where(hidden, 0.0, np.where(bsdf.transmits_diffuse, 1.0, darkening))
    reflected = oren_nayar(
        bsdf.oren_nayar_a, bsdf.oren_nayar_b, bsdf.oren_nayar_multiple, diffuse_view, diffuse_light
    )
    diffuse = bsdf.diffuse * reflected * (cosine * darkening)[:, None]
    pdf = of_diffuse * cosine / np.pi

    density = np.where(diffuse_above, sheen_density(bsdf, diffuse_light, diffuse_view), 0.0)
    diffuse = diffuse + bsdf.sheen * (density * darkening)[:, None]
    pdf = pdf + of_sheen * density

    # Reflection at microfacets: D G2 / (4 NV NL) times NL.
    half = normalize(view + local)
    cos_half_view = dot(view, half)
    specular = np.zeros_like(diffuse)
    reflectance, transmittance, chance = glass_events(bsdf, cos_half_view)
    for value, probability, alpha, smooth in (
        (specular_at(bsdf, cos_half_view), of_specular, bsdf.alpha, bsdf.smooth),
        (bsdf.glass * reflectance, of_glass * chance, _uniform(bsdf.glass_alpha), bsdf.smooth_glass),
    ):
        lambda_view, lambda_light = ggx_lambda(view, alpha), ggx_lambda(local, alpha)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.where(above & ~smooth, ggx_density(half, alpha) / (4.0 * view[:, 2]), 0.0)
        specular = specular + value * (spread / (1.0 + lambda_view + lambda_light))[:, None]
        pdf = pdf + probability * spread / (1.0 + lambda_view)

    # The coat's, by its own normal; of the side of Ng alone where that is not N.
    coat_view, coat_light = (
        _to_lobe(bsdf, vector, bsdf.coat_normal, bsdf.tilted_coat) for vector in (bsdf.view, light)
    )
    coat_half = normalize(coat_view + coat_light)
    lit = np.where(bsdf.tilted_coat, (side > 0.0) & (coat_light[:, 2] > 0.0), above)
    alpha = _uniform(bsdf.coat_alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = ggx_density(coat_half, alpha) / (4.0 * coat_view[:, 2])
    spread = np.where(lit & ~bsdf.smooth_coat & (coat_view[:, 2] > 0.0), spread, 0.0)
    lambda_view, lambda_light = ggx_lambda(coat_view, alpha), ggx_lambda(coat_light, alpha)
    coat = coat_at(bsdf, dot(coat_view, coat_half)) * spread / (1.0 + lambda_view + lambda_light)
    specular = specular + coat[:, None]
    pdf = pdf + of_coat * spread / (1.0 + lambda_view)

    # Refraction at microfacets [Walter07, Eq. 21] with the Jacobian of the half vector, Eq. 17.
    eta = bsdf.glass_eta
    half = normalize(-(view + eta[:, None] * local))
    half = np.where((half[:, 2] < 0.0)[:, None], -half, half)
    cos_half_view, cos_half_light = dot(view, half), dot(local, half)
    rough = below & ~bsdf.smooth_glass & (cos_half_view > 0.0) & (cos_half_light < 0.0)
    alpha = _uniform(bsdf.glass_alpha)
    lambda_view, lambda_light = ggx_lambda(view, alpha), ggx_lambda(local, alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        jacobian = eta**2 * np.abs(cos_half_light) / (cos_half_view + eta * cos_half_light) ** 2
        spread = ggx_density(half, alpha) * cos_half_view / view[:, 2] * jacobian
    spread = np.where(rough, spread, 0.0)
    reflectance, transmittance, chance = glass_events(bsdf, cos_half_view)
    specular = specular + bsdf.glass * transmittance * (spread / (1.0 + lambda_view + lambda_light))[:, None]
    pdf = pdf + of_glass * (1.0 - chance) * spread / (1.0 + lambda_view)
    return diffuse, specular, pdf


def _to_lobe(bsdf: Bsdf, vector: np.ndarray, normal: np.ndarray, tilted: np.ndarray) -> np.ndarray:
    """Local vectors in the frame of a lobe whose normal is not N where it is tilted."""
    x, y = frame(normal)
    own = np.stack([dot(vector, axis) for axis in (x, y, normal)], axis=1)
    return np.where(tilted[:, None], own, bsdf.to_local(vector))


def _from_lobe(bsdf: Bsdf, local: np.ndarray, normal: np.ndarray, tilted: np.ndarray) -> np.ndarray:
    """World vectors, the inverse."""
    x, y = frame(normal)
    own = local[:, 0:1] * x + local[:, 1:2] * y + local[:, 2:3] * normal
    return np.where(tilted[:, None], own, bsdf.to_world(local))


def _turned(vector: np.ndarray, view: np.ndarray, back: bool = False) -> np.ndarray:
    """Local vectors in the frame whose X is the view's azimuth, or back from there."""
    length = np.hypot(view[:, 0], view[:, 1])
    there = length > 1e-8
    cosine = np.where(there, view[:, 0] / np.where(there, length, 1.0), 1.0)
    sine = np.where(there, view[:, 1] / np.where(there, length, 1.0), 0.0) * (-1.0 if back else 1.0)
    x, y, z = vector.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def sheen_density(bsdf: Bsdf, local: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Density of lobe H, which is also its value over its weight [Zeltner22, Eq. 3]."""
    x, y, z = _turned(local, view).T
    a, b = bsdf.sheen_a, bsdf.sheen_b
    squared = (a * x + b * z) ** 2 + (a * y) ** 2 + z**2
    return np.maximum(z, 0.0) / np.pi * (a / np.maximum(squared, 1e-30)) ** 2


def sample_sheen(bsdf: Bsdf, view: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Local direction: a cosine-distributed one through the inverse of the transform."""
    x, y, z = cosine_hemisphere(uv).T
    a, b = bsdf.sheen_a, bsdf.sheen_b
    return _turned(normalize(np.stack([x - b * z, y, a * z], axis=1)), view, back=True)


@dataclass
class BsdfSample:
    """direction: [n, 3] unit. diffuse, specular: [n, 3], lobe value times |cosine| over pdf. pdf: [n], 0 where delta.
    event: [n], NONE, DIFFUSE, GLOSSY or TRANSMISSION, as Cycles counts bounces.

    Both values are zero where the direction is on the wrong side of the surface, and where the material is black.
    """

    direction: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    pdf: np.ndarray
    delta: np.ndarray
    event: np.ndarray


def sample(bsdf: Bsdf, uv: np.ndarray, lobe: np.ndarray) -> BsdfSample:
    """uv: [n, 2] and lobe: [n], uniform in [0, 1). lobe chooses D, H, S, C or G in this order; what is left of it
    chooses reflection or refraction in G."""
    ends = np.cumsum(bsdf.probability, axis=1)
    begins = ends - bsdf.probability
    of_diffuse, of_sheen, of_specular, of_coat = (
        (lobe >= begins[:, i]) & (lobe < ends[:, i]) & (bsdf.probability[:, i] > 0.0) for i in range(4)
    )
    of_glass = (lobe >= ends[:, 3]) & (bsdf.probability[:, 4] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = (lobe - ends[:, 3]) / bsdf.probability[:, 4]

    lobe_normal = np.where(of_coat[:, None], bsdf.coat_normal, bsdf.diffuse_normal)
    tilted = np.where(of_coat, bsdf.tilted_coat, bsdf.tilted_diffuse & (of_diffuse | of_sheen))
    view = _to_lobe(bsdf, bsdf.view, lobe_normal, tilted)
    alpha = np.where(of_coat[:, None], _uniform(bsdf.coat_alpha), bsdf.alpha)
    alpha = np.where(of_glass[:, None], _uniform(bsdf.glass_alpha), alpha)
    mirror = np.select([of_specular, of_coat, of_glass], [bsdf.smooth, bsdf.smooth_coat, bsdf.smooth_glass], False)
    half = np.where(mirror[:, None], [0.0, 0.0, 1.0], sample_visible_normal(view, alpha, uv))
    cos_half = dot(view, half)
    reflectance, transmittance, chance = glass_events(bsdf, cos_half)
    refracts = of_glass & ~(rest < chance)

    light = np.where(refracts[:, None], refract(view, half, bsdf.glass_eta), reflect(view, half))
    light = np.where((refracts & (bsdf.glass_eta == 1.0))[:, None], -view, light)
    cosine = cosine_hemisphere(uv)
    cosine[:, 2] *= np.where(bsdf.transmits_diffuse, -1.0, 1.0)
    light = np.where(of_diffuse[:, None], cosine, light)
    light = np.where(of_sheen[:, None], sample_sheen(bsdf, view, uv), light)
    cos_light = light[:, 2]
    light = normalize(_from_lobe(bsdf, light, lobe_normal, tilted))

    # A microfacet can reflect below the horizon or refract above it. Such a direction is lost: the densities of the
    # other kind of event, which do reach it, do not count this one.
    goes_below = refracts | (of_diffuse & bsdf.transmits_diffuse)
    side = dot(bsdf.geometric_normal, light)
    passes = np.where(goes_below, (cos_light < 0.0) & (side < 0.0), (cos_light > 0.0) & (side > 0.0))
    passes &= of_diffuse | of_sheen | of_specular | of_coat | of_glass

    diffuse, specular, pdf = evaluate(bsdf, light)
    found = passes & (pdf > 0.0) & ~mirror
    with np.errstate(divide="ignore", invalid="ignore"):
        diffuse = np.where(found[:, None], diffuse / pdf[:, None], 0.0)
        specular = np.where(found[:, None], specular / pdf[:, None], 0.0)

        # A mirror: the lobe's value over the probability of choosing it.
        chance = np.where(refracts, 1.0 - chance, chance)[:, None]
        glass = bsdf.glass * np.where(refracts[:, None], transmittance, reflectance) / chance
        weight = np.where(of_glass[:, None], glass / bsdf.probability[:, 4:5], 0.0)
        weight = np.where(of_specular[:, None], specular_at(bsdf, cos_half) / bsdf.probability[:, 2:3], weight)
        weight = np.where(of_coat[:, None], (coat_at(bsdf, cos_half) / bsdf.probability[:, 3])[:, None], weight)
    specular = np.where((passes & mirror)[:, None], weight, specular)
    event = np.select([goes_below, of_diffuse | of_sheen], [TRANSMISSION, DIFFUSE], GLOSSY)
    event = np.where(found | (passes & mirror), event, NONE)
    return BsdfSample(light, diffuse, specular, np.where(found, pdf, 0.0), mirror, event)
