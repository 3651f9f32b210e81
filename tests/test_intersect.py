# SPDX-License-Identifier: Apache-2.0
"""Rays against triangles: the reference against brute force, and what every device must never let through."""

import dataclasses

import numpy as np
import pytest

from svgf.reference.intersect import Hierarchy, intersect_triangles
from svgf.scene import Material, World

from . import scenes
from .tracing import radiance, trace


def moeller_trumbore(origin, direction, corners) -> tuple[float, int]:
    """Nearest t and triangle, one ray, in the textbook way."""
    nearest, which = np.inf, -1
    for index, (a, b, c) in enumerate(corners):
        matrix = np.stack([b - a, c - a, -direction], axis=1)
        if abs(np.linalg.det(matrix)) < 1e-14:
            continue
        u, v, t = np.linalg.solve(matrix, origin - a)
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < t < nearest:
            nearest, which = t, index
    return nearest, which


def test_hierarchy_finds_what_brute_force_finds():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(57, 1, 3)) + 0.8 * rng.normal(size=(57, 3, 3))
    hierarchy = Hierarchy(corners.min(axis=1), corners.max(axis=1), leaf_size=4)
    origin, direction = rng.normal(size=(200, 3)) * 2, rng.normal(size=(200, 3))
    direction[:20, 0] = 0.0  # along the sides of boxes
    direction[:10, 1] = 0.0
    ray, primitive = hierarchy.candidates(origin, direction, np.full(200, np.inf))
    t, weights = intersect_triangles(origin[ray], direction[ray], corners[primitive])
    hits = 0
    for i in range(200):
        expected, which = moeller_trumbore(origin[i], direction[i], corners)
        mine = np.flatnonzero((ray == i) & (t > 0))
        best = mine[np.argmin(t[mine])] if len(mine) else None
        found = np.inf if best is None else t[best]
        assert found == pytest.approx(expected, rel=1e-9)
        if np.isfinite(expected):
            hits += 1
            assert primitive[best] == which
            np.testing.assert_allclose(weights[best] @ corners[which], origin[i] + expected * direction[i], atol=1e-9)
    assert 30 < hits < 170


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9, 100])
def test_hierarchy_holds_every_primitive(count):
    points = np.random.default_rng(count).random((count, 3))
    hierarchy = Hierarchy(points, points + 0.01, leaf_size=4)
    assert set(hierarchy.leaves.ravel()) == set(range(count))


def test_empty_hierarchy():
    ray, primitive = Hierarchy(np.zeros((0, 3)), np.zeros((0, 3)), 4).candidates(
        np.zeros((1, 3)), np.ones((1, 3)), np.ones(1)
    )
    assert not len(ray) and not len(primitive)


def test_rays_through_edges_and_vertices_hit_one_of_the_triangles():
    """Watertight: aimed exactly at shared edges and vertices of a fan, no ray slips through."""
    rng = np.random.default_rng(1)
    rim = np.stack([np.cos(np.arange(7) * 0.9), np.sin(np.arange(7) * 0.9), 0.1 * rng.random(7)], axis=1)
    centre = np.array([0.01, 0.02, 0.05])
    corners = np.stack([np.stack([centre, rim[i], rim[(i + 1) % 7]]) for i in range(7)])
    origin = rng.normal(size=(500, 3)) + (0, 0, 5)
    along = rng.random((500, 1))
    target = np.where(along < 0.1, centre, centre + along * 0.9 * (rim[rng.integers(0, 7, 500)] - centre))
    t = np.stack([intersect_triangles(origin, target - origin, np.broadcast_to(c, (500, 3, 3)))[0] for c in corners])
    assert np.isfinite(t).any(axis=0).all()


def test_closed_shapes_have_no_holes(device):
    """From within a closed black shape nothing of a bright world is ever seen, directly or over mirrors."""
    for shape, slots in ((scenes.sphere(1.0, rows=9), 1), (scenes.cube(2.0, inwards=True), 6)):
        mirror = Material("mirror", base_color=(1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
        placement = scenes.transform((0.1, 0, 0), scenes.rotation("x", 0.4) @ np.diag([1.0, 2.0, 0.7]))
        scene = scenes.build(
            [(shape, placement, [mirror] * slots)],
            scenes.camera((0.1, 0.2, 0.0), (1, 0.3, 0.2), half_width=2.0),
            world=World((1e6, 1e6, 1e6)),
        )
        images = trace(device, scene, bounces=8)
        assert (images["first_object_id"] == 1).all()
        assert not radiance(images).any()


def test_far_and_small_surfaces_do_not_shadow_themselves(device):
    """A convex shape under a lamp is lit wherever it faces it, at any size and place."""
    for scale in (1e-3, 1.0, 1e4):
        for offset in (0.0, 1e5 * scale):
            ball = scenes.sphere(scale, rows=12, smooth=False)
            view = scenes.camera((0, -3 * scale, 3 * scale), (0, 0, 0), clip=(1e-3 * scale, 1e3 * scale))
            sun = scenes.lamp(scenes.LightKind.SUN, eye=(0, -3, 3), target=(0, 0, 0), size=(0.0, 0.0))
            scene = scenes.build([(ball, scenes.transform(), [scenes.WHITE])], view, [sun])
            images = trace(device, scenes.move(scene, (offset, offset, 0)), bounces=0)
            facing = images["normal"] @ sun.light_to_world[:, 2]
            lit = images["diffuse"][..., 0]
            clear = (images["object_id"] == 1) & (facing > 0.01)
            np.testing.assert_allclose(lit[clear], facing[clear] * 0.8 / np.pi * sun.power[0], rtol=1e-3)


def test_degenerate_and_broken_triangles_are_never_hit(device):
    good = scenes.quad(2.0)
    positions = np.concatenate([good.positions, [(np.nan, 0, 0), (np.inf, 1, 0), (0, 0, 0.5), (1, 0, 0.5)]]).astype(
        np.float32
    )
    triangles = np.concatenate([good.triangles, [(0, 1, 4), (0, 5, 1), (6, 7, 7), (6, 6, 6), (0, 2, 0)]]).astype(
        np.int32
    )
    broken = scenes.mesh(positions, triangles)
    view = scenes.camera((0.2, -2, 2), (0, 0, 0))
    plain, other = (
        trace(
            device,
            scenes.build([(shape, scenes.transform(), [scenes.WHITE])], view, [scenes.lamp(scenes.LightKind.SUN)]),
        )
        for shape in (scenes.mesh(good.positions, good.triangles), broken)
    )
    np.testing.assert_array_equal(plain["object_id"], other["object_id"])
    np.testing.assert_allclose(plain["depth"], other["depth"], rtol=1e-6)
    np.testing.assert_allclose(plain["diffuse"], other["diffuse"], rtol=1e-4, atol=1e-6)


def test_clip_distances_are_planar_and_the_camera_s_alone(device):
    """Beyond them there is nothing to see, but it casts its shadow."""
    scene = scenes.textured_scene()
    near, far = 3.2, 4.0
    whole = trace(device, scene)
    clipped = trace(device, dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, clip=(near, far))))
    inside = (whole["depth"] > near) & (whole["depth"] < far)
    sure = np.abs(whole["depth"] - near) + np.abs(whole["depth"] - far) > 1e-3
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal((clipped["object_id"] > 0)[sure], inside[sure])
    np.testing.assert_array_equal(clipped["depth"][inside], whole["depth"][inside])


def test_nearest_of_many_instances(device):
    """A row of quads behind each other, listed in a random order: the one in front is seen."""
    order = np.random.default_rng(5).permutation(20)
    quad = scenes.quad(4.0)
    objects = [(quad, scenes.transform((0, 0, -float(depth))), [scenes.WHITE]) for depth in order]
    images = trace(device, scenes.build(objects, scenes.camera((0, 0.001, 3), (0, 0, 0))))
    assert (images["object_id"] == 1 + int(np.argmin(order))).all()
