# SPDX-License-Identifier: Apache-2.0
"""Lights of the reference: irradiance against form factors, densities against their own integral."""

import dataclasses

import numpy as np
import pytest

from svgf.flatten import flatten
from svgf.reference.lights import Lights
from svgf.renderer import LIGHT_FIELDS
from svgf.scene import Light, LightKind

from . import scenes
from .statistical import assert_mean

COUNT = 40_000
UP = np.array([0.0, 0.0, 1.0])


def lights_of(scene) -> Lights:
    flat = flatten(scene)
    columns = {name: getattr(flat, name).copy() for name in LIGHT_FIELDS}
    columns["light_data"][:, 0:3] += flat.origin  # back to where the tests count from
    columns["light_tree"][:, :6] += np.tile(flat.origin, 2)
    return Lights(**columns)


def single(light: Light) -> Lights:
    floor = (scenes.quad(2.0), scenes.transform(), [scenes.WHITE])
    return lights_of(scenes.build([floor], scenes.camera((0, -3, 1), (0, 0, 0)), [light]))


def triangle_lights(vertices, emission=(2.0, 3.0, 4.0)) -> Lights:
    glow = scenes.Material("glow", emission=emission)
    shape = scenes.mesh(vertices, [(0, 1, 2)])
    return lights_of(scenes.build([(shape, scenes.transform(), [glow])], scenes.camera((0, -3, 1), (0, 0, 0))))


def irradiance_samples(lights: Lights, point=(0.0, 0.0, 0.0), normal=UP, seed: int = 0) -> np.ndarray:
    """[COUNT, 3]: estimates of irradiance at a point; stratified numbers would make the z-test too sure of itself."""
    rng = np.random.default_rng(seed)
    points = np.tile(np.asarray(point, dtype=np.float64), (COUNT, 1))
    light, probability = lights.choose(rng.random((COUNT, 2)), points, np.tile(normal, (COUNT, 1)))
    sample = lights.sample(light, probability, points, rng.random((COUNT, 2)))
    cosine = np.maximum(sample.direction @ normal, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sample.pdf[:, None] > 0, sample.radiance * (cosine / sample.pdf)[:, None], 0.0)


def polygon_irradiance(vertices, radiance: float, normal=UP) -> float:
    """Lambert's formula for a uniform polygon above the horizon, seen from the origin."""
    v = np.asarray(vertices, dtype=np.float64)
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(v, np.roll(v, -1, axis=0)):
        axis = np.cross(a, b)
        total += np.arccos(np.dot(a, b)) * np.dot(axis / np.linalg.norm(axis), normal)
    return radiance * abs(total) / 2


def rectangle_corners(light: Light) -> np.ndarray:
    x, y, position = light.light_to_world[:, 0], light.light_to_world[:, 1], light.light_to_world[:, 3]
    halves = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2 * light.size
    return position + halves[:, :1] * x + halves[:, 1:] * y


@pytest.mark.parametrize("eye", [(0, 0, 2), (1.5, 0.5, 1.0), (0.2, 0.1, 0.3)])
def test_rectangle(eye):
    lamp = scenes.lamp(LightKind.RECTANGLE, eye=eye, target=(0.1, 0.2, 0))
    lights = single(lamp)
    expected = polygon_irradiance(rectangle_corners(lamp), lights.radiance[0, 0])
    assert_mean(irradiance_samples(lights)[:, 0], expected)


@pytest.mark.parametrize("distance", [0.2, 1.0, 5.0])
def test_disk(distance):
    lamp = scenes.lamp(LightKind.ELLIPSE, eye=(0, 0, distance), size=(1.0, 1.0))
    lights = single(lamp)
    assert_mean(irradiance_samples(lights)[:, 1], np.pi * lights.radiance[0, 1] * 0.5**2 / (0.5**2 + distance**2))


def test_ellipse_far_away():
    """As a point of its area."""
    lamp = scenes.lamp(LightKind.ELLIPSE, eye=(0, 0, 100), size=(1.0, 0.4))
    lights = single(lamp)
    expected = lights.radiance[0, 0] * np.pi / 4 * 1.0 * 0.4 / 100**2
    assert irradiance_samples(lights)[:, 0].mean() == pytest.approx(expected, rel=1e-4)


def test_area_lamps_shine_one_way_with_all_their_power():
    for kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
        lamp = scenes.lamp(kind, eye=(0, 0, -1), target=(0, 0, -5))
        assert not irradiance_samples(single(lamp)).any()
        small, large = (single(scenes.lamp(kind, size=size)) for size in ((0.1, 0.1), (2.0, 1.0)))
        np.testing.assert_allclose(small.radiance * small.area, large.radiance * large.area)


@pytest.mark.parametrize("radius", [0.01, 0.5, 0.99])
def test_sphere(radius):
    lamp = scenes.lamp(LightKind.POINT, eye=(0.6, 0, 0.8), size=(radius, 0.0))
    lights = single(lamp)
    # Below the horizon only if the sphere dips under it.
    if radius <= 0.8:
        assert_mean(irradiance_samples(lights)[:, 0], np.pi * lights.radiance[0, 0] * radius**2 * 0.8)
    facing = np.array([0.6, 0.0, 0.8])
    assert_mean(irradiance_samples(lights, normal=facing)[:, 0], lamp.power[0] / (4 * np.pi), rounding=1e-6)


@pytest.mark.parametrize("distance", [0.05, 0.5, 4.0])
def test_soft_falloff(distance):
    """A disk that always faces the point: irradiance stays finite however near it is."""
    lamp = scenes.lamp(LightKind.POINT, eye=(0.6 * distance, 0, 0.8 * distance), size=(0.5, 0.0))
    lights = single(dataclasses.replace(lamp, soft_falloff=True))
    facing = np.array([0.6, 0.0, 0.8])
    assert_mean(
        irradiance_samples(lights, normal=facing)[:, 0], lamp.power[0] / (4 * np.pi) / (distance**2 + 0.5**2)
    )


def test_inside_of_a_sphere():
    """All directions shine: irradiance is pi times radiance."""
    lights = single(scenes.lamp(LightKind.POINT, eye=(0.1, 0.2, 0.3), size=(2.0, 0.0)))
    assert_mean(irradiance_samples(lights)[:, 2], np.pi * lights.radiance[0, 2])


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.01, 1.0, np.pi])
def test_sun(angle):
    """Its power is irradiance on what faces it, whatever its size."""
    lamp = scenes.lamp(LightKind.SUN, eye=(0, 0, 5), size=(angle, 0.0))
    assert_mean(irradiance_samples(single(lamp))[:, 0], lamp.power[0], rounding=1e-5)


def test_delta_point_falls_off_with_the_square():
    lamp = scenes.lamp(LightKind.POINT, eye=(3.0, 0, 4.0), size=(0.0, 0.0))
    np.testing.assert_allclose(irradiance_samples(single(lamp))[:, 1], lamp.power[1] / (4 * np.pi) / 25 * 0.8)


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_spot_cone(size):
    """Full intensity on the axis, none outside of the cone, the smoothstep in between."""
    angle, blend, distance = 1.0, 0.4, 2.0
    placement = scenes.look_at((0, 0, distance), (0, 0, 0))
    lights = single(Light("spot", LightKind.SPOT, (100.0,) * 3, placement, (size, 0.0), angle, blend))
    cos_edge = np.cos(angle / 2)
    half_way = cos_edge + (1 - cos_edge) * blend / 2
    for cosine, share in ((1.0, 1.0), (cos_edge - 0.01, 0.0), (half_way, 0.5)):
        point = np.array([distance * np.tan(np.arccos(cosine)), 0.0, 0.0])
        expected = 100 / (4 * np.pi) / (distance / cosine) ** 2 * cosine * share
        assert irradiance_samples(lights, point)[:, 0].mean() == pytest.approx(expected, rel=1e-2, abs=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_triangle_shines_both_ways(turned):
    vertices = np.array([(0.5, 0.2, 1.0), (-0.7, 0.4, 0.8), (0.1, -0.9, 1.5)])
    lights = triangle_lights(vertices[::-1] if turned else vertices)
    assert_mean(irradiance_samples(lights)[:, 2], polygon_irradiance(vertices, 4.0))


def test_many_lights_add_up():
    """Whatever the probabilities of choosing them."""
    kinds = [LightKind.RECTANGLE, LightKind.POINT, LightKind.SUN, LightKind.ELLIPSE]
    lamps = [scenes.lamp(kind, eye=(0.3 * i, 0.2, 1.0 + i), power=(10.0 * 4**i,) * 3) for i, kind in enumerate(kinds)]
    alone = [irradiance_samples(single(lamp), seed=i)[:, 0].mean() for i, lamp in enumerate(lamps)]
    view = scenes.camera((0, -3, 1), (0, 0, 0))
    together = lights_of(scenes.build([(scenes.quad(2.0), scenes.transform(), [scenes.WHITE])], view, lamps))
    assert_mean(irradiance_samples(together)[:, 0], sum(alone), rounding=0.01)


SIZED = {
    "sphere": scenes.lamp(LightKind.POINT),
    "inside_sphere": scenes.lamp(LightKind.POINT, size=(3.0, 0.0)),
    "spot": scenes.lamp(LightKind.SPOT),
    "sun": scenes.lamp(LightKind.SUN, size=(0.7, 0.0)),
    "rectangle": scenes.lamp(LightKind.RECTANGLE, size=(2.0, 3.0)),
    "ellipse": scenes.lamp(LightKind.ELLIPSE, size=(2.0, 3.0)),
}


@pytest.mark.parametrize("lamp", SIZED.values(), ids=SIZED)
def test_rays_find_lamps_with_the_density_of_their_samples(lamp):
    """Both ways of finding a lamp state one density; over all directions it is 1."""
    lights = single(lamp)
    rng = np.random.default_rng(1)
    origin = np.zeros((COUNT, 3))
    sample = lights.sample(np.zeros(COUNT, dtype=int), np.ones(COUNT), origin, rng.random((COUNT, 2)))
    # The very rim may count or not.
    ((_, rows, radiance, pdf),) = lights.crossed_lamps(origin, sample.direction, np.full(COUNT, np.inf))
    assert len(rows) >= 0.9999 * COUNT
    np.testing.assert_allclose(pdf, sample.pdf[rows], rtol=1e-6)
    np.testing.assert_allclose(radiance, sample.radiance[rows], rtol=1e-6, atol=1e-12)
    blocked = sample.distance * 0.999 if lamp.kind != LightKind.SUN else np.full(COUNT, 1e9)
    assert not list(lights.crossed_lamps(origin, sample.direction, blocked))

    directions = rng.normal(size=(COUNT * 10, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    density = np.zeros(len(directions))
    for _, rows, _, pdf in lights.crossed_lamps(np.zeros_like(directions), directions, np.full(len(directions), np.inf)):
        density[rows] = pdf
    assert_mean(density * 4 * np.pi, 1.0)


def test_triangle_density_is_that_of_its_samples():
    lights = triangle_lights([(0.5, 0.2, 1.0), (-0.7, 0.4, 0.8), (0.1, -0.9, 1.5)])
    light = np.zeros(1000, dtype=int)
    sample = lights.sample(light, np.ones(1000), np.zeros((1000, 3)), np.random.default_rng(2).random((1000, 2)))
    cosine = sample.direction @ lights.axis_z[0]
    assert (lights.find(np.zeros(1000, dtype=int), light) == 0).all()
    np.testing.assert_allclose(lights.triangle_pdf(light, sample.distance, cosine), sample.pdf)


def test_points_on_the_light_itself_are_dark_not_infinite():
    for lamp in (*SIZED.values(), *(scenes.lamp(kind, size=(0.0, 0.0)) for kind in LightKind)):
        lights = single(lamp)
        on_it = np.tile(lamp.light_to_world[:, 3], (100, 1))
        sample = lights.sample(np.zeros(100, dtype=int), np.ones(100), on_it, np.random.default_rng(3).random((100, 2)))
        assert np.isfinite(sample.pdf).all() and np.isfinite(sample.radiance).all()
