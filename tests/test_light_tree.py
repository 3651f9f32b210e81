# SPDX-License-Identifier: Apache-2.0
"""Choosing lights: the tree's bounds hold, probabilities are those of the choices, and follow what lights bring."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from svgf.effects import Effects
from svgf.flat_lights import AMBIENT, ENVIRONMENT, ENVIRONMENT_FACTOR, LARGEST_LEAF, TRIANGLE, WEIGHT
from svgf.flatten import flatten
from svgf.light_tree import LightBounds, build_light_tree
from svgf.reference.light_tree import light_importance
from svgf.reference.lights import Lights
from svgf.scene import LightKind

from . import scenes
from .statistical import assert_histogram, assert_mean
from .test_lights import lights_of

COUNT = 20_000


def random_bounds(count: int, seed: int = 0) -> LightBounds:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-3, 3, (count, 3))
    axis = rng.normal(size=(count, 3))
    high = low + rng.uniform(0, 0.4, (count, 3))
    return LightBounds(
        low=low.astype(np.float32).astype(float),
        high=high.astype(np.float32).astype(float),
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
        cos_normals=rng.choice([1.0, 0.5, -1.0], count),
        cos_emission=rng.choice([0.0, 0.7], count),
        intensity=rng.uniform(0.1, 5, count),
        two_sided=rng.random(count) < 0.3,
    )


@pytest.mark.parametrize("count", [1, 2, 3, 16, 37])
def test_each_light_has_one_leaf(count):
    bounds = random_bounds(count)
    nodes, leaves = build_light_tree(bounds)
    assert sorted(leaves[leaves >= 0]) == list(range(count))
    assert len(nodes) == 2 * len(leaves) - 1 and len(leaves) < 2 * count
    assert abs(nodes[0, 11]) == pytest.approx(bounds.intensity.sum())


@pytest.mark.parametrize("seed", range(4))
def test_nodes_bound_what_is_below_them(seed):
    """Boxes hold the boxes, cones the cones, and what reaches a point from a leaf reaches it from all nodes above."""
    bounds = random_bounds(37, seed)
    nodes, leaves = build_light_tree(bounds)
    first_leaf = len(leaves) - 1
    rng = np.random.default_rng(seed)
    points, normals = rng.uniform(-5, 5, (64, 3)), rng.normal(size=(64, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for leaf, light in enumerate(leaves):
        node = first_leaf + leaf
        reaches = light_importance(np.tile(nodes[node], (64, 1)), points, normals) > 0
        while light >= 0 and node:
            child, node = node, (node - 1) // 2
            parent = nodes[node]
            assert (parent[0:3] <= bounds.low[light]).all() and (parent[3:6] >= bounds.high[light]).all()
            angle = np.arccos(np.clip(nodes[child, 6:9] @ parent[6:9], -1, 1))
            if parent[11] < 0:
                angle = min(angle, np.pi - angle)
            # Cosines near 1, rounded to float32, are off by so much; the importance widens its angles by more.
            assert min(angle + np.arccos(nodes[child, 9]), np.pi) <= np.arccos(parent[9]) + 8e-4
            assert parent[10] <= nodes[child, 10]
            # Through a larger box and a wider cone a point sees at least as well.
            assert (light_importance(np.tile(parent, (64, 1)), points, normals) > 0)[reaches].all()


def lights_beside_the_sky(count: int) -> Lights:
    """A sun, the sky, and lights that are somewhere."""
    nodes, leaves = build_light_tree(random_bounds(count))
    data = np.zeros((2 + count, 24))
    data[0, 9:12], data[0, AMBIENT], data[0, WEIGHT] = (0.0, 0.6, 0.8), 0.02, 0.3
    data[1, 9:12], data[1, AMBIENT], data[1, WEIGHT] = (0.3, 0.0, 0.2), 0.16, 0.7
    data[2:, [AMBIENT, WEIGHT]] = 1.0
    kinds = [LightKind.SUN, ENVIRONMENT, *[LightKind.POINT] * count]
    return Lights(kinds, data, light_tree=nodes, light_of_leaf=np.where(leaves >= 0, leaves + 2, -1))


@pytest.mark.parametrize("count", [0, 1, 5, 37])
@pytest.mark.parametrize("normal", [(0.0, 0.6, 0.8), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)])
def test_choice_has_the_probabilities_that_it_states(count, normal):
    """Below, above and beyond the lights that all are weighed on their own, before an opaque surface or another."""
    lights = lights_beside_the_sky(count)
    assert lights.choices == count + 2
    for seed in range(2):
        rng = np.random.default_rng(seed)
        point = rng.uniform(-3, 3, (1, 3))
        many = np.repeat(point, COUNT, axis=0), np.tile(normal, (COUNT, 1))
        chosen, probability = lights.choose(rng.random((COUNT, 2)), *many)
        each = np.repeat(point, len(lights), axis=0), np.tile(normal, (len(lights), 1))
        stated = lights.choice_probability(np.arange(len(lights)), *each)
        assert stated.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(probability, stated[chosen])
        assert_histogram(np.bincount(chosen, minlength=len(lights)), stated * COUNT)


def test_one_light_is_no_choice():
    view = scenes.camera((0, 0, 1), (0, 0, 0))
    one, two = (flatten(scenes.build([], view, [scenes.lamp(LightKind.POINT)] * count)) for count in (1, 2))
    assert not one.effects & Effects.MANY_LIGHTS and len(one.light_tree) == 1
    assert two.effects & Effects.MANY_LIGHTS and len(two.light_tree) == 3
    assert not flatten(scenes.build([], view, [scenes.lamp(LightKind.SUN)])).effects & Effects.MANY_LIGHTS
    sun_and_lamp = [scenes.lamp(LightKind.SUN), scenes.lamp(LightKind.POINT)]
    assert flatten(scenes.build([], view, sun_and_lamp)).effects & Effects.MANY_LIGHTS
    lights = lights_of(scenes.many_lights_scene())
    assert lights.choices == len(lights) and lights.everywhere == 1


GLOW = scenes.Material("glow", emission=(30.0,) * 3, specular_ior_level=0.0)
DIM = scenes.Material("dim", emission=(2.0,) * 3, specular_ior_level=0.0)


@pytest.mark.parametrize("count", [1, 2, LARGEST_LEAF, LARGEST_LEAF + 1])
def test_few_triangles_of_an_object_are_one_leaf(count):
    """Chosen among by their power; their bounds hold all of them. More of them are weighed one by one."""
    rng = np.random.default_rng(count)
    corners = rng.uniform(-0.5, 0.5, (3 * count, 3)) + (0, 0, 1)
    shape = scenes.mesh(corners, np.arange(3 * count).reshape(-1, 3))
    materials = np.arange(count, dtype=np.int32) % 2
    shape = dataclasses.replace(shape, material_slots=materials)
    objects = [(shape, scenes.transform((x, 0, 0)), [GLOW, DIM]) for x in (-1.0, 1.0)]
    lights = lights_of(scenes.build(objects, scenes.camera((0, -3, 1), (0, 0, 0)), [scenes.lamp(LightKind.POINT)]))
    assert lights.choices == len(lights) == 2 * count + 1
    is_whole = count <= LARGEST_LEAF
    assert np.count_nonzero(lights.light_of_leaf >= 0) == (3 if is_whole else len(lights))
    for leaf in np.unique(lights.leaf):
        members = np.flatnonzero(lights.leaf == leaf)
        power = np.where(lights.kind[members] == TRIANGLE, lights.area[members] * lights.radiance[members, 0], 1.0)
        np.testing.assert_allclose(lights.weight[members], power / power.sum())
        node = lights.tree[len(lights.light_of_leaf) - 1 + leaf]
        for light in members[lights.kind[members] == TRIANGLE]:
            for corner in (0.0, lights.axis_x[light], lights.axis_y[light]):
                at = lights.position[light] + corner
                assert (at > node[0:3] - 1e-5).all() and (at < node[3:6] + 1e-5).all()
            assert np.abs(lights.axis_z[light] @ node[6:9]) > 1.0 - 1e-5 or node[9] == -1.0
    points, normals = np.tile([0.3, 0.1, 0.0], (COUNT, 1)), np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    chosen, probability = lights.choose(rng.random((COUNT, 2)), points, normals)
    stated = lights.choice_probability(np.arange(len(lights)), points[: len(lights)], normals[: len(lights)])
    assert stated.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(probability, stated[chosen])
    assert_histogram(np.bincount(chosen, minlength=len(lights)), stated * COUNT)


def surface_irradiance(lights: Lights, point, normal) -> np.ndarray:
    """[L]: of each light alone, at an opaque surface."""
    alone = [irradiance_of_one(lights, index, point, np.asarray(normal)) for index in range(len(lights))]
    return np.array(alone)


# A lamp, an emissive triangle and the box that bounds it lie within this of its place. Metres.
REACH = 0.0075


def small_light(kind: LightKind, offset, power: float, turned: float = 0.0, **changes) -> scenes.Light:
    """5 mm wide, at an offset from the origin, turned by an angle away from it."""
    target = scenes.rotation("x", turned) @ -np.asarray(offset) + offset
    size = (0.0025, 0.0) if kind in (LightKind.POINT, LightKind.SPOT) else (0.005, 0.005)
    lamp = scenes.lamp(kind, eye=offset, target=target, power=(power,) * 3, size=size)
    return dataclasses.replace(lamp, **changes)


# 4 to 5 metres from the origin.
LAMPS = (
    small_light(LightKind.SUN, (1.0, 0.0, 2.0), 200.0),
    small_light(LightKind.POINT, (0.5, 1.0, 4.0), 4000.0),
    small_light(LightKind.SPOT, (2.0, -1.0, 4.0), 4000.0),
    small_light(LightKind.RECTANGLE, (1.0, -2.0, 4.0), 1500.0, turned=0.6),
    small_light(LightKind.ELLIPSE, (-1.0, -1.0, 4.0), 1500.0, turned=-0.8),
    small_light(LightKind.RECTANGLE, (1.0, 2.0, 4.0), 500.0, spread=2.0),
)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_lights_of_all_kinds_are_chosen_by_their_irradiance(normal):
    """Of lights that are small, far from the horizon and face the point, within what their bounds add.

    All of a light is within an angle of the direction to its place. The estimate takes the distance of the middle and
    the best cosines within the angle: against the irradiance it is off by no more than the ratios of the least and the
    greatest distance and cosines. A sun counts with a fiftieth of its irradiance more: a surface that faces away may
    have a coat that does not.
    """
    place = np.array([0.0, -2.0, 4.0])
    corners = place + 0.0025 * np.array([(1, 0, 0), (0, 0.9, 0.4), (-1, 0, 0)])
    bright = dataclasses.replace(GLOW, emission=(6e7,) * 3)
    panel = (scenes.mesh(corners, [(0, 1, 2)]), scenes.transform(), [bright])
    lights = lights_of(scenes.build([panel], scenes.camera((0, -3, 1), (0, 0, 0)), LAMPS))
    exact = surface_irradiance(lights, (0.0, 0.0, 0.0), normal)
    each = np.zeros((len(lights), 3)), np.tile(normal, (len(lights), 1))
    ratio = lights.choice_probability(np.arange(len(lights)), *each) / (exact / exact.sum())

    sun, lamps = LAMPS[0], LAMPS[1:]
    places = np.array([*(lamp.light_to_world[:, 3] for lamp in lamps), place])
    distance = np.linalg.norm(places, axis=1)
    direction = places / distance[:, None]
    angle = np.arcsin(REACH / distance) + 1.2e-3  # the estimate's own allowance, for roundings
    axes = np.array([*(-lamp.light_to_world[:, 2] for lamp in lamps), np.cross(*np.diff(corners, axis=0))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turned = np.arccos(np.minimum(np.abs((axes * direction).sum(axis=1)), 1.0))
    incident = np.arccos(direction @ normal)
    least = ((distance - REACH) / (distance + REACH)) ** 2
    most = 1.0 / least
    for of_light in (turned, incident):
        most = most * np.cos(np.maximum(of_light - angle, 0.0)) / np.cos(of_light + angle)
    most[4] /= 1.0 - np.tan(angle[4]) / np.tan(1.0)  # a spread fades from its axis on
    cosine = sun.light_to_world[:, 2] @ normal
    least, most = (np.append(1.0 + 0.02 / cosine, bound) for bound in (least, most))
    assert lights.kind.tolist() == [*(lamp.kind for lamp in LAMPS), TRIANGLE]
    assert (exact > 0.05 * exact.sum()).all() and most.max() < 1.06 and least.min() > 0.98
    assert ((ratio > least / most.max()) & (ratio < most / least.min())).all(), (ratio, least, most)


def test_a_sky_is_weighed_by_the_side_it_shines_from():
    """Its share of the choice beside a sun. What is sampled of it counts as its mean direction faces the surface, which
    is its irradiance where all of it is above the horizon, and with a quarter of what has no direction."""
    floor = (scenes.quad(2.0), scenes.transform(), [scenes.WHITE])
    sun = scenes.lamp(LightKind.SUN, eye=(0, 0, 5), power=(500.0,) * 3, size=(0.0, 0.0))  # 50 W/m2
    rows, columns = np.mgrid[0:32, 0:64]
    elevation, azimuth = (rows + 0.5) / 32 * np.pi - np.pi / 2, (0.5 - (columns + 0.5) / 64) * 2 * np.pi
    area = np.cos(elevation) * np.pi / 32 * 2 * np.pi / 64
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    directions = np.stack([x, y, np.sin(elevation)], axis=-1)
    wide = np.where(rows >= 16, 40.0, 0.0)  # the upper half
    small = np.where((rows == 30) & (columns > 20) & (columns < 40), 9000.0, 1.0)
    for pixels in (wide, small):
        sky = scenes.Texture("sky", np.repeat(pixels[:, :, None], 4, axis=2).astype(np.float32), srgb=False)
        world = scenes.World((1, 1, 1), environment=0)
        view = scenes.camera((0, -3, 1), (0, 0, 0))
        lights = lights_of(scenes.build([floor], view, [sun], textures=[sky], world=world))
        sampled = np.maximum(pixels - (pixels * area).sum() / (4 * np.pi), 0) * area
        mean_direction = np.tensordot(sampled, directions, 2) / sampled.sum()
        ambient = max((1 - np.linalg.norm(mean_direction)) / 4, 0.02)
        for normal in ((0, 0, 1.0), (0, 0.8, 0.6), (0, -0.8, 0.6), (0.6, 0, 0.8)):
            facing = max(mean_direction @ normal, 0.0)
            cosines = directions @ normal
            irradiance = (sampled * np.maximum(cosines, 0)).sum() / sampled.sum()
            if (cosines[sampled > 0] > 0).all():
                assert facing == pytest.approx(irradiance)
            else:
                assert facing < irradiance < facing + ambient
            stated = lights.choice_probability(np.arange(2), np.zeros((2, 3)), np.tile(normal, (2, 1)))
            of_sky = ENVIRONMENT_FACTOR * sampled.sum() * min(facing + ambient, 1.0)
            assert stated[1] / stated[0] == pytest.approx(of_sky / (50.0 * min(normal[2] + 0.02, 1.0)), rel=0.005)


@pytest.mark.parametrize("where", [0.0, 1e6, 1e15])
@pytest.mark.parametrize("size", [0.0, 1e-4, 1e5])
def test_choice_is_finite_far_away_and_beside_lights_of_any_size(where, size):
    lamps = [scenes.lamp(kind, eye=(where, 0.1, 2.0), size=(size, size), power=(1e30,) * 3) for kind in LightKind]
    lights = lights_of(scenes.build([], scenes.camera((0, -3, 1), (0, 0, 0)), lamps))
    points = np.concatenate([lights.position, np.zeros((1, 3)), np.random.default_rng(0).normal(size=(100, 3)) * 10.0])
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    for light in range(len(lights)):
        probability = lights.choice_probability(np.full(len(points), light), points, normals)
        assert ((probability >= 0.0) & (probability <= 1.0)).all()
    _, probability = lights.choose(np.random.default_rng(1).random((len(points), 2)), points, normals)
    assert (probability > 0.0).all()  # of the sun, at least


def irradiance(lights, count: int, point, normal, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points, normals = np.tile(point, (count, 1)), np.tile(normal, (count, 1))
    light, probability = lights.choose(rng.random((count, 2)), points, normals)
    sample = lights.sample(light, probability, points, rng.random((count, 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.maximum((sample.direction * normals).sum(axis=1), 0)
        return np.where(sample.pdf > 0, sample.radiance[:, 0] * cosine / sample.pdf, 0.0)


def test_choice_is_unbiased_and_quieter_than_power_alone():
    """Irradiance by the choice at the point, by the power of the lights alone, and light by light: one mean, and less
    variance."""
    lights = lights_of(scenes.many_lights_scene())
    leaf = lights.leaf
    of_leaf = np.abs(lights.tree[len(lights.light_of_leaf) - 1 + leaf, 11])
    power = lights.weight * np.where(leaf >= 0, of_leaf, 1.0)
    by_power_alone = PowerAlone(lights, power / power.sum())
    gains = []
    for point in [(0.0, 0.0, 0.0), (1.5, -1.0, 0.0), (-2.0, 2.0, 0.0), (0.2, 1.9, 0.3)]:
        normal = np.array([0.0, 0.0, 1.0])
        by_choice, by_power = (irradiance(each, COUNT, point, normal) for each in (lights, by_power_alone))
        exact = surface_irradiance(lights, point, normal).sum()
        assert_mean(by_choice, exact, rounding=5e-3)
        assert_mean(by_power, exact, rounding=5e-3)
        gains.append(by_power.var() / by_choice.var())
    assert min(gains) > 2.0, gains


class PowerAlone:
    """Lights of which one is chosen with a probability [L], wherever."""

    def __init__(self, lights: Lights, probability: np.ndarray) -> None:
        self.sample = lights.sample
        self._probability = probability

    def choose(self, u: np.ndarray, point: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        light = np.minimum(np.searchsorted(np.cumsum(self._probability), u[:, 0]), len(self._probability) - 1)
        return light, self._probability[light]


def irradiance_of_one(lights, index: int, point, normal, count: int = 500) -> float:
    rng = np.random.default_rng(index)
    points = np.tile(point, (count, 1))
    sample = lights.sample(np.full(count, index), np.ones(count), points, rng.random((count, 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        value = sample.radiance[:, 0] * np.maximum(sample.direction @ normal, 0) / sample.pdf
    return float(np.where(sample.pdf > 0, value, 0).mean())


def test_hits_and_samples_state_one_density():
    """MIS rests on it: the probability of a light is the same from both sides, whatever its kind."""
    lights = lights_of(scenes.many_lights_scene())
    rng = np.random.default_rng(3)
    points, normals = rng.uniform(-1, 1, (COUNT, 3)), np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    light, probability = lights.choose(rng.random((COUNT, 2)), points, normals)
    chosen = np.flatnonzero(probability > 0)
    assert set(lights.kind[light[chosen]]) == {*LightKind, TRIANGLE}
    again = lights.choice_probability(light[chosen], points[chosen], normals[chosen])
    np.testing.assert_allclose(again, probability[chosen])
