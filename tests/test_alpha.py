# SPDX-License-Identifier: Apache-2.0
"""What lets light straight through, on every device: what is seen through it, and its shadows."""

import dataclasses

import numpy as np
import pytest

from svgf.light_paths import LightPaths
from svgf.scene import LightKind, Material, MaterialKind, RenderDefaults

from . import scenes
from .material_cases import curtain
from .statistical import assert_mean
from .tracing import radiance, trace

BLACK = Material("black", base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0)


@pytest.mark.parametrize("planes", [1, 3])
@pytest.mark.parametrize("alpha", [0.25, 0.8])
def test_what_lies_behind_is_seen_by_its_share(device, planes, alpha):
    """Black planes of this alpha before a wall of radiance 1: (1 - alpha)^n of it."""
    images = trace(device, curtain(planes, dataclasses.replace(BLACK, alpha=alpha)), 32, 18, bounces=0, samples=16)
    assert_mean(radiance(images)[..., 0], (1 - alpha) ** planes, rounding=1e-5)


def test_transparent_tints_without_noise(device):
    film = Material("film", kind=MaterialKind.TRANSPARENT, base_color=(0.9, 0.5, 0.2))
    images = trace(device, curtain(3, film), 16, 9, bounces=0)
    np.testing.assert_allclose(
        radiance(images), np.broadcast_to(np.array((0.9, 0.5, 0.2)) ** 3, images["emission"].shape), rtol=1e-5
    )
    # The G-buffer shows what is behind them.
    assert (images["object_id"] == 4).all()


def test_a_sum_with_transparent_adds_the_surface(device):
    """Blender's idiom: a shining film that hides nothing."""
    film = Material("film", kind=MaterialKind.TRANSPARENT, base_color=(1.0, 1.0, 1.0))
    glow = Material("glow", kind=MaterialKind.DIFFUSE, base_color=(0.0, 0.0, 0.0), emission=(0.5, 0.5, 0.5))
    scene = curtain(1, BLACK)
    both = Material("both", kind=MaterialKind.ADD, first=2, second=3)
    scene = dataclasses.replace(scene, materials=(both, scene.materials[1], film, glow))
    images = trace(device, scene, 16, 9, samples=64)
    assert_mean(radiance(images)[..., 0], 1.5, rounding=1e-4)


def test_shadows_of_alpha_are_shares(device):
    """A sun through sheets on a floor: light times the product of what they let pass, without noise."""
    film = Material("film", kind=MaterialKind.TRANSPARENT, base_color=(0.5, 0.5, 0.5))
    sheets = [dataclasses.replace(BLACK, alpha=0.4), film]
    sun = scenes.lamp(LightKind.SUN, eye=(0, 0, 5), size=(0.0, 0.0))
    objects = [(scenes.quad(4.0), scenes.transform(), [scenes.WHITE])]
    objects += [(scenes.quad(8.0), scenes.transform((0, 0, 2.0 + i)), [sheet]) for i, sheet in enumerate(sheets)]
    scene = scenes.build(objects, scenes.camera((0, -1.0, 0.5), (0, 0, 0)), [sun])
    images = trace(device, scene, 32, 18, bounces=0)
    floor = images["object_id"] == 1
    assert floor.mean() > 0.5
    np.testing.assert_allclose(
        radiance(images)[floor], np.tile(np.array(sun.power) * 0.8 / np.pi * 0.6 * 0.5, (floor.sum(), 1)), rtol=1e-4
    )


@pytest.mark.parametrize("alpha", [0.0, 0.03, 0.5, 1.0])
def test_64_planes(device, alpha):
    """Finite, not negative and no more than there is, for a material that reflects, through more planes than Cycles'
    default allows."""
    plastic = Material("plastic", base_color=(1.0, 1.0, 1.0), alpha=alpha)
    images = trace(device, curtain(64, plastic, emission=1.0), 8, 5, bounces=2)
    for image in images.values():
        assert np.isfinite(image).all()
    light = radiance(images)
    assert light.min() >= 0
    if alpha == 0.0:
        np.testing.assert_allclose(light, 1.0, rtol=1e-4)
        assert (images["object_id"] == 65).all()


def test_transparent_bounces_end_as_in_cycles(device):
    """After as many as are allowed, the next surface only shines. Seen in Cycles 5.0 for limits of 0, 1 and 4."""
    film = Material("film", kind=MaterialKind.TRANSPARENT, base_color=(1.0, 1.0, 1.0))
    for limit, planes, seen in ((4, 3, 1.0), (4, 4, 1.0), (4, 5, 0.0), (0, 1, 1.0), (0, 2, 0.0)):
        scene = curtain(planes, film)
        defaults = RenderDefaults(light_paths=LightPaths(transparent_bounces=limit))
        light = radiance(trace(device, dataclasses.replace(scene, defaults=defaults), 8, 5))
        np.testing.assert_allclose(light, seen, atol=1e-6)
