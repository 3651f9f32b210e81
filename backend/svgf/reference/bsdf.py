# SPDX-License-Identifier: Apache-2.0
"""The materials as Cycles defines them, as a sum of five lobes.

D, diffuse: Lambert or Oren-Nayar, in reflection, or in transmission for TRANSLUCENT. H, sheen: a linearly transformed
cosine. S, specular: GGX reflection, of the interface of plastic and of metal. C, coat: GGX reflection of its own
roughness. G, glass: GGX reflection and refraction.

Sheen, coat and interface lie on each other in this order; each takes its albedo away from what lies below. Of light
that GGX loses between microfacets, each lobe is given back what Fresnel's term leaves of it, as a factor [Kulla17].

All arrays have one row per ray. V is the direction to the viewer, L the sampled one; both point away from the surface.
Local directions are in a frame whose Z is the shading normal N and whose X is the tangent. What lies on the wrong side
of the geometric normal Ng is black, of light that is aimed at on the wrong side as shadow_terminator.py knows it. Under
a normal map D and H have the map's normal, of which S and G take what keeps their reflections above the surface, and C
the smooth one unless told otherwise: such lobes are tilted.

bsdf_lobes makes the lobes of a material, bsdf_evaluate gives their value for a direction, bsdf_sample chooses one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from .microfacet import fresnel_dielectric, fresnel_metal, fresnel_tinted
from .sampling import frame
from .vec import dot

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
        """N: [n, 3], unit, world, on the viewer's side."""
        return self.z

    @property
    def smooth(self) -> np.ndarray:
        """bool [n]: lobe S is a mirror."""
        return self.alpha.max(axis=1) < SMOOTH_ALPHA

    @property
    def smooth_coat(self) -> np.ndarray:
        """bool [n]: lobe C is a mirror."""
        return self.coat_alpha < SMOOTH_ALPHA

    @property
    def smooth_glass(self) -> np.ndarray:
        """bool [n]: lobe G is a mirror, or there is no interface and it goes straight on."""
        return (self.glass_alpha < SMOOTH_ALPHA) | (self.glass_eta == 1.0)

    def to_local(self, vector: np.ndarray) -> np.ndarray:
        """World vectors [n, 3] in the local frame."""
        return np.stack([dot(vector, axis) for axis in (self.x, self.y, self.z)], axis=1)

    def to_world(self, local: np.ndarray) -> np.ndarray:
        """Local vectors [n, 3] in the world."""
        return local[:, 0:1] * self.x + local[:, 1:2] * self.y + local[:, 2:3] * self.z

    def rows(self, chosen: np.ndarray) -> Bsdf:
        """Those of some hits. chosen: an index, or bool [n]."""
        return Bsdf(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


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
    """Fresnel's term of lobe C with its weight, [n]."""
    return bsdf.coat * fresnel_dielectric(cos_half_view, bsdf.coat_eta)


def lobe_alpha(alpha: np.ndarray) -> np.ndarray:
    """GGX alpha along X and Y, [n, 2], of a lobe that is not anisotropic."""
    return np.repeat(alpha[:, None], 2, axis=1)


def to_lobe(bsdf: Bsdf, vector: np.ndarray, normal: np.ndarray, tilted: np.ndarray) -> np.ndarray:
    """World vectors [n, 3] in the local frame of a lobe, whose normal is not N where it is tilted."""
    x, y = frame(normal)
    own = np.stack([dot(vector, axis) for axis in (x, y, normal)], axis=1)
    return np.where(tilted[:, None], own, bsdf.to_local(vector))


def from_lobe(bsdf: Bsdf, local: np.ndarray, normal: np.ndarray, tilted: np.ndarray) -> np.ndarray:
    """The inverse of to_lobe."""
    x, y = frame(normal)
    own = local[:, 0:1] * x + local[:, 1:2] * y + local[:, 2:3] * normal
    return np.where(tilted[:, None], own, bsdf.to_world(local))


def turned(vector: np.ndarray, view: np.ndarray, back: bool = False) -> np.ndarray:
    """Local vectors in the frame whose X is the view's azimuth, or back from there."""
    length = np.hypot(view[:, 0], view[:, 1])
    there = length > 1e-8
    cosine = np.where(there, view[:, 0] / np.where(there, length, 1.0), 1.0)
    sine = np.where(there, view[:, 1] / np.where(there, length, 1.0), 0.0) * (-1.0 if back else 1.0)
    x, y, z = vector.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
