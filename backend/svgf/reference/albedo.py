# SPDX-License-Identifier: Apache-2.0
"""The tables of svgf.albedo: their derivation, and lookups.

``python -m svgf.reference.albedo`` computes all but "sheen" by quadrature over visible normals, in minutes of which
most go to the glass, and writes ``svgf/albedo_tables.npy``.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..albedo import FILE, SHAPES, albedo_tables

@cache
def tables() -> dict[str, np.ndarray]:
    """float64 arrays of SHAPES."""
    flat = albedo_tables().astype(np.float64)
    result, start = {}, 0
    for name, shape in SHAPES.items():
        result[name] = flat[start : start + np.prod(shape)].reshape(shape)
        start += np.prod(shape)
    return result


def lookup(
    name: str, roughness: np.ndarray, cosine: np.ndarray | float = 0.0, z: np.ndarray | float = 0.0
) -> np.ndarray:
    """Trilinear, [n]."""
    table = tables()[name]
    result = 0.0
    axes = []
    for value, size in zip((z, cosine, roughness), table.shape):
        x = np.clip(value, 0.0, 1.0) * (size - 1)
        low = np.minimum(np.floor(x).astype(int), max(size - 2, 0))
        axes.append(((low, 1.0 - (x - low)), (np.minimum(low + 1, size - 1), x - low)))
    for k, weight_k in axes[0]:
        for j, weight_j in axes[1]:
            for i, weight_i in axes[2]:
                result = result + weight_k * weight_j * weight_i * table[k, j, i]
    return result


def ior_coordinate(ior: np.ndarray) -> np.ndarray:
    return np.sqrt(np.abs((ior - 1.0) / (ior + 1.0)))


def dielectric_share(roughness: np.ndarray, cosine: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """s [n], where the mean reflectance of a rough dielectric, its range [F(1), 1] mapped to [f0, 1], is f0 + (1 - f0)
    s."""
    z = ior_coordinate(eta)
    leaving = lookup("dielectric_leaving", roughness, critical_angle_coordinate(cosine, np.minimum(eta, 1.0)), z)
    return np.where(eta < 1.0, leaving, lookup("dielectric", roughness, cosine, z))


def critical_angle_coordinate(cosine: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """The cosine with the critical angle of eta <= 1 at 0.5, and fine steps around it."""
    critical = np.sqrt(1.0 - eta**2)
    beyond = np.clip(cosine, 0.0, 1.0) - critical
    root = np.sqrt(np.abs(beyond) / np.maximum(np.where(beyond < 0.0, critical, 1.0 - critical), 1e-6))
    return 0.5 + 0.5 * np.copysign(root, beyond)


def critical_angle_cosine(coordinate: float, eta: float) -> float:
    """Inverse of critical_angle_coordinate."""
    critical = np.sqrt(1.0 - eta**2)
    side = 2.0 * coordinate - 1.0
    return critical + (1.0 - critical if side > 0.0 else -critical) * side**2


# What follows computes the tables.


def _visible_weights(roughness: float, cosine: float, count: int) -> tuple[np.ndarray, ...]:
    """Microfacet normals of equal chance as seen from the cosine: view, normals [n, 3], and Smith's Lambda of the
    view."""
    from .microfacet import ggx_lambda, sample_visible_normal

    alpha = max(roughness, 1e-3) ** 2
    cosine = max(cosine, 1e-4)
    steps = (np.arange(count) + 0.5) / count
    uv = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    view = np.tile([np.sqrt(1.0 - cosine**2), 0.0, cosine], (len(uv), 1))
    alphas = np.full((len(uv), 2), alpha)
    return view, sample_visible_normal(view, alphas, uv), ggx_lambda(view, alphas), alphas


def energy_at(roughness: float, cosine: float, count: int = 128) -> float:
    """Mean of G2 / G1 over the visible normals that reflect upwards."""
    from .microfacet import ggx_lambda, reflect

    view, half, lambda_view, alphas = _visible_weights(roughness, cosine, count)
    light = reflect(view, half)
    weight = (1.0 + lambda_view) / (1.0 + lambda_view + ggx_lambda(light, alphas))
    return float(np.where(light[:, 2] > 0.0, weight, 0.0).mean())


def mean_at(roughness: float, cosine: float, share, count: int = 96) -> float:
    """Mean over the lobe of a function of the cosine at the microfacet."""
    from .microfacet import ggx_lambda, reflect

    view, half, lambda_view, alphas = _visible_weights(roughness, cosine, count)
    light = reflect(view, half)
    weight = np.where(light[:, 2] > 0.0, (1.0 + lambda_view) / (1.0 + lambda_view + ggx_lambda(light, alphas)), 0.0)
    return float((weight * share(np.sum(view * half, axis=1))).sum() / weight.sum())


def schlick_at(roughness: float, cosine: float, count: int = 96) -> float:
    return mean_at(roughness, cosine, lambda c: (1.0 - np.clip(c, 0.0, 1.0)) ** 5, count)


def dielectric_at(roughness: float, cosine: float, ior: float, count: int = 96) -> float:
    from .microfacet import fresnel_dielectric, normal_reflectance

    f0 = normal_reflectance(ior)
    # Seen at an angle, a dense dielectric may reflect less than f0.
    return mean_at(
        roughness,
        cosine,
        lambda c: np.clip((fresnel_dielectric(c, np.full(len(c), ior)) - f0) / (1.0 - f0), 0.0, 1.0),
        count,
    )


def glass_at(roughness: float, cosine: float, eta: float, count: int = 96) -> float:
    from .microfacet import fresnel_dielectric, ggx_lambda, reflect, refract

    if eta == 1.0:
        return 1.0  # no interface, which goes straight on
    view, half, lambda_view, alphas = _visible_weights(roughness, cosine, count)
    etas = np.full(len(view), eta)
    reflectance = fresnel_dielectric(np.sum(view * half, axis=1), etas)
    total = 0.0
    for light, share, side in (
        (reflect(view, half), reflectance, 1.0),
        (refract(view, half, etas), 1.0 - reflectance, -1.0),
    ):
        weight = (1.0 + lambda_view) / (1.0 + lambda_view + ggx_lambda(light, alphas))
        total += np.where(light[:, 2] * side > 0.0, share * weight, 0.0).mean()
    return float(total)


def _mean_over_cosines(table: np.ndarray, at) -> np.ndarray:
    """[z, 1, x]: 2 int cosine f(cosine) by Gauss' rule in cosine."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    cosines, weights = (nodes + 1.0) / 2.0, weights / 2.0
    result = np.zeros((table.shape[0], 1, table.shape[2]))
    for k in range(table.shape[0]):
        for i in range(table.shape[2]):
            values = [at(i / (table.shape[2] - 1), cosine, k) for cosine in cosines]
            result[k, 0, i] = 2.0 * np.sum(weights * cosines * values)
    return result


def compute() -> np.ndarray:
    """All tables one after the other, float32."""
    iors = [(1.0 + z**2) / (1.0 - z**2) for z in np.minimum(np.arange(16) / 15.0, 0.99)]
    at = {
        "energy": lambda x, y, k: energy_at(x, y),
        "schlick": lambda x, y, k: schlick_at(x, y),
        "dielectric": lambda x, y, k: dielectric_at(x, y, iors[k]),
        "dielectric_leaving": lambda x, y, k: dielectric_at(x, critical_angle_cosine(y, 1.0 / iors[k]), 1.0 / iors[k]),
        "glass_entering": lambda x, y, k: glass_at(x, y, iors[k]),
        "glass_leaving": lambda x, y, k: glass_at(x, y, 1.0 / iors[k]),
    }
    result = {}
    for name, (depth, rows, columns) in SHAPES.items():
        if name == "sheen":
            result[name] = tables()[name]
        elif name in at:
            result[name] = np.array(
                [
                    [[at[name](i / (columns - 1), j / (rows - 1), k) for i in range(columns)] for j in range(rows)]
                    for k in range(depth)
                ]
            )
        else:
            result[name] = _mean_over_cosines(np.empty(SHAPES[name]), at[name.removeprefix("mean_")])
    return np.concatenate([result[name].ravel() for name in SHAPES]).astype(np.float32)


if __name__ == "__main__":
    np.save(FILE, compute())
