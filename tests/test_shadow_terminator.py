# SPDX-License-Identifier: Apache-2.0
"""Rays to lights from coarse meshes with smooth normals, against the surfaces that the normals describe."""

import dataclasses

import numpy as np
import pytest

from svgf.devices import open_device
from svgf.reference.shadow_terminator import patch_heights, terminator_share
from svgf.scene import Light, LightKind

from . import scenes
from .tracing import radiance, trace

TO_SUN = np.array([0.96, -0.28, 0.0])
SUN = Light("sun", LightKind.SUN, (3.0, 2.0, 1.0), scenes.look_at(TO_SUN, (0, 0, 0)), (0.0, 0.0))
BALL = scenes.sphere(1.0, rows=4)


def lit(objects, view=None, lamps=(SUN,)):
    return scenes.build(objects, view or scenes.camera((0, -4, 0), (0, 0, 0), half_width=0.7), lamps)


def patches(edge: float) -> tuple[np.ndarray, ...]:
    """Triangles of a unit sphere with edges of about this length, and points of them: corners, weights, points."""
    random = np.random.default_rng(3)
    corners = random.normal(size=(2000, 1, 3))
    corners = corners / np.linalg.norm(corners, axis=2, keepdims=True) + edge * random.uniform(-0.7, 0.7, (2000, 3, 3))
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    weights = random.dirichlet((1, 1, 1), 2000)
    return corners, weights, np.einsum("nc,nci->ni", weights, corners)


def test_the_patch_lies_on_a_sphere_or_close_above_it():
    """By as much as its tangent planes do, which is of second order, as is the distance to the triangle below it."""
    above = []
    for edge in (0.2, 0.1):
        corners, weights, points = patches(edge)
        heights = patch_heights(corners, corners, weights, points)
        # On a sphere the interpolated normal is the point itself.
        radius = np.linalg.norm(points * (1 + heights[:, None]), axis=1)
        assert (radius > 1 - edge**4).all()
        above.append(radius.max() - 1)
        assert np.linalg.norm(points, axis=1).min() < 1 - 0.05 * edge**2
    assert 3.5 < above[0] / above[1] < 4.5


def test_the_patch_passes_through_the_corners():
    corners, _, _ = patches(0.3)
    for corner in range(3):
        heights = patch_heights(corners, corners, np.eye(3)[[corner] * len(corners)], corners[:, corner])
        np.testing.assert_allclose(heights, 0.0, atol=1e-15)


def test_the_patch_does_not_depend_on_the_order_of_corners():
    corners, weights, points = patches(0.4)
    normals = corners + 0.3 * np.random.default_rng(1).normal(size=corners.shape)
    heights = patch_heights(corners, normals, weights, points)
    assert heights.min() >= 0.0 and heights.max() > 0.01
    for order in ([1, 2, 0], [1, 0, 2]):
        other = patch_heights(corners[:, order], normals[:, order], weights[:, order], points)
        np.testing.assert_allclose(other, heights, atol=1e-14)


def test_share_grows_towards_the_horizon_without_a_step():
    """Nothing where light is well above both horizons, all of it where it is below the triangle's."""
    smooth, geometric = np.meshgrid(np.linspace(0, 1, 201), np.linspace(-1, 1, 401))
    share = terminator_share(smooth, geometric, np.float64(0.2))
    assert share.min() == 0.0 and share.max() == 1.0
    assert (share[geometric <= 0] == 1.0).all() and not share[(smooth >= 0.2) & (geometric >= 0.2)].any()
    assert np.abs(np.diff(share, axis=0)).max() <= 0.025 + 1e-12
    assert np.abs(np.diff(share, axis=1)).max() <= 0.025 + 1e-12


PLACEMENTS = {
    "as it is": scenes.transform(),
    "mirrored": scenes.transform(linear=np.diag([-1.0, 1.0, 1.0])),
    "stretched": scenes.transform(linear=scenes.rotation("y", 0.4) @ np.diag([0.9, 0.7, 0.4])),
}


@pytest.mark.parametrize("offset", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_convex_mesh_is_lit_as_its_normals_say(device, placement, offset):
    """Nothing of an ellipsoid is in its own shadow where its normals face the sun; many of its triangles do not."""
    scene = lit([(BALL, PLACEMENTS[placement], [scenes.WHITE])])
    images = trace(device, scenes.with_terminator_offset(scene, offset), bounces=0)
    seen = images["object_id"] > 0
    expected = 0.8 / np.pi * np.maximum(images["normal"] @ TO_SUN, 0.0)[..., None] * SUN.power
    np.testing.assert_allclose(radiance(images)[seen], expected[seen], rtol=1e-4, atol=2e-4)
    plain = radiance(trace(device, scene, bounces=0))
    assert ((plain == 0).all(axis=2) & (expected[..., 0] > 0.01))[seen].mean() > 0.02


def assert_lit_as_its_normals_say(device, scene):
    images = trace(device, scenes.with_terminator_offset(scene, 0.1), bounces=0)
    seen = images["object_id"] > 0
    assert seen.mean() > 0.1
    expected = 0.8 / np.pi * 3.0 * np.maximum(images["normal"] @ TO_SUN, 0.0)
    np.testing.assert_allclose(radiance(images)[seen][:, 0], expected[seen], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_scale_does_not_matter(device, factor):
    placement = scenes.transform(linear=np.eye(3) * factor)
    view = scenes.camera((0, -4 * factor, 0), (0, 0, 0), half_width=0.7, clip=(0.1 * factor, 10 * factor))
    scene = lit([(BALL, placement, [scenes.WHITE])], view)
    assert_lit_as_its_normals_say(device, scene)


def test_far_from_the_origin(device):
    scene = scenes.move(lit([(BALL, scenes.transform(), [scenes.WHITE])]), (1e6, -3e5, 2e5))
    assert_lit_as_its_normals_say(device, scene)


def test_shadows_of_others_stay(device):
    """A wall between the sun and the ball."""
    wall = (scenes.quad(6.0), scenes.transform(1.5 * TO_SUN, scenes.rotation("y", np.pi / 2)), [scenes.WHITE])
    scene = lit([(BALL, scenes.transform(), [scenes.WHITE]), wall])
    images = trace(device, scenes.with_terminator_offset(scene, 1.0), bounces=0)
    ball = images["object_id"] == 1
    assert ball.mean() > 0.1 and not radiance(images)[ball].any()


def test_light_does_not_come_through_a_wall(device):
    """Its normals lean to a sun behind it: triangles are lit past their own edges, and their neighbours stop that."""
    steps = np.arange(-8, 9)
    corners = np.array([(x, y, 0) for y in steps for x in steps])
    first = (np.arange(16)[:, None] * 17 + np.arange(16)).ravel()
    triangles = np.concatenate([first[:, None] + (0, 1, 18), first[:, None] + (0, 18, 17)])
    wall = scenes.mesh(corners, triangles)
    leaning = dataclasses.replace(wall, normals=np.tile(np.float32([0.8, 0.0, 0.6]), (len(triangles), 3, 1)))
    sun = dataclasses.replace(SUN, light_to_world=scenes.look_at((0.9, 0.0, -0.3), (0, 0, 0)))
    scene = scenes.build([(leaning, scenes.transform(), [scenes.WHITE])], scenes.camera((0, 0, 3), (0, 0, 0)), [sun])
    images = trace(device, scenes.with_terminator_offset(scene, 0.5), bounces=0)
    assert (images["object_id"] > 0).all() and not radiance(images).any()


def test_meshes_without_normals_of_their_own_do_not_change(device):
    """To the bit."""
    scene = lit([(scenes.sphere(1.0, rows=4, smooth=False), scenes.transform(), [scenes.GLOSSY])])
    plain, offset = (trace(device, s) for s in (scene, scenes.with_terminator_offset(scene, 1.0)))
    for name, image in plain.items():
        np.testing.assert_array_equal(offset[name], image, err_msg=name)


def test_an_offset_is_of_one_instance(device):
    """Of two balls the first one has none."""
    placements = [scenes.transform((x, 0, 0), 0.5 * np.eye(3)) for x in (-0.7, 0.7)]
    scene = lit([(BALL, placement, [scenes.WHITE]) for placement in placements])
    view = dataclasses.replace(scene.camera, camera_to_world=scenes.look_at((0, -5, 0), (0, 0, 0)))
    scene = dataclasses.replace(scene, camera=view, previous_camera=view)
    plain = radiance(trace(device, scene, bounces=0))
    one = dataclasses.replace(scene.instances, terminator_offset=np.float32([0.0, 0.2]))
    images = trace(device, dataclasses.replace(scene, instances=one), bounces=0)
    differs = (radiance(images) != plain).any(axis=2)
    assert not differs[images["object_id"] == 1].any() and differs[images["object_id"] == 2].mean() > 0.01


@pytest.mark.parametrize("is_bent", [False, True])
def test_patches_of_any_normals_are_those_of_the_reference(device, is_bent):
    """Single triangles before a sun that is behind them: how far from its edges each is lit is how high its patch is.
    Of those that bend away from one corner, its tangent plane is the triangle, and half of the quadratic patch counts.
    """
    random = np.random.default_rng(7)
    centres = np.array([(x, y, 0) for x in range(-4, 5, 2) for y in (-2, 0, 2)])
    triangle = np.array([(-0.9, 0, 0), (0.9, -0.9, 0), (0.9, 0.9, 0)])
    normals = np.array([0.5, 0.1, 0.7]) + random.uniform(-0.6, 0.6, (len(centres), 3, 3))
    if is_bent:
        normals[:, 0] = 0, 0, 1
        normals[:, 1:] = np.array([1.0, 0.0, 0.5]) + random.uniform(0.0, 0.5, (len(centres), 1, 3)) * (1, 0, 1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    triangles = scenes.mesh((centres[:, None] + triangle).reshape(-1, 3), np.arange(3 * len(centres)).reshape(-1, 3))
    triangles = dataclasses.replace(triangles, normals=normals.astype(np.float32))
    sun = dataclasses.replace(SUN, light_to_world=scenes.look_at((0.95, 0.1, -0.1), (0, 0, 0)))
    view = scenes.camera((0, 0, 9), (0, 0, 0))
    scene = scenes.build([(triangles, scenes.transform(), [scenes.WHITE])], view, [sun])
    scene = scenes.with_terminator_offset(scene, 0.6)
    light, expected = (radiance(trace(d, scene, bounces=0)) for d in (device, open_device("reference")))
    assert 0.05 < (expected[..., 0] > 0).mean() < 0.4
    assert (np.abs(light - expected) > 1e-3 * expected + 1e-4).any(axis=2).mean() < 0.003
