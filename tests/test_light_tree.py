# SPDX-License-Identifier: Apache-2.0
"""The light tree: its bounds hold, its probabilities are those of its choices, and it pays."""

from __future__ import annotations

import numpy as np
import pytest

from svgf.effects import Effects
from svgf.flat_lights import TRIANGLE
from svgf.flatten import flatten
from svgf.light_tree import SMALLEST_TREE, LightBounds, build_light_tree
from svgf.reference.light_tree import light_importance, walk_light_tree
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
        power=rng.uniform(0.1, 5, count),
        two_sided=rng.random(count) < 0.3,
    )


@pytest.mark.parametrize("count", [1, 2, 3, 16, 37])
def test_each_light_has_one_leaf(count):
    bounds = random_bounds(count)
    nodes, leaves = build_light_tree(bounds)
    assert sorted(leaves[leaves >= 0]) == list(range(count))
    assert len(nodes) == 2 * len(leaves) - 1 and len(leaves) < 2 * count
    assert abs(nodes[0, 11]) == pytest.approx(bounds.power.sum())


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


def test_choice_has_the_probabilities_that_it_states():
    bounds = random_bounds(37)
    nodes, leaves = build_light_tree(bounds)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        point, normal = rng.uniform(-3, 3, (1, 3)), np.array([[0.0, 0.6, 0.8]])
        many = np.repeat(point, COUNT, axis=0), np.repeat(normal, COUNT, axis=0)
        chosen, probability = walk_light_tree(nodes, *many, rng.random((COUNT, 2)), np.full(COUNT, -1))
        each = np.repeat(point, len(leaves), axis=0), np.repeat(normal, len(leaves), axis=0)
        targets = np.arange(len(leaves))
        _, stated = walk_light_tree(nodes, *each, np.zeros((len(leaves), 2)), targets)
        assert stated.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(probability, stated[chosen])
        assert_histogram(np.bincount(chosen, minlength=len(leaves)), stated * COUNT)


def test_few_lights_have_no_tree():
    assert not flatten(scenes.mesh_light_scene()).effects & Effects.MANY_LIGHTS
    flat = flatten(scenes.many_lights_scene())
    assert flat.effects & Effects.MANY_LIGHTS
    assert np.count_nonzero(flat.light_of_leaf >= 0) == np.count_nonzero(flat.light_kind != LightKind.SUN)
    assert len(flat.light_cdf) == 3  # the sun, the tree
    few = flatten(scenes.build([], scenes.camera((0, 0, 1), (0, 0, 0)), [scenes.lamp(LightKind.POINT)] * 15))
    assert SMALLEST_TREE == 16 and not len(few.light_tree)


def irradiance(lights, count: int, point, normal, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points, normals = np.tile(point, (count, 1)), np.tile(normal, (count, 1))
    light, probability = lights.choose(rng.random((count, 2)), points, normals)
    sample = lights.sample(light, probability, points, rng.random((count, 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.maximum((sample.direction * normals).sum(axis=1), 0)
        return np.where(sample.pdf > 0, sample.radiance[:, 0] * cosine / sample.pdf, 0.0)


def test_tree_is_unbiased_and_quieter_than_power_alone():
    """Irradiance by the tree, by the power of the lights alone, and light by light: one mean, and less variance."""
    scene = scenes.many_lights_scene()
    flat = flatten(scene)
    tree = lights_of(scene)
    flat_choice = lights_of(scene)
    weight = np.zeros(len(tree))
    leaf = tree.leaf
    weight[leaf >= 0] = np.abs(tree.tree[len(tree.light_of_leaf) - 1 + leaf[leaf >= 0], 11])
    everywhere = leaf < 0
    share = weight / weight.sum() * tree.probability[~everywhere][0]
    flat_choice.probability = np.where(everywhere, tree.probability, share)
    flat_choice.cdf = np.append(0, np.cumsum(flat_choice.probability)).astype(np.float32).astype(float)
    flat_choice.tree = tree.tree[:0]
    gains = []
    for point in [(0.0, 0.0, 0.0), (1.5, -1.0, 0.0), (-2.0, 2.0, 0.0), (0.2, 1.9, 0.3)]:
        normal = np.array([0.0, 0.0, 1.0])
        by_tree, by_power = (irradiance(lights, COUNT, point, normal) for lights in (tree, flat_choice))
        exact = sum(
            irradiance_of_one(tree, index, point, normal) for index in np.flatnonzero(flat.light_probability > 0)
        )
        assert_mean(by_tree, exact, rounding=5e-3)
        assert_mean(by_power, exact, rounding=5e-3)
        gains.append(by_power.var() / by_tree.var())
    assert min(gains) > 2.0, gains


def irradiance_of_one(lights, index: int, point, normal, count: int = 500) -> float:
    rng = np.random.default_rng(index)
    points = np.tile(point, (count, 1))
    sample = lights.sample(np.full(count, index), np.ones(count), points, rng.random((count, 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        value = sample.radiance[:, 0] * np.maximum(sample.direction @ normal, 0) / sample.pdf
    return float(np.where(sample.pdf > 0, value, 0).mean())


def test_hits_and_samples_state_one_density():
    """MIS rests on it: the probability of an emissive triangle is the same from both sides."""
    scene = scenes.many_lights_scene()
    lights = lights_of(scene)
    rng = np.random.default_rng(3)
    points, normals = rng.uniform(-1, 1, (COUNT, 3)), np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    light, probability = lights.choose(rng.random((COUNT, 2)), points, normals)
    chosen = np.flatnonzero((probability > 0) & (lights.kind[light] == TRIANGLE))
    assert len(chosen) > 100
    again = lights.choice_probability(light[chosen], points[chosen], normals[chosen])
    np.testing.assert_allclose(again, probability[chosen])
