# SPDX-License-Identifier: Apache-2.0
"""The reference's BSDF against what any BSDF must obey, and against the closed forms that there are."""

import dataclasses

import numpy as np
import pytest

from svgf.reference import bsdf as reference
from svgf.reference.bsdf import Bsdf
from svgf.reference.bsdf_evaluate import evaluate
from svgf.reference.bsdf_sample import BsdfSample
from svgf.reference.bsdf_sample import sample as sample_bsdf
from svgf.reference.microfacet import fresnel_dielectric, fresnel_metal, ggx_density, ggx_lambda
from svgf.reference.sampling import cosine_hemisphere
from svgf.reference.shading_normal import make_reflection_valid
from svgf.scene import Material, MaterialKind, TextureMap

from .bsdf_cases import make, repeat, sphere_grid
from .material_cases import SINGLE, smooth
from .scenes import GLASS, GLOSSY, METAL, MIRROR, ROUGH_GLASS, WHITE
from .statistical import assert_histogram, assert_mean

COAT = Material("coat", base_color=(0.8, 0.5, 0.2), roughness=0.5)
MIXED = Material("mixed", base_color=(0.6, 0.5, 0.4), metallic=0.3, transmission=0.4, roughness=0.6, ior=1.3)
TINTED = Material("tinted", roughness=0.7, specular_ior_level=1.0, specular_tint=(1.0, 0.6, 0.2), ior=1.8)
ROUGH_METAL = dataclasses.replace(METAL, roughness=0.8)
ROUGH = [WHITE, COAT, GLOSSY, METAL, ROUGH_METAL, ROUGH_GLASS, MIXED, TINTED, *SINGLE]
SMOOTH = [
    MIRROR, GLASS, dataclasses.replace(COAT, roughness=0.0), dataclasses.replace(MIXED, roughness=0.01),
    *(smooth(material) for material in SINGLE if material.name in ("all", "tinted coat", "refraction", "thin glass")),
]  # fmt: skip
BUMPY = dataclasses.replace(
    COAT, coat_weight=1.0, coat_roughness=0.3, metallic=0.3, sheen_weight=0.2, maps={"normal": TextureMap(0)}
)
ERROR_RATE = 1e-5  # of each of a few hundred tests
SEEN_THROUGH = (MaterialKind.GLASS, MaterialKind.REFRACTION, MaterialKind.TRANSLUCENT)
# Material, angle of the viewer in degrees, and whether from outside: what nothing passes is the same from inside.
VIEWS = [
    pytest.param(material, degrees, outside, id=f"{material.name}_{material.roughness}-{degrees}-{outside}")
    for material in ROUGH
    for degrees, outside in ((0.0, True), (45.0, True), (80.0, True), (45.0, False), (80.0, False))
    if outside or material.transmission > 0.0 or material.kind in SEEN_THROUGH
]


def names(materials) -> list[str]:
    return [f"{material.name}_{material.roughness}" for material in materials]


def direction(degrees: float, turn: float = 0.3) -> np.ndarray:
    theta = np.radians(degrees)
    return np.array([[np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)]])


def draw(bsdf: Bsdf, count: int, seed: int = 0) -> BsdfSample:
    rng = np.random.default_rng(seed)
    return sample_bsdf(repeat(bsdf, count), rng.random((count, 2)), rng.random(count))


def on_both_sides(test):
    """Views from outside (entering) and inside (leaving)."""
    return pytest.mark.parametrize("outside", [True, False], ids=["outside", "inside"])(test)


def seen(degrees: float, outside: bool) -> np.ndarray:
    return direction(degrees) if outside else -direction(degrees)


@pytest.mark.parametrize(("material", "degrees", "outside"), VIEWS)
def test_directions_follow_their_density(material, degrees, outside):
    assert_density(make(material, seen(degrees, outside)))


def assert_density(bsdf: Bsdf) -> None:
    count, rows, columns, fine = 40_000, 24, 24, 20
    sample = draw(bsdf, count)
    found = sample.pdf > 0
    light = sample.direction[found]
    row_index = np.minimum((np.arccos(np.clip(light[:, 2], -1, 1)) / np.pi * rows).astype(int), rows - 1)
    column_index = (np.arctan2(light[:, 1], light[:, 0]) % (2 * np.pi) / (2 * np.pi) * columns).astype(int) % columns
    counts = np.bincount(row_index * columns + column_index, minlength=rows * columns)

    directions, solid_angle = sphere_grid(rows * fine, columns * fine)
    pdf = evaluate(repeat(bsdf, len(directions)), directions)[2]
    expected = count * (solid_angle * pdf).reshape(rows, fine, columns, fine).sum(axis=(1, 3))

    # What is not found fell below the horizon: the density misses just that share.
    assert_histogram(np.append(counts, count - found.sum()), np.append(expected, count - expected.sum()), ERROR_RATE)


@pytest.mark.parametrize(("material", "degrees", "outside"), VIEWS)
def test_sampling_gives_the_integral(material, degrees, outside):
    """Means of the weights against quadrature of the values, so neither value nor density can be off by a factor."""
    assert_integral(make(material, seen(degrees, outside)))


def assert_integral(bsdf: Bsdf) -> None:
    sample = draw(bsdf, 40_000, seed=1)
    directions, solid_angle = sphere_grid(500, 500)
    diffuse, specular, _ = evaluate(repeat(bsdf, len(directions)), directions)
    for channel in range(3):
        values = (diffuse + specular)[:, channel]
        assert_mean((sample.diffuse + sample.specular)[:, channel], values @ solid_angle, ERROR_RATE, rounding=2e-3)


@pytest.mark.parametrize("degrees", [0.0, 45.0, 80.0])
def test_smooth_coat_over_a_normal_map(degrees):
    """A lobe of a normal of its own, 30 degrees from that of the others."""
    bsdf = make(BUMPY, direction(degrees), normal=(0.5, 0, np.sqrt(0.75)), smooth_normal=np.array([[0.0, 0.0, 1.0]]))
    assert bsdf.tilted_coat.all() and (bsdf.coat_normal != bsdf.normal).any()
    assert_density(bsdf)
    assert_integral(bsdf)
    mapped = dataclasses.replace(BUMPY, coat_normal_mapped=True)
    follows = make(mapped, direction(degrees), normal=bsdf.normal[0], smooth_normal=np.array([[0.0, 0.0, 1.0]]))
    assert not follows.tilted_coat.any() and (follows.coat_normal == follows.normal).all()


def test_lambert_density_is_whole():
    directions, solid_angle = sphere_grid(400, 4)
    bsdf = make(WHITE, direction(60))
    diffuse, specular, pdf = evaluate(repeat(bsdf, len(directions)), directions)
    assert pdf @ solid_angle == pytest.approx(1, abs=1e-4)
    assert diffuse[:, 0] @ solid_angle == pytest.approx(0.8, abs=1e-4)
    assert not specular.any()
    sample = draw(bsdf, 1000)
    np.testing.assert_allclose(sample.diffuse, 0.8, rtol=1e-12)


def white(**changes) -> Material:
    """A material that should reflect all light. changes: what makes it so of others than metal."""
    return Material(base_color=(1.0, 1.0, 1.0), **changes)


# What the compensation of multiple scattering makes whole. Cycles' model of glass without the compensation of Fresnel's
# term is exact for white alone.
WHOLE = {
    "diffuse": white(specular_ior_level=0.0),
    "metal": white(metallic=1.0),
    "glossy": white(kind=MaterialKind.GLOSSY),
    "glass": white(kind=MaterialKind.GLASS),
    "dense glass": white(kind=MaterialKind.GLASS, ior=2.2),
    "principled glass": white(transmission=1.0),
    "half metal": white(metallic=0.5, transmission=1.0),
}


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("name", WHOLE)
@on_both_sides
def test_white_furnace(name, roughness, outside):
    """In a uniformly lit world a white surface cannot be seen: within 0.5 %, up to 80 degrees."""
    material = dataclasses.replace(WHOLE[name], roughness=roughness)
    for degrees in (0.0, 30.0, 60.0, 75.0, 80.0):
        sample = draw(make(material, seen(degrees, outside)), 40_000, seed=2)
        total = (sample.diffuse + sample.specular)[:, 0]
        assert np.isfinite(total).all() and total.min() >= 0
        assert_mean(total, 1.0, ERROR_RATE, rounding=5e-3)


def whitened(material: Material) -> Material:
    return dataclasses.replace(
        material, base_color=(1.0, 1.0, 1.0), specular_tint=(1.0, 1.0, 1.0), coat_tint=(1.0,) * 3, sheen_tint=(1.0,) * 3
    )


@pytest.mark.parametrize("material", ROUGH + SMOOTH, ids=names(ROUGH + SMOOTH))
def test_white_surfaces_do_not_make_light(material):
    """Mean over all views, as light between many surfaces comes in. Cycles' layers are exact at none but their own
    entries of the tables."""
    rng = np.random.default_rng(11)
    count = 40_000
    view = cosine_hemisphere(rng.random((count, 2)))
    sample = sample_bsdf(make(whitened(material), view), rng.random((count, 2)), rng.random(count))
    total = (sample.diffuse + sample.specular)[:, 0]
    assert total.mean() <= 1.005 + 4 * total.std() / np.sqrt(count)


@pytest.mark.parametrize("material", ROUGH + SMOOTH, ids=names(ROUGH + SMOOTH))
@pytest.mark.parametrize("degrees", [0.0, 40.0, 70.0])
def test_albedos_are_what_the_lobes_reflect(material, degrees):
    bsdf = make(material, direction(degrees))
    sample = draw(bsdf, 20_000, seed=3)
    for channel in range(3):
        assert_mean(sample.diffuse[:, channel], bsdf.diffuse_albedo[0, channel], ERROR_RATE, rounding=0.01)
    difference = np.abs(sample.specular.mean(axis=0) - bsdf.specular_albedo[0])
    assert (difference < ALBEDO_ERROR.get(material.name, 0.02)).all()
    assert (bsdf.diffuse_albedo >= 0).all()


# Albedos of which demodulation only needs the scale: the dip of a tinted metal, glass from the denser side, and what is
# lost between microfacets, which of anisotropic lobes Cycles takes from the table of isotropic ones.
ALBEDO_ERROR = {
    "tinted metal": 0.1,
    "thin glass": 0.12,
    "single scattering": 0.4,
    "refraction": 0.3,
    "brushed": 0.1,
    "long glossy": 0.2,
    "wide glossy": 0.2,
    "all": 0.05,
}


def above(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2]) + 0.05
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def value(material: Material, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    diffuse, specular, _ = evaluate(make(material, view), light)
    return (diffuse + specular) / np.abs(light[:, 2:3])


@pytest.mark.parametrize("material", [WHITE, METAL, ROUGH_METAL, ROUGH_GLASS], ids=lambda m: f"{m.name}_{m.roughness}")
def test_reflection_is_reciprocal(material):
    """But for multiple scattering, which by Cycles' rules is a factor that depends on the view alone."""
    material = dataclasses.replace(material, multiscatter=False)
    view, light = above(1000, 4), above(1000, 5)
    np.testing.assert_allclose(value(material, view, light), value(material, light, view), rtol=1e-9)


def test_refraction_is_reciprocal_but_for_the_solid_angle():
    """f(V, L) / eta_L^2 = f(L, V) / eta_V^2 [Walter07, Section 5.3]."""
    view, light = above(1000, 6), -above(1000, 7)
    glass = dataclasses.replace(ROUGH_GLASS, multiscatter=False)
    forth = value(glass, view, light) / glass.ior**2
    back = value(glass, light, view)
    assert (forth > 0).any()
    np.testing.assert_allclose(forth, back, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 41.0])
@on_both_sides
def test_smooth_refraction_obeys_snell(degrees, outside):
    clear = dataclasses.replace(GLASS, base_color=(1.0, 1.0, 1.0))
    view = seen(degrees, outside)
    sample = draw(make(clear, view), 2000, seed=8)
    through = sample.direction[:, 2] * view[:, 2] < 0
    light = sample.direction[through]
    before, after = (1.0, GLASS.ior) if outside else (GLASS.ior, 1.0)
    np.testing.assert_allclose(np.linalg.norm(light, axis=1), 1, atol=1e-12)
    # The tangential parts are opposite, in the ratio of the IORs: direction and angle at once.
    np.testing.assert_allclose(
        after * light[:, :2], np.broadcast_to(-before * view[:, :2], light[:, :2].shape), atol=1e-12
    )
    # Reflection is chosen as often as Fresnel says, and all weights are 1.
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    other = np.sqrt(1 - (before / after * s) ** 2)
    parallel = (after * c - before * other) / (after * c + before * other)
    perpendicular = (before * c - after * other) / (before * c + after * other)
    assert_mean(~through, (parallel**2 + perpendicular**2) / 2)
    np.testing.assert_allclose(sample.specular, 1, rtol=1e-6)
    assert sample.delta.all()
    # On the mean, colour tints what goes through by its root, and what is reflected not at all.
    tinted = draw(make(dataclasses.replace(GLASS, base_color=(0.25, 0.25, 0.25)), view), 2000, seed=8)
    through = tinted.direction[:, 2] * view[:, 2] < 0
    reflectance = (parallel**2 + perpendicular**2) / 2
    assert_mean(np.where(through, tinted.specular[:, 0], 0), (1 - reflectance) / 2, rounding=1e-3)
    assert_mean(np.where(through, 0, tinted.specular[:, 0]), reflectance, rounding=1e-3)


@pytest.mark.parametrize("material", [GLASS, ROUGH_GLASS], ids=["smooth", "rough"])
def test_total_internal_reflection(material):
    view = seen(60.0, outside=False)
    assert np.sin(np.radians(60)) * material.ior > 1
    sample = draw(make(material, view), 5000, seed=9)
    if material is GLASS:
        np.testing.assert_allclose(sample.direction, np.broadcast_to(view * (-1, -1, 1), (5000, 3)), atol=1e-12)
        np.testing.assert_allclose(sample.specular, 1, rtol=1e-12)
    else:
        # Microfacets that are tilted far enough let light out; Snell's cone is all they can reach.
        out = sample.direction[sample.direction[:, 2] > 0]
        assert 0 < len(out) < 2500
    assert np.isfinite(sample.specular).all() and np.isfinite(sample.direction).all()


def test_fresnel_closed_forms():
    eta = np.array([1.5])
    assert fresnel_dielectric(np.ones(1), eta) == pytest.approx(0.04)
    assert fresnel_dielectric(np.full(1, 1e-9), eta) == pytest.approx(1, abs=1e-6)
    brewster = np.cos(np.arctan(1.5))  # nothing of the parallel half is reflected
    assert fresnel_dielectric(np.array([brewster]), eta) == pytest.approx(
        ((1.5**2 - 1) / (1.5**2 + 1)) ** 2 / 2
    )
    inside = np.sqrt(1 - (1 - 0.7**2) / 1.5**2)
    assert fresnel_dielectric(np.array([0.7]), eta) == pytest.approx(
        fresnel_dielectric(np.array([inside]), 1 / eta)
    )
    assert fresnel_dielectric(np.array([0.3]), np.array([1.0])) == 0
    assert fresnel_dielectric(np.array([0.3]), np.array([1 / 1.5])) == 1


@pytest.mark.parametrize("stretch", [1.0, 0.4])
@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_microfacets_cover_the_surface_once(alpha, stretch):
    """Their projected area is 1, and seen from V the visible ones fill cos V [Heitz14, Eq. 14]."""
    half, solid_angle = sphere_grid(1000, 1000)
    view = direction(60)
    alphas = np.full((len(half), 2), alpha) * (1.0, stretch)
    facing = np.maximum(half @ view[0], 0) * ggx_density(half, alphas)
    masked = facing @ solid_angle / (1 + ggx_lambda(view, alphas[:1]))
    assert masked == pytest.approx(view[:, 2], rel=2e-3)
    projected = (ggx_density(half, alphas) * half[:, 2]) @ solid_angle
    assert projected == pytest.approx(1, rel=2e-3)


@pytest.mark.parametrize("roughness", [0.0, 0.4])
def test_glass_without_an_interface_is_not_there(roughness):
    nothing = Material("nothing", base_color=(0.25, 1.0, 0.81), transmission=1.0, ior=1.0, roughness=roughness)
    for outside in (True, False):
        view = seen(70.0, outside)
        sample = draw(make(nothing, view), 100)
        np.testing.assert_allclose(sample.direction, np.broadcast_to(-view, (100, 3)), atol=1e-15)
        np.testing.assert_allclose(sample.specular, np.broadcast_to((0.5, 1.0, 0.9), (100, 3)))
        assert sample.delta.all()


def test_mirror_reflects_and_tints():
    view = direction(50.0)
    sample = draw(make(MIRROR, view), 10)
    np.testing.assert_allclose(sample.direction, np.broadcast_to(view * (-1, -1, 1), (10, 3)), atol=1e-12)
    np.testing.assert_allclose(sample.specular, 0.9 + 0.1 * (1 - view[0, 2]) ** 5)
    assert sample.delta.all() and not sample.pdf.any() and not sample.diffuse.any()


def test_no_interface_means_no_coat():
    """Without a specular lobe the material is Lambert's, at every angle; so the kernel without specular agrees."""
    for material in (WHITE, dataclasses.replace(COAT, ior=1.0), dataclasses.replace(COAT, specular_ior_level=0.0)):
        for degrees in (0.0, 89.0):
            bsdf = make(material, direction(degrees))
            np.testing.assert_allclose(bsdf.diffuse_albedo[0], material.base_color)
            assert bsdf.probability[0, 0] == 1 and not bsdf.specular_albedo.any()


def test_black_material_ends_the_path():
    black = Material("black", base_color=(0, 0, 0), specular_ior_level=0)
    sample = draw(make(black, direction(20)), 10)
    assert not sample.diffuse.any() and not sample.specular.any() and np.isfinite(sample.direction).all()


@pytest.mark.parametrize("material", ROUGH + SMOOTH, ids=names(ROUGH + SMOOTH))
def test_nothing_leaks_through_the_geometric_surface(material):
    """A shading normal far from the geometric one neither lights the back nor makes anything that is not finite."""
    tilted = np.array([0.8, 0.0, 0.6])
    view = direction(70.0, turn=np.pi)
    bsdf = make(material, view, normal=tilted)
    if bsdf.probability[0, 2:].any():
        assert (np.einsum("ni,ni->n", bsdf.normal, view) >= 0.0099).all()
    sample = draw(bsdf, 5000, seed=10)
    lit = (sample.diffuse + sample.specular).max(axis=1) > 0
    same_side = (sample.direction[:, 2] > 0) == (np.einsum("ni,ni->n", sample.direction, repeat(bsdf, 5000).normal) > 0)
    assert same_side[lit].all()
    opaque = (MaterialKind.PRINCIPLED, MaterialKind.DIFFUSE, MaterialKind.GLOSSY)
    if material.transmission == 0 and material.kind in opaque:
        assert (sample.direction[lit, 2] > 0).all()
    assert np.isfinite(sample.diffuse).all() and np.isfinite(sample.specular).all()


@pytest.mark.parametrize("roughness", [0.0, 0.0316, 0.0317, 0.05, 0.5, 1.0])
@pytest.mark.parametrize("degrees", [0.0, 89.99, 90.0, 95.0])
def test_extremes_are_finite(roughness, degrees):
    for ior in (1.0, 1.0 + 1e-7, 1.01, 3.0, 100.0):
        for transmission in (0.0, 1.0):
            material = Material(
                "extreme", roughness=roughness, ior=ior, transmission=transmission, specular_ior_level=1.0
            )
            sample = draw(make(material, direction(degrees)), 200)
            for array in (sample.direction, sample.diffuse, sample.specular, sample.pdf):
                assert np.isfinite(array).all()
            assert (sample.diffuse >= 0).all() and (sample.specular >= 0).all()


@pytest.mark.parametrize("material", SINGLE, ids=names(SINGLE))
def test_lambert_stays_where_layers_have_no_weight(material):
    """What a kind does not read does not count."""
    material = dataclasses.replace(material, kind=MaterialKind.DIFFUSE, diffuse_roughness=0.0)
    bsdf = make(material, direction(50))
    np.testing.assert_allclose(bsdf.diffuse_albedo[0], material.base_color)
    assert bsdf.probability[0, 0] == 1 and not bsdf.specular_albedo.any()


def test_events_are_what_cycles_counts():
    diffuse, glossy, transmission = reference.DIFFUSE, reference.GLOSSY, reference.TRANSMISSION
    kinds = {
        "rough diffuse": {diffuse},
        "sheen": {diffuse, glossy},
        "coat": {diffuse, glossy},
        "glossy": {glossy},
        "refraction": {transmission},
        "translucent": {transmission},
    }
    for material in SINGLE:
        if material.name in kinds:
            sample = draw(make(material, direction(40)), 2000, seed=4)
            assert set(sample.event[sample.event != reference.NONE]) == kinds[material.name], material.name
            below = sample.direction[:, 2] < 0
            carries = (sample.diffuse + sample.specular).max(axis=1) > 0
            np.testing.assert_array_equal((sample.event == reference.TRANSMISSION)[carries], below[carries])


@pytest.mark.parametrize("anisotropic", [0.5, 0.95])
@pytest.mark.parametrize("kind", [MaterialKind.PRINCIPLED, MaterialKind.GLOSSY])
def test_anisotropy_stretches_highlights_along_the_tangent(kind, anisotropic):
    """Blender's Principled BSDF is rougher along the tangent, Glossy across it; a quarter turn swaps them."""
    material = Material(kind=kind, metallic=1.0, roughness=0.4, anisotropic=anisotropic)
    spreads = []
    for rotation in (0.0, 0.25):
        turned = dataclasses.replace(material, anisotropic_rotation=rotation)
        light = draw(make(turned, direction(0.0)), 4000, seed=6).direction
        spreads.append(np.abs(light[:, :2]).mean(axis=0))
    first, second = spreads
    np.testing.assert_allclose(first, second[::-1], rtol=0.1)
    assert (first[0] > first[1] * 1.5) == (kind == MaterialKind.PRINCIPLED)


def test_valid_reflection_is_just_above_the_surface():
    """Where the mirror image of the view would be below the horizon the normal turns until it is above."""
    count = 2000
    geometric = np.tile([0.0, 0.0, 1.0], (count, 1))
    view = above(count, 21)
    normal = above(count, 22)
    bent = make_reflection_valid(normal, geometric, view)
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1, atol=1e-9)

    def height(n: np.ndarray) -> np.ndarray:
        return (2 * np.sum(n * view, axis=1)[:, None] * n - view)[:, 2]

    threshold = np.minimum(0.9 * view[:, 2], 0.01)
    valid = height(normal) >= threshold
    assert 0.2 < valid.mean() < 0.95
    np.testing.assert_array_equal(bent[valid], normal[valid])
    np.testing.assert_allclose(height(bent)[~valid], threshold[~valid], atol=1e-6)
    # Within the plane of the two normals.
    assert np.abs(np.sum(np.cross(geometric, normal) * bent, axis=1)).max() < 1e-9


def test_bumps_hide_what_is_behind_the_smooth_surface():
    """A normal map neither lights the back of the smooth surface nor darkens along its normal."""
    tilted = np.array([0.5, 0.0, np.sqrt(0.75)])
    bsdf = make(WHITE, direction(10.0), normal=tilted, smooth_normal=np.array([[0.0, 0.0, 1.0]]))
    directions, _ = sphere_grid(40, 40)
    diffuse, _, pdf = evaluate(repeat(bsdf, len(directions)), directions)
    lambert = 0.8 / np.pi * np.maximum(directions @ tilted, 0)
    hidden = (directions[:, 2] < 0) & (lambert > 0)
    assert hidden.sum() > 20 and not diffuse[hidden].any() and not pdf[hidden].any()
    lit = (directions[:, 2] > 0) & (lambert > 0)
    factor = diffuse[lit, 0] / lambert[lit]
    # GGX masking of alpha^2 = tan^2 / 8 of the angle between the normals [Chiang19].
    c = directions[lit, 2]
    expected = 2 / (1 + np.sqrt(1 + (1 / 0.75 - 1) / 8 * (1 / c**2 - 1)))
    np.testing.assert_allclose(factor, expected, rtol=1e-9)


def test_coat_tint_is_that_of_a_ray_along_the_normal():
    tinted = Material(
        base_color=(1.0, 1.0, 1.0), specular_ior_level=0.0, coat_weight=1.0, coat_tint=(0.5, 0.8, 1.0), coat_ior=1.5
    )
    clear = dataclasses.replace(tinted, coat_tint=(1.0, 1.0, 1.0))
    for degrees in (0.0, 60.0):
        inside = np.sqrt(1 - (np.sin(np.radians(degrees)) / 1.5) ** 2)
        ratio = make(tinted, direction(degrees)).diffuse_albedo[0] / make(clear, direction(degrees)).diffuse_albedo[0]
        np.testing.assert_allclose(ratio, np.array([0.5, 0.8, 1.0]) ** (1 / inside), rtol=1e-9)


def test_edge_tint_of_metal_is_its_reflectance_at_82_degrees():
    """What [Kutz21] defines it by: Schlick's reflectance there times the tint."""
    base, tint = np.array([[0.9, 0.5, 0.2]]), (0.3, 1.0, 0.6)
    bsdf = make(Material(base_color=tuple(base[0]), metallic=1.0, specular_tint=tint), direction(30))
    cosine = np.array([1 / 7])
    fresnel = fresnel_metal(bsdf.metal_f0, bsdf.metal_f90, bsdf.metal_dip, cosine)
    np.testing.assert_allclose(fresnel, (base + (1 - base) * (6 / 7) ** 5) * tint, rtol=1e-9)
    np.testing.assert_allclose(fresnel_metal(bsdf.metal_f0, bsdf.metal_f90, bsdf.metal_dip, np.ones(1)), base)


def test_oren_nayar_keeps_energy():
    """Of a white surface, all of it: the albedo of one reflection, by quadrature, and that of the others."""
    directions, solid_angle = sphere_grid(400, 200)
    for degrees in (0.0, 50.0, 85.0):
        material = Material(kind=MaterialKind.DIFFUSE, base_color=(1.0, 1.0, 1.0), diffuse_roughness=1.0)
        bsdf = make(material, direction(degrees))
        diffuse, _, _ = evaluate(repeat(bsdf, len(directions)), directions)
        assert diffuse[:, 0] @ solid_angle == pytest.approx(1, abs=3e-3)
        np.testing.assert_allclose(bsdf.diffuse_albedo, 1, atol=3e-3)
