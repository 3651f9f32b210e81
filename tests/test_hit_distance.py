# SPDX-License-Identifier: Apache-2.0
"""Image "hit_distance" of stage "path", on every device, against distances worked out here."""

import dataclasses

import numpy as np

from svgf.scene import Material, World

from . import scenes
from .tracing import pixels, rays, trace

# Just too rough to be a mirror: its rays leave within a thousandth or so of the mirrored direction.
SHINY = Material("shiny", base_color=(0.9, 0.9, 0.9), metallic=1.0, roughness=0.033)
HEIGHT_OF_CEILING = 2.0
VIEW = scenes.camera((0.3, -1.5, 1.0), (0, 0, 0), half_width=0.3)


def shiny_floor(*above):
    floor = (scenes.quad(4.0), scenes.transform(), [SHINY])
    return scenes.build([floor, *above], VIEW, world=World((1.0, 1.0, 1.0)))


def mirrored_slope(scene) -> np.ndarray:
    """Cosine of the mirrored rays with the floor's normal."""
    direction = rays(scene.camera, *pixels())
    return -direction[..., 2] / np.linalg.norm(direction, axis=-1)


def test_distance_to_a_ceiling(device):
    ceiling = (scenes.quad(400.0), scenes.transform((0, 0, HEIGHT_OF_CEILING)), [scenes.WHITE])
    scene = shiny_floor(ceiling)
    images = trace(device, scene)
    seen = images["object_id"] == 1
    assert seen.all()
    expected = HEIGHT_OF_CEILING / mirrored_slope(scene)
    ratio = images["hit_distance"] / expected
    # GGX has a long tail.
    assert np.quantile(np.abs(np.log(ratio)), 0.95) < 0.03 and abs(np.median(ratio) - 1) < 1e-3


def test_the_world_is_as_far_as_the_background(device):
    images = trace(device, shiny_floor())
    assert (images["hit_distance"] == np.float32(1e10)).all()


def test_what_lets_the_ray_straight_through_is_not_what_it_hits(device):
    glass = (scenes.quad(400.0), scenes.transform((0, 0, 1.0)), [Material("none", alpha=0.0)])
    scene = shiny_floor(glass)
    images = trace(device, scene)
    seen = images["object_id"] == 1
    assert (images["hit_distance"][seen] == np.float32(1e10)).all() and seen.any()


def test_paths_that_leave_by_a_diffuse_lobe_have_none(device):
    scene = scenes.device_scenes()["box"]
    images = trace(device, scene, samples=1)
    assert (images["hit_distance"] >= 0.0).all()
    only_diffuse = images["specular_albedo"].max(axis=2) == 0.0
    assert only_diffuse.any() and not images["hit_distance"][only_diffuse].any()


def test_plastic_has_it_as_often_as_it_mirrors(device):
    """The lobe is chosen by its albedo, so that is the share of pixels with a distance, four deviations allowed."""
    plastic = Material("plastic", base_color=(0.8, 0.8, 0.8), roughness=0.2)
    images = trace(device, dataclasses.replace(shiny_floor(), materials=(plastic,)))
    chance = images["specular_albedo"][..., 0] / (images["specular_albedo"] + images["diffuse_albedo"])[..., 0]
    found = (images["hit_distance"] > 0.0).sum()
    assert abs(found - chance.sum()) < 4 * np.sqrt((chance * (1 - chance)).sum())


def test_there_is_none_without_specular_surfaces(device):
    scene = dataclasses.replace(shiny_floor(), materials=(scenes.WHITE,))
    assert "hit_distance" not in trace(device, scene)
