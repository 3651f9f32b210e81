# SPDX-License-Identifier: Apache-2.0
"""Lights without size, without end and of any strength, against what they must give in closed form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from svgf.scene import LightKind, Material, MaterialKind, World

from .. import scenes
from ..statistical import assert_mean
from ..tracing import radiance, trace

SIZE = (24, 14)
ALBEDO = 0.8  # of scenes.WHITE


def floor_under(*lights, extra=(), **changes):
    """A white floor that fills the image."""
    floor = (scenes.quad(4.0), scenes.transform(), [scenes.WHITE])
    view = scenes.camera((0, 0, 1.5), (0, 1e-3, 0), half_width=0.3)
    return scenes.build([floor, *extra], view, lights, **changes)


def light_of(device, scene, **settings):
    """[n, 3], finite and never negative."""
    pixels = radiance(trace(device, scene, *SIZE, **settings)).reshape(-1, 3)
    assert np.isfinite(pixels).all() and (pixels >= 0).all()
    return pixels


@pytest.mark.parametrize("irradiance", [1e-6, 1.0, 1e6, 1e12])
def test_a_sun_of_any_strength(device, irradiance):
    """The floor shines with E cos(angle) albedo / pi: every sample, as such a sun has no size."""
    sun = scenes.lamp(LightKind.SUN, eye=(0, -3, 4), size=(0.0, 0.0))
    sun = dataclasses.replace(sun, power=(irradiance,) * 3)
    np.testing.assert_allclose(light_of(device, floor_under(sun)), irradiance * 0.8 * ALBEDO / np.pi, rtol=1e-5)


def test_a_lamp_that_is_larger_than_the_scene_is_a_sky(device):
    """10 km of lamp a metre above the floor: radiance power / (pi area) from everywhere."""
    size = 1e4
    lamp = scenes.lamp(LightKind.RECTANGLE, eye=(0, 0, 1), target=(0, 1e-6, 0), size=(size, size))
    lamp = dataclasses.replace(lamp, power=(np.pi * size**2,) * 3)
    assert_mean(light_of(device, floor_under(lamp), samples=16)[:, 0], ALBEDO, 1e-5, rounding=2e-3)


@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.SPOT])
def test_a_lamp_of_a_micrometre_is_a_point(device, kind):
    tiny, point = (light_of(device, floor_under(scenes.lamp(kind, size=(size, 0.0)))) for size in (1e-6, 0.0))
    assert point.max() > 0
    np.testing.assert_allclose(tiny, point, rtol=1e-4)


def glowing(power: float, size: float, height: float):
    """A square that shines downwards as well as upwards with this power each."""
    glow = Material(
        "glow", kind=MaterialKind.DIFFUSE, base_color=(0.0, 0.0, 0.0), emission=(power / (np.pi * size**2),) * 3
    )
    return scenes.quad(size), scenes.transform((0, 0, height)), [glow]


@pytest.mark.parametrize("size", [1e-5, 1e-2])
def test_a_small_mesh_light_of_a_megawatt(device, size):
    """Straight below it the floor gets intensity / height^2, of intensity power / pi."""
    scene = floor_under(extra=[glowing(1e6, size, 2.0)])
    view = scenes.camera((0, 0, 1.5), (0, 1e-6, 0), half_width=1e-3)
    scene = dataclasses.replace(scene, camera=view, previous_camera=view)
    expected = 1e6 / np.pi / 2.0**2 * ALBEDO / np.pi
    np.testing.assert_allclose(light_of(device, scene, samples=4), expected, rtol=2e-4)


def test_emissive_triangles_without_area_shine_on_nothing(device):
    """The picture is that of the light beside them."""
    light = glowing(10.0, 0.5, 2.0)
    positions = np.array([(0, 0, 1), (0, 0, 1), (0, 0, 1), (-1, 0, 1), (0, 0, 1), (1, 0, 1)], np.float32)
    flat = scenes.mesh(positions, np.arange(6).reshape(2, 3), name="flat"), scenes.transform(), light[2]
    alone, beside = (light_of(device, floor_under(extra=extra)) for extra in ([light], [light, flat]))
    assert alone.max() > 0
    np.testing.assert_allclose(beside, alone, rtol=1e-5)


@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.RECTANGLE])
def test_a_lamp_on_the_floor_itself(device, kind):
    """Its whole half above the floor is in the plane of the floor or above it: finite, whichever way it rounds."""
    light_of(device, floor_under(scenes.lamp(kind, eye=(0, 0, 0), target=(0, 1e-3, -1))), samples=4)


def test_a_box_keeps_the_light_of_its_inside(device):
    """Suns shine through no floor, and a lamp within a ball lights nothing outside of it."""
    ball = (scenes.sphere(0.3, rows=8), scenes.transform((0, 0, 0.6)), [scenes.WHITE])
    inside = scenes.lamp(LightKind.POINT, eye=(0, 0, 0.6), power=(1e9,) * 3, size=(0.01, 0.0))
    below = scenes.lamp(LightKind.SUN, eye=(0, 0.1, -4), size=(0.0, 0.0))
    assert light_of(device, floor_under(inside, below, extra=[ball], world=World()), samples=4).max() == 0
