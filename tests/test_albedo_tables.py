# SPDX-License-Identifier: Apache-2.0
"""The tables of albedos against quadrature of their definitions, at entries and between them."""

import numpy as np
import pytest

from svgf.albedo import SHAPES, albedo_tables
from svgf.reference.albedo import (
    dielectric_at,
    dielectric_share,
    energy_at,
    glass_at,
    ior_coordinate,
    lookup,
    schlick_at,
    tables,
)

POINTS = [(0.1, 0.9), (0.3, 0.5), (0.55, 0.35), (0.8, 0.2), (1.0, 1.0), (0.9, 0.7)]


def test_shares_lie_between_0_and_1():
    table = albedo_tables()
    assert table.dtype == np.float32 and table.size == sum(np.prod(shape) for shape in SHAPES.values())
    assert np.isfinite(table).all() and table.min() >= -1e-6 and table.max() <= 1 + 1e-6
    with pytest.raises(ValueError, match="read-only"):
        table[0] = 0


@pytest.mark.parametrize("roughness, cosine", POINTS)
@pytest.mark.parametrize("name", ["energy", "schlick", "dielectric", "glass_entering", "glass_leaving"])
def test_lookups_against_their_definitions(name, roughness, cosine):
    ior = 1.45
    exact = {
        "energy": lambda: energy_at(roughness, cosine, 400),
        "schlick": lambda: schlick_at(roughness, cosine, 400),
        "dielectric": lambda: dielectric_at(roughness, cosine, ior, 400),
        "glass_entering": lambda: glass_at(roughness, cosine, ior, 400),
        "glass_leaving": lambda: glass_at(roughness, cosine, 1 / ior, 400),
    }[name]()
    z = np.array([ior_coordinate(ior)]) if SHAPES[name][0] > 1 else 0.0
    assert lookup(name, np.array([roughness]), np.array([cosine]), z)[0] == pytest.approx(exact, abs=0.006)


@pytest.mark.parametrize("roughness, cosine", [*POINTS, (0.14, 0.91), (0.2, 0.97), (0.08, 0.7)])
@pytest.mark.parametrize("ior", [1.1, 1.45, 2.8])
def test_rough_total_reflection_against_its_definition(roughness, cosine, ior):
    """The edge at the critical angle is sharp where roughness is low; what is left is the table's step along IOR."""
    found = dielectric_share(np.array([roughness]), np.array([cosine]), np.array([1 / ior]))[0]
    assert found == pytest.approx(dielectric_at(roughness, cosine, 1 / ior, 200), abs=0.02)


@pytest.mark.parametrize("name", ["energy", "glass_entering", "glass_leaving"])
def test_means_are_those_of_the_tables(name):
    """2 int c f(c) dc, by the trapezoid rule over the table's own cosines."""
    table, mean = tables()[name], tables()[f"mean_{name}"]
    fine = np.linspace(0, 1, 401)
    cosines = np.linspace(0, 1, table.shape[1])
    values = np.array([[np.interp(fine, cosines, row) for row in plane.T] for plane in table])
    expected = 2 * np.trapezoid(values * fine, fine, axis=2) if hasattr(np, "trapezoid") else (
        2 * np.trapz(values * fine, fine, axis=2)
    )
    np.testing.assert_allclose(mean[:, 0], expected, atol=0.01)


def test_sheen_grows_with_roughness_and_towards_the_horizon():
    table = tables()["sheen"][0]
    assert (np.diff(table[1:, 3:], axis=0) <= 1e-3).all()
    assert (np.diff(table[16:, 3:], axis=1) >= -1e-3).all()
