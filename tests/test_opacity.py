# SPDX-License-Identifier: Apache-2.0
"""Surfaces that rays pass are found in whatever order: every one counts once, and what is known of a triangle's opacity
beforehand changes nothing."""

import dataclasses

import numpy as np
import pytest

from svgf.devices import open_device
from svgf.light_paths import LightPaths
from svgf.scene import Extension, Interpolation, LightKind, Material, RenderDefaults, Texture, TextureMap, World

from . import scenes
from .tracing import radiance, trace

PANE = Material("pane", base_color=(0.0, 0.0, 0.0), alpha=0.4, specular_ior_level=0.0)


def sheet(cells: int, size: float = 2.0, uv_range=(0.0, 1.0)):
    """A square of 2 x cells x cells triangles."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1)))
    points = np.stack([x, y], axis=1)
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    corners = np.stack([first, first + 1, first + cells + 2, first, first + cells + 2, first + cells + 1], axis=1)
    triangles = corners.reshape(-1, 3)
    positions = np.concatenate([(points - 0.5) * size, np.zeros((len(points), 1))], axis=1)
    uvs = uv_range[0] + points * (uv_range[1] - uv_range[0])
    return scenes.mesh(positions, triangles, uvs=uvs[triangles])


def blotches(**changes) -> Texture:
    """Alpha 0, 1 and in between, in areas of several texels."""
    rng = np.random.default_rng(3)
    alpha = np.repeat(np.repeat(rng.choice([0, 0, 90, 255, 255], size=(8, 8)), 4, axis=0), 4, axis=1)
    pixels = np.full((32, 32, 4), 200, dtype=np.uint8)
    pixels[..., 3] = alpha
    return Texture("blotches", pixels, False, **changes)


@pytest.mark.parametrize("cells", [24, 1], ids=["small triangles", "parts of large ones"])
@pytest.mark.parametrize("extension", Extension)
@pytest.mark.parametrize("interpolation", Interpolation)
def test_what_is_of_one_opacity_is_as_any_other(device, interpolation, extension, cells):
    """A sheet of triangles of which most, or most parts, are opaque or clear all over, before a floor that it shadows:
    each pixel sees what the reference sees, which looks at every point."""
    if device.name == "reference":
        pytest.skip("it is what the others are compared with")
    leaves = Material("leaves", base_color=(0.2, 0.7, 0.3), specular_ior_level=0.0, maps={"alpha": TextureMap(0, 3)})
    scene = scenes.build(
        [
            (scenes.quad(6.0), scenes.transform((0, 0, -1)), [scenes.WHITE]),
            (sheet(cells, uv_range=(-0.3, 1.4)), scenes.transform(), [leaves]),
        ],
        scenes.camera((0.3, -1.0, 3.0), (0, 0, 0)),
        [scenes.lamp(LightKind.SUN, eye=(0.5, 0.3, 2), size=(0.0, 0.0))],
        textures=[blotches(interpolation=interpolation, extension=extension)],
    )
    expected, images = (trace(d, scene, bounces=1) for d in (open_device("reference"), device))
    np.testing.assert_array_equal(images["object_id"], expected["object_id"])
    assert 0.05 < (images["object_id"] == 2).mean() < 0.9
    np.testing.assert_allclose(radiance(images), radiance(expected), rtol=1e-3, atol=1e-4)


def test_a_ray_through_an_edge_passes_one_triangle(device):
    """Straight up from the points of a floor, through the diagonals of two panes."""
    panes = [(sheet(cells, 4.0), scenes.transform((0, 0, 2.0 + cells)), [PANE]) for cells in (1, 4)]
    sun = scenes.lamp(LightKind.SUN, eye=(0, 0, 9), target=(0, 0, 0), size=(0.0, 0.0))
    view = scenes.camera((0, 0, 1), (0, 1e-9, 0), aspect=1.0)
    floor = (scenes.quad(4.0), scenes.transform(), [scenes.WHITE])
    scene = scenes.orthographic(scenes.build([floor, *panes], view, [sun]))
    images = trace(device, scene, 32, 32, bounces=0)
    np.testing.assert_allclose(radiance(images)[..., 0], sun.power[0] * 0.8 / np.pi * 0.6**2, rtol=1e-5)


def test_overlapping_panes_all_count(device):
    """Four panes at the very same place are four."""
    panes = [(sheet(1 + i, 4.0), scenes.transform((0, 0, 2.0)), [PANE]) for i in range(4)]
    sun = scenes.lamp(LightKind.SUN, eye=(0.1, 0.2, 9), target=(0, 0, 0), size=(0.0, 0.0))
    floor = (scenes.quad(3.0), scenes.transform(), [scenes.WHITE])
    scene = scenes.build([floor, *panes], scenes.camera((0, -0.9, 0.5), (0, 0, 0)), [sun])
    images = trace(device, scene, bounces=0)
    floor = images["object_id"] == 1
    assert floor.mean() > 0.5
    cosine = sun.light_to_world[2, 2]
    expected = sun.power[0] * 0.8 / np.pi * cosine * 0.6**4
    np.testing.assert_allclose(radiance(images)[floor][:, 0], expected, rtol=1e-4)


@pytest.mark.parametrize("limit", [0, 1, 3, 8])
def test_limits_count_what_lies_before_the_hit(device, limit):
    """A stack of clear panes, a lamp-lit wall, and more panes behind it, which must not count."""
    clear = dataclasses.replace(PANE, alpha=0.0)
    glow = Material("glow", emission=(1.0, 1.0, 1.0), base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0)
    for before in (0, 1, 3, 4):
        places = [*(1.0 + 0.1 * i for i in range(before)), *(-1.0 - 0.1 * i for i in range(6))]
        objects = [(sheet(3, 8.0), scenes.transform((0, 0, z)), [clear]) for z in places]
        objects.append((sheet(2, 8.0), scenes.transform(), [glow]))
        scene = scenes.build(objects, scenes.camera((0, 0.01, 3), (0, 0, 0)), world=World((5.0, 5.0, 5.0)))
        defaults = RenderDefaults(light_paths=LightPaths(transparent_bounces=limit))
        light = radiance(trace(device, dataclasses.replace(scene, defaults=defaults), 8, 5, bounces=1))
        np.testing.assert_allclose(light, 1.0 if before <= max(limit, 1) else 0.0, atol=1e-6)
