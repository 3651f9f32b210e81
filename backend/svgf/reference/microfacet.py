# SPDX-License-Identifier: Apache-2.0
"""Fresnel terms, the GGX distribution, and what of its losses comes back. Arrays have one row per ray."""

from __future__ import annotations

import numpy as np

from .albedo import ior_coordinate, lookup
from .vec import dot, normalize

LARGEST_F0 = 0.99


def normal_reflectance(ior: np.ndarray) -> np.ndarray:
    """Reflectance of a dielectric at normal incidence, F(1)."""
    return ((ior - 1.0) / (ior + 1.0)) ** 2


def interface(ior: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance at normal incidence and IOR of plastic's interface: the level scales the former."""
    f0 = normal_reflectance(ior) * 2.0 * level
    root = np.sqrt(np.minimum(f0, LARGEST_F0))
    eta = (1.0 + root) / (1.0 - root)
    return f0, np.where(level == 0.5, ior, np.where(ior < 1.0, 1.0 / eta, eta))


def dielectric_mean(eta: np.ndarray) -> np.ndarray:
    """Mean Fresnel reflectance over the hemisphere, 2 int c F(c) dc: the fit of [Kulla17]."""
    inner = 0.997118 + eta * (0.1014 - eta * (0.965241 + eta * 0.130607))
    return np.where(eta < 1.0, inner, (eta - 1.0) / (4.08567 + 1.00071 * eta))


def multiscatter_factor(
    roughness: np.ndarray, cosine: np.ndarray, mean: np.ndarray, wanted: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Energy [n] of a reflecting lobe, and the factor on it for light that comes out after several reflections. mean:
    [n] or [n, 3], mean Fresnel reflectance of each [Kulla17]."""
    energy = lookup("energy", roughness, cosine)
    factor = _given_back(energy, lookup("mean_energy", roughness), mean)
    return energy, np.where(_like(wanted, factor) > 0.0, factor, 1.0)


def _like(values: np.ndarray | float, array: np.ndarray) -> np.ndarray:
    return np.reshape(values, np.shape(values) + (1,) * (array.ndim - 1)) if np.ndim(values) else np.asarray(values)


def _given_back(energy: np.ndarray, mean_energy: np.ndarray, mean: np.ndarray) -> np.ndarray:
    energy, mean_energy = _like(energy, mean), _like(mean_energy, mean)
    multiple = mean * mean_energy / (1.0 - mean * (1.0 - mean_energy))
    return 1.0 + multiple * (1.0 - energy) / energy


def glass_multiscatter_factor(
    roughness: np.ndarray, cosine: np.ndarray, eta: np.ndarray, tint: np.ndarray, wanted: np.ndarray
) -> np.ndarray:
    """As multiscatter_factor, [n, 3], of reflection and refraction together; tint: of what is refracted."""
    entering = eta >= 1.0
    z = ior_coordinate(eta)
    energy, mean_energy = (
        np.where(
            entering,
            lookup(f"{name}_entering", roughness, cosine, z),
            lookup(f"{name}_leaving", roughness, cosine, z),
        )
        for name in ("glass", "mean_glass")
    )
    factor = _given_back(energy, mean_energy, tint)
    return np.where(((wanted > 0.0) & (eta != 1.0))[:, None], factor, 1.0)


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


def fresnel_tinted(cos_incident: np.ndarray, eta: np.ndarray, f0: np.ndarray) -> np.ndarray:
    """A dielectric's reflectance with its range [F(1), 1] mapped to [f0, 1], [n, 3]."""
    real_f0 = normal_reflectance(eta)
    share = np.clip((fresnel_dielectric(cos_incident, eta) - real_f0) / (1.0 - real_f0), 0.0, 1.0)
    return f0 + (1.0 - f0) * share[:, None]


def fresnel_metal(f0: np.ndarray, f90: np.ndarray, dip: np.ndarray, cos_incident: np.ndarray) -> np.ndarray:
    """Schlick's approximation with the dip around 82 degrees of [Kutz21], [n, 3]."""
    c = np.clip(cos_incident, 0.0, 1.0)[:, None]
    return np.clip(f0 + (f90 - f0) * (1.0 - c) ** 5 - dip * c * (1.0 - c) ** 6, 0.0, 1.0)


def ggx_density(half: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Distribution of microfacet normals D(H), local [n, 3]; alpha [n, 2] [Heitz14, Eq. 85]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        stretched = (half[:, 0] / alpha[:, 0]) ** 2 + (half[:, 1] / alpha[:, 1]) ** 2 + half[:, 2] ** 2
        return np.where(half[:, 2] > 0.0, 1.0 / (np.pi * alpha.prod(axis=1) * stretched**2), 0.0)


def ggx_lambda(direction: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Smith's Lambda of GGX for local directions [Heitz14, Eq. 72]."""
    slope = (alpha[:, 0] * direction[:, 0]) ** 2 + (alpha[:, 1] * direction[:, 1]) ** 2
    return (np.sqrt(1.0 + slope / np.maximum(direction[:, 2] ** 2, 1e-30)) - 1.0) / 2.0


def sample_visible_normal(view: np.ndarray, alpha: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Microfacet normal in the local frame, of density D_V: a point on a spherical cap [Dupuy23, Listing 1]."""
    stretch = np.concatenate([alpha, np.ones((len(alpha), 1))], axis=1)
    standard = normalize(view * stretch)
    phi = 2.0 * np.pi * uv[:, 0]
    z = (1.0 - uv[:, 1]) * (1.0 + standard[:, 2]) - standard[:, 2]
    sine = np.sqrt(np.clip(1.0 - z * z, 0.0, 1.0))
    cap = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)
    return normalize((cap + standard) * stretch)


def reflect(view: np.ndarray, half: np.ndarray) -> np.ndarray:
    """The mirrored direction [n, 3]."""
    return 2.0 * dot(view, half)[:, None] * half - view


def refract(view: np.ndarray, half: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Transmitted direction [Walter07, Eq. 40] for half on the viewer's side. Where all is reflected: in the surface,
    unused."""
    cosine = dot(view, half)
    inside = np.sqrt(np.maximum(0.0, 1.0 - (1.0 - cosine * cosine) / (eta * eta)))
    return (cosine / eta - inside)[:, None] * half - view / eta[:, None]
