# SPDX-License-Identifier: Apache-2.0
"""The choice of a lobe of a material and of a direction within it, and where the surface is smooth the one direction
that counts; see bsdf.py."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .bsdf import (
    DIFFUSE,
    GLOSSY,
    NONE,
    TRANSMISSION,
    Bsdf,
    coat_at,
    from_lobe,
    glass_events,
    lobe_alpha,
    specular_at,
    to_lobe,
    turned,
)
from .bsdf_evaluate import evaluate
from .microfacet import reflect, refract, sample_visible_normal
from .sampling import cosine_hemisphere
from .vec import dot, luminance, normalize


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
    view = to_lobe(bsdf, bsdf.view, lobe_normal, tilted)
    alpha = np.where(of_coat[:, None], lobe_alpha(bsdf.coat_alpha), bsdf.alpha)
    alpha = np.where(of_glass[:, None], lobe_alpha(bsdf.glass_alpha), alpha)
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
    light = np.where(of_sheen[:, None], _sample_sheen(bsdf, view, uv), light)
    cos_light = light[:, 2]
    light = normalize(from_lobe(bsdf, light, lobe_normal, tilted))

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


def _sample_sheen(bsdf: Bsdf, view: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Local direction: a cosine-distributed one through the inverse of the transform."""
    x, y, z = cosine_hemisphere(uv).T
    a, b = bsdf.sheen_a, bsdf.sheen_b
    return turned(normalize(np.stack([x - b * z, y, a * z], axis=1)), view, back=True)


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


def find_smooth_bounce(bsdf: Bsdf) -> SmoothBounce:
    """Where the mirrored or the refracted direction carries more than all the rest of the surface, that direction."""
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
