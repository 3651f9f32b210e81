# SPDX-License-Identifier: Apache-2.0
"""The Principled BSDF that svgf simulates: three lobes.

D, diffuse: Lambert under a dielectric coat. S, specular: GGX reflection, of the coat and of metal. G, glass: GGX
reflection and refraction. The coat takes its albedo away from what lies below it, so that no mixture of lobes reflects
more than it gets.

All arrays have one row per ray. V is the direction to the viewer, L the sampled one; both point away from the surface.
Angles are measured from the shading normal N; what lies on the wrong side of the geometric normal Ng is black.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..scene import RayVisibility
from .sampling import cosine_hemisphere, to_local, to_world
from .vec import dot, flip_towards, luminance, normalize

# GGX alpha below which a lobe is a mirror.
SMOOTH_ALPHA = 1e-3
# Shading normals are bent so that the viewer stays above the horizon.
SMALLEST_COSINE = 0.01
LARGEST_F0 = 0.99
# [MaterialX]: coefficients of 1, x, y, xy, x^2, y^2, x^2 y, x y^2, x^2 y^2 with x = N.V and y = alpha; two numerators and
# their denominators.
ALBEDO_FIT = np.array(
    [
        [0.1003, -0.6303, 9.748, -2.038, 29.34, -8.245, -26.44, 19.99, -5.448],
        [0.9345, -2.323, 2.229, -3.748, 1.424, -0.7684, 1.436, 0.2913, 0.6286],
        [1.0, -1.765, 8.263, 11.53, 28.96, -7.507, -36.11, 15.86, 33.37],
        [1.0, 0.2281, 15.94, -55.83, 13.08, 41.26, 54.9, 300.2, -285.1],
    ]
)


@dataclass
class Bsdf:
    """One material at each hit. Colours [n, 3], the rest [n].

    plastic, metal, glass: shares of the three kinds of surface. coat_eta: relative IOR of plastic's coat; glass_eta:
    IOR beyond the surface over IOR on the viewer's side. *_albedo: of the lobes towards V. *_probability: of choosing
    lobe D, S, G.
    """

    view: np.ndarray
    normal: np.ndarray
    geometric_normal: np.ndarray
    base: np.ndarray
    tint: np.ndarray
    roughness: np.ndarray
    alpha: np.ndarray
    plastic: np.ndarray
    metal: np.ndarray
    glass: np.ndarray
    coat_eta: np.ndarray
    glass_eta: np.ndarray
    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    diffuse_probability: np.ndarray
    specular_probability: np.ndarray
    glass_probability: np.ndarray

    @property
    def smooth(self) -> np.ndarray:
        """bool [n]: lobes S and G are mirrors."""
        return self.alpha < SMOOTH_ALPHA

    @property
    def smooth_glass(self) -> np.ndarray:
        """bool [n]: lobe G is a mirror, or there is no interface and it goes straight on."""
        return self.smooth | (self.glass_eta == 1.0)

    def rows(self, chosen: np.ndarray) -> Bsdf:
        return Bsdf(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


def make_bsdf(
    view: np.ndarray, normal: np.ndarray, geometric_normal: np.ndarray, materials: np.ndarray, base: np.ndarray
) -> Bsdf:
    """materials: rows [n, 16] of FlatScene.materials. base: [n, 3], the base colour, textures included."""
    metallic, roughness, ior, transmission, level = materials[:, 4:9].T
    tint = materials[:, 9:12]
    entering = dot(geometric_normal, view) > 0.0
    geometric_normal = flip_towards(geometric_normal, view)
    normal = raise_viewer(flip_towards(normal, geometric_normal), view)

    metal = metallic
    glass = (1.0 - metallic) * transmission
    plastic = (1.0 - metallic) * (1.0 - transmission)
    f0 = np.minimum(normal_reflectance(ior) * 2.0 * level, LARGEST_F0)
    coat_eta = (1.0 + np.sqrt(f0)) / (1.0 - np.sqrt(f0))
    glass_eta = np.where(entering, ior, 1.0 / ior)

    cos_view = dot(normal, view)
    coat_albedo = dielectric_albedo(f0, roughness, cos_view)
    glass_albedo = dielectric_albedo(normal_reflectance(ior), roughness, cos_view)
    metal_albedo = ggx_albedo(base, roughness[:, None], cos_view[:, None])
    diffuse = (plastic * (1.0 - coat_albedo))[:, None] * base
    specular = (plastic * coat_albedo)[:, None] * tint + metal[:, None] * metal_albedo
    through = glass_albedo[:, None] + (1.0 - glass_albedo)[:, None] * np.sqrt(base)

    weights = np.stack([luminance(diffuse), luminance(specular), glass], axis=1)
    total = weights.sum(axis=1, keepdims=True)
    probabilities = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), 0.0)
    return Bsdf(
        view=view,
        normal=normal,
        geometric_normal=geometric_normal,
        base=base,
        tint=tint,
        roughness=roughness,
        alpha=roughness**2,
        plastic=plastic,
        metal=metal,
        glass=glass,
        coat_eta=coat_eta,
        glass_eta=glass_eta,
        diffuse_albedo=diffuse,
        specular_albedo=specular + glass[:, None] * through,
        diffuse_probability=probabilities[:, 0],
        specular_probability=probabilities[:, 1],
        glass_probability=probabilities[:, 2],
    )


def raise_viewer(normal: np.ndarray, view: np.ndarray) -> np.ndarray:
    cosine = dot(normal, view)
    bent = normalize(normal + view * (SMALLEST_COSINE - cosine)[:, None])
    return np.where((cosine < SMALLEST_COSINE)[:, None], bent, normal)


def normal_reflectance(ior: np.ndarray) -> np.ndarray:
    return ((ior - 1.0) / (ior + 1.0)) ** 2


def fresnel_dielectric(cos_incident: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Unpolarized reflectance [Walter07, Eq. 22]; 1 at total internal reflection. eta: IOR beyond over IOR before the
    surface."""
    c = np.abs(cos_incident)
    g_squared = eta * eta - 1.0 + c * c
    g = np.sqrt(np.maximum(g_squared, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
        reflectance = 0.5 * ((g - c) / (g + c)) ** 2 * (1.0 + ratio * ratio)
    reflectance = np.where(eta == 1.0, 0.0, reflectance)
    return np.where(g_squared > 0.0, np.clip(reflectance, 0.0, 1.0), np.where(eta == 1.0, 0.0, 1.0))


def fresnel_metal(base: np.ndarray, cos_incident: np.ndarray) -> np.ndarray:
    """Schlick's approximation, [n, 3]."""
    return base + (1.0 - base) * ((1.0 - np.clip(cos_incident, 0.0, 1.0)) ** 5)[:, None]


def ggx_albedo(f0: np.ndarray, roughness: np.ndarray, cos_view: np.ndarray) -> np.ndarray:
    """Share of light that a GGX lobe with Schlick's Fresnel term reflects: the rational fit of [MaterialX]."""
    x, y = cos_view, roughness * roughness
    terms = np.stack(np.broadcast_arrays(1.0, x, y, x * y, x * x, y * y, x * x * y, x * y * y, x * x * y * y))
    scale, offset, below_scale, below_offset = np.tensordot(ALBEDO_FIT, terms, axes=1)
    return np.clip(f0 * np.clip(scale / below_scale, 0.0, 1.0) + np.clip(offset / below_offset, 0.0, 1.0), 0.0, 1.0)


def dielectric_albedo(f0: np.ndarray, roughness: np.ndarray, cos_view: np.ndarray) -> np.ndarray:
    """As ggx_albedo; without an interface nothing is reflected, not even at grazing angles."""
    return np.where(f0 > 0.0, ggx_albedo(f0, roughness, cos_view), 0.0)


def ggx_density(cos_half: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Distribution of microfacet normals D(H) [Walter07, Eq. 33]."""
    c2, a2 = cos_half * cos_half, alpha * alpha
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(cos_half > 0.0, a2 / (np.pi * (1.0 + c2 * (a2 - 1.0)) ** 2), 0.0)


def ggx_lambda(cosine: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Smith's Lambda of GGX [Heitz14, Eq. 72]."""
    c2 = np.maximum(cosine * cosine, 1e-30)
    return (np.sqrt(1.0 + alpha * alpha * np.maximum(0.0, 1.0 - c2) / c2) - 1.0) / 2.0


def sample_visible_normal(view: np.ndarray, alpha: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Microfacet normal in the local frame, of density D_V: a point on a spherical cap [Dupuy23, Listing 1]."""
    stretch = np.stack([alpha, alpha, np.ones_like(alpha)], axis=1)
    standard = normalize(view * stretch)
    phi = 2.0 * np.pi * uv[:, 0]
    z = (1.0 - uv[:, 1]) * (1.0 + standard[:, 2]) - standard[:, 2]
    sine = np.sqrt(np.clip(1.0 - z * z, 0.0, 1.0))
    cap = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)
    return normalize((cap + standard) * stretch)


def reflect(view: np.ndarray, half: np.ndarray) -> np.ndarray:
    return 2.0 * dot(view, half)[:, None] * half - view


def refract(view: np.ndarray, half: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Transmitted direction [Walter07, Eq. 40] for half on the viewer's side. Where all is reflected: in the surface,
    unused."""
    cosine = dot(view, half)
    inside = np.sqrt(np.maximum(0.0, 1.0 - (1.0 - cosine * cosine) / (eta * eta)))
    return (cosine / eta - inside)[:, None] * half - view / eta[:, None]


def evaluate(bsdf: Bsdf, light: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diffuse and other lobes, times |cosine|, [n, 3] each, and the density [n] with which ``sample`` finds light.

    Smooth lobes have no part in any of the three.
    """
    cos_view, cos_light = dot(bsdf.normal, bsdf.view), dot(bsdf.normal, light)
    side = dot(bsdf.geometric_normal, light)
    above = (cos_light > 0.0) & (side > 0.0)
    below = (cos_light < 0.0) & (side < 0.0)

    diffuse = bsdf.diffuse_albedo * np.where(above, cos_light / np.pi, 0.0)[:, None]
    pdf = bsdf.diffuse_probability * np.where(above, cos_light / np.pi, 0.0)
    lambda_view, lambda_light = ggx_lambda(cos_view, bsdf.alpha), ggx_lambda(cos_light, bsdf.alpha)
    shadowing = 1.0 / (1.0 + lambda_view + lambda_light)  # height-correlated [Heitz14, Eq. 99]
    masking = 1.0 / (1.0 + lambda_view)

    # Reflection at microfacets: D G2 / (4 NV NL) times NL.
    half = normalize(bsdf.view + light)
    cos_half_view = dot(bsdf.view, half)
    spread = ggx_density(dot(bsdf.normal, half), bsdf.alpha) / (4.0 * cos_view)
    coat = bsdf.plastic * fresnel_dielectric(cos_half_view, bsdf.coat_eta)
    metal = bsdf.metal[:, None] * fresnel_metal(bsdf.base, cos_half_view)
    rough = above & ~bsdf.smooth
    specular = (coat[:, None] * bsdf.tint + metal) * np.where(rough, spread * shadowing, 0.0)[:, None]
    pdf = pdf + bsdf.specular_probability * np.where(rough, spread * masking, 0.0)
    rough = above & ~bsdf.smooth_glass
    reflected = fresnel_dielectric(cos_half_view, bsdf.glass_eta) * np.where(rough, spread, 0.0)
    specular = specular + (bsdf.glass * reflected * shadowing)[:, None]
    pdf = pdf + bsdf.glass_probability * reflected * masking

    # Refraction at microfacets [Walter07, Eq. 21] with the Jacobian of the half vector, Eq. 17.
    half = flip_towards(normalize(-(bsdf.view + bsdf.glass_eta[:, None] * light)), bsdf.normal)
    cos_half_view, cos_half_light = dot(bsdf.view, half), dot(light, half)
    rough = below & ~bsdf.smooth_glass & (cos_half_view > 0.0) & (cos_half_light < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        jacobian = bsdf.glass_eta**2 * np.abs(cos_half_light) / (cos_half_view + bsdf.glass_eta * cos_half_light) ** 2
        spread = ggx_density(dot(bsdf.normal, half), bsdf.alpha) * cos_half_view / cos_view * jacobian
    spread = np.where(rough, spread, 0.0)
    refracted = (1.0 - fresnel_dielectric(cos_half_view, bsdf.glass_eta)) * spread
    specular = specular + (bsdf.glass * refracted * shadowing)[:, None] * np.sqrt(bsdf.base)
    pdf = pdf + bsdf.glass_probability * refracted * masking
    return diffuse, specular, pdf


@dataclass
class BsdfSample:
    """direction: [n, 3] unit. diffuse, specular: [n, 3], lobe value times |cosine| over pdf. pdf: [n], 0 where delta.
    kind: [n], bit of RayVisibility of the ray that starts here.

    Both values are zero where the direction is on the wrong side of the surface, and where the material is black.
    """

    direction: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    pdf: np.ndarray
    delta: np.ndarray
    kind: np.ndarray


def sample(bsdf: Bsdf, uv: np.ndarray, lobe: np.ndarray) -> BsdfSample:
    """uv: [n, 2] and lobe: [n], uniform in [0, 1). lobe chooses D, S or G in this order; what is left of it chooses
    reflection or refraction in G."""
    first, second = bsdf.diffuse_probability, bsdf.diffuse_probability + bsdf.specular_probability
    choose_diffuse = lobe < first
    choose_specular = ~choose_diffuse & (lobe < second)
    choose_glass = ~choose_diffuse & ~choose_specular & (bsdf.glass_probability > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = (lobe - second) / bsdf.glass_probability

    rough_half = to_world(sample_visible_normal(to_local(bsdf.view, bsdf.normal), bsdf.alpha, uv), bsdf.normal)
    mirror = np.where(choose_glass, bsdf.smooth_glass, bsdf.smooth)
    half = np.where(mirror[:, None], bsdf.normal, rough_half)
    cos_half = dot(bsdf.view, half)
    reflectance = fresnel_dielectric(cos_half, bsdf.glass_eta)
    choose_refraction = choose_glass & ~(rest < reflectance)

    light = np.where(choose_refraction[:, None], refract(bsdf.view, half, bsdf.glass_eta), reflect(bsdf.view, half))
    light = np.where((choose_refraction & (bsdf.glass_eta == 1.0))[:, None], -bsdf.view, light)
    light = np.where(choose_diffuse[:, None], to_world(cosine_hemisphere(uv), bsdf.normal), light)
    light = normalize(light)

    # A microfacet can reflect below the horizon or refract above it. Such a direction is lost: the densities of the
    # other kind of event, which do reach it, do not count this one.
    cos_light, side = dot(bsdf.normal, light), dot(bsdf.geometric_normal, light)
    passes = np.where(choose_refraction, (cos_light < 0.0) & (side < 0.0), (cos_light > 0.0) & (side > 0.0))
    passes &= choose_diffuse | choose_specular | choose_glass

    diffuse, specular, pdf = evaluate(bsdf, light)
    delta = ~choose_diffuse & mirror
    found = passes & (pdf > 0.0) & ~delta
    with np.errstate(divide="ignore", invalid="ignore"):
        diffuse = np.where(found[:, None], diffuse / pdf[:, None], 0.0)
        specular = np.where(found[:, None], specular / pdf[:, None], 0.0)

        # A mirror lobe: its weight over the probability of choosing it, which contains glass's choice by reflectance.
        coat = bsdf.plastic * fresnel_dielectric(cos_half, bsdf.coat_eta)
        coat_and_metal = coat[:, None] * bsdf.tint + bsdf.metal[:, None] * fresnel_metal(bsdf.base, cos_half)
        through = np.where(choose_refraction[:, None], np.sqrt(bsdf.base), 1.0)
        glass = (bsdf.glass / bsdf.glass_probability)[:, None] * through
        weight = np.where(choose_glass[:, None], glass, coat_and_metal / bsdf.specular_probability[:, None])
    specular = np.where((passes & delta)[:, None], weight, specular)
    reflected = np.where(choose_diffuse, int(RayVisibility.DIFFUSE), int(RayVisibility.GLOSSY))
    kind = np.where(choose_refraction, int(RayVisibility.TRANSMISSION), reflected)
    return BsdfSample(light, diffuse, specular, np.where(delta | ~found, 0.0, pdf), delta, kind)
