# SPDX-License-Identifier: Apache-2.0
"""Objects that stand still share a tree: whatever moves, changes, comes or goes, rays find what brute force finds."""

import dataclasses
from dataclasses import astuple

import numpy as np
import pytest

from svgf.flatten import flatten
from svgf.renderer import SceneUploader
from svgf.scene import LightKind, RayVisibility

from . import scenes
from .test_cast import brute_force, cast

RAYS = 3000


def heap(seed: int, count: int = 60):
    """Triangles that fill a ball."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) * 0.8 + rng.normal(size=(count, 3, 3)) * 0.3
    return scenes.mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


HEAPS = [heap(seed) for seed in range(5)]


def placed(seed: int, shift=(0.0, 0.0, 0.0)):
    rng = np.random.default_rng(100 + seed)
    turn = scenes.rotation("x", rng.uniform(0, 6)) @ scenes.rotation("z", rng.uniform(0, 6))
    return scenes.transform(rng.normal(size=3) * 0.3 + shift, turn @ np.diag(rng.uniform(0.5, 2, 3)))


def scene_of(heaps, shifts):
    objects = [(HEAPS[i], placed(i, shift), [scenes.WHITE]) for i, shift in zip(heaps, shifts)]
    return scenes.build(objects, scenes.camera((0, -8, 0), (0, 0, 0)))


def rays(flat) -> np.ndarray:
    rng = np.random.default_rng(7)
    origin, target = rng.normal(size=(2, RAYS, 3)) * 1.5 - flat.origin
    ends = np.broadcast_to([0.0, np.inf], (RAYS, 2))
    return np.concatenate([origin, target - origin, ends], axis=1).astype(np.float32)[None]


def check(device, tracer, flat) -> None:
    """Rays that pass within rounding of an edge may go to either side: at most 1 in 500."""
    distance, instance, triangle = brute_force(flat, rays(flat))
    images = cast(device, tracer, rays(flat), False)
    same = (images["instance"][0] == instance) & (images["triangle"][0] == triangle)
    found = np.isfinite(distance)
    assert 0.3 < found.mean() < 0.99
    assert same.mean() >= 0.998
    np.testing.assert_allclose(images["distance"][0][same & found], distance[same & found], rtol=1e-4, atol=2e-5)
    occluded = cast(device, tracer, rays(flat), True)["occluded"][0]
    assert (occluded == found).mean() >= 0.998


@pytest.fixture
def uploader(device):
    return SceneUploader(device, device.tracer())


HERE, ASIDE = (0.0, 0.0, 0.0), (0.4, -0.3, 0.2)
STEPS = {
    "still": [((0, 1, 2, 3), [HERE] * 4)],
    "one moves": [((0, 1, 2, 3), [HERE] * 4), ((0, 1, 2, 3), [HERE, ASIDE, HERE, HERE])],
    "one moves and comes back": [
        ((0, 1, 2, 3), [HERE] * 4),
        ((0, 1, 2, 3), [HERE, ASIDE, HERE, HERE]),
        ((0, 1, 2, 3), [HERE] * 4),
    ],
    "all move": [((0, 1, 2), [HERE] * 3), ((0, 1, 2), [ASIDE] * 3), ((0, 1, 2), [ASIDE] * 3)],
    "one goes, others change places": [((0, 1, 2, 3), [HERE] * 4), ((3, 0, 2), [HERE] * 3)],
    "one comes": [((0, 1, 2), [HERE] * 3), ((4, 0, 1, 2), [HERE] * 4)],
    "one is there twice": [((0, 1, 2), [HERE] * 3), ((0, 1, 2, 1), [HERE, HERE, HERE, ASIDE])],
    "all are others": [((0, 1), [HERE] * 2), ((2, 3, 4), [HERE] * 3), ((2, 3, 4), [ASIDE, HERE, HERE])],
}


@pytest.mark.parametrize("steps", STEPS.values(), ids=STEPS)
def test_rays_find_what_brute_force_finds(device, uploader, steps):
    for heaps, shifts in steps:
        flat = flatten(scene_of(heaps, shifts))
        uploader.upload(flat)
        check(device, uploader._tracer, flat)


def test_one_is_hidden_from_a_kind_of_rays(device, uploader):
    """What not all rays see stays out of the common tree, whose rays do not ask."""
    scene = scene_of((0, 1, 2), [HERE] * 3)
    visibility = np.array([RayVisibility.ALL, RayVisibility.ALL & ~RayVisibility.SHADOW, RayVisibility.ALL], np.uint8)
    flat = flatten(dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=visibility)))
    uploader.upload(flat)
    check(device, uploader._tracer, flat)


def picture(device, shown) -> dict[str, np.ndarray]:
    """Of the last of some scenes that are shown one after the other."""
    tracer = device.tracer()
    uploader = SceneUploader(device, tracer)
    for scene in shown:
        flat = flatten(scene)
        uploader.upload(flat)
    images = tracer.trace(
        width=64,
        height=36,
        sample=0,
        samples=4,
        seed=1,
        bounces=1,
        pixel_filter="center",
        signals="diffuse_specular",
        effects=int(flat.effects),
        light_paths=astuple(scene.defaults.light_paths),
    )
    return {name: device.to_numpy(image) for name, image in images.items()}


def test_what_becomes_sheer_is_passed_once(device):
    """Parts of a triangle are as many surfaces on the way of a ray, which only what stops it may be."""
    objects = [(HEAPS[i], placed(i), [scenes.WHITE]) for i in range(3)]
    solid = scenes.build(objects, scenes.camera((0, -8, 0), (0, 0, 0)), [scenes.lamp(LightKind.SUN)])
    sheer = dataclasses.replace(solid, materials=tuple(dataclasses.replace(m, alpha=0.4) for m in solid.materials))
    known, afterwards, opaque = (picture(device, shown) for shown in ([sheer], [solid, sheer], [solid]))
    assert np.abs(known["diffuse"] - opaque["diffuse"]).max() > 0.1
    for name in known:
        np.testing.assert_allclose(afterwards[name], known[name], rtol=1e-5, atol=1e-6, err_msg=name)
