# SPDX-License-Identifier: Apache-2.0
"""What float32 makes of hard scenes, against float64 and against closed forms.

The bound: one sample per pixel follows the same path, and comes out within 1e-3, in 99 % of the pixels. The others are
those where rounding moves a ray over an edge, or where it decides between surfaces that lie on each other.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from svgf.devices import open_device
from svgf.scene import Light, LightKind, Material, MaterialKind, Texture, TextureMap, World

from .. import scenes
from ..material_cases import curtain, material_scene
from ..statistical import assert_mean
from ..tracing import radiance, trace

SIZE = (48, 27)
RELATIVE, SHARE = 1e-3, 0.99
CLEAR = Material("clear", kind=MaterialKind.GLASS, base_color=(1.0, 1.0, 1.0), roughness=0.0, ior=1.5)


def lit(light: Light, **changes):
    return dataclasses.replace(scenes.lamp_scene(light), **changes)


def with_view(scene, **changes):
    view = dataclasses.replace(scene.camera, **changes)
    return dataclasses.replace(scene, camera=view, previous_camera=view)


def balls(*materials: Material):
    """Within each other."""
    objects = [
        (scenes.sphere(0.9 - 0.25 * i, rows=10), scenes.transform(), [material]) for i, material in enumerate(materials)
    ]
    return scenes.build(objects, scenes.camera((0, -3, 0.3), (0, 0, 0)), world=World((0.3, 0.4, 0.5)))


def inside_glass():
    """Seen from within a block: beyond 42 degrees its walls are mirrors."""
    block = (scenes.cube(4.0), scenes.transform(), [CLEAR] * 6)
    return scenes.build([block], scenes.camera((0.3, -1.5, 0.2), (0, 1, 0)), world=World((0.3, 0.4, 0.5)))


def grazing():
    floor = (scenes.quad(100.0), scenes.transform(), [scenes.GLOSSY])
    view = scenes.camera((0, -1, 0.02), (0, 10, 0))
    return scenes.build([floor], view, [scenes.lamp(LightKind.SUN)], world=World((0.5, 0.5, 0.5)))


def window(width: float) -> tuple[float, ...]:
    return -width, width, -width * 9 / 16, width * 9 / 16


HARD = {
    "sun of 1e6": lit(scenes.lamp(LightKind.SUN, power=(1e7, 1e7, 1e7))),
    "tiny lamp": lit(scenes.lamp(LightKind.POINT, size=(1e-6, 0.0))),
    "huge lamp": lit(scenes.lamp(LightKind.RECTANGLE, size=(1e4, 1e4), power=(1e9, 1e9, 1e9))),
    "scene within a lamp": lit(scenes.lamp(LightKind.POINT, size=(100.0, 0.0), power=(1e6, 1e6, 1e6))),
    "mirror": material_scene(Material(roughness=0.0, metallic=1.0)),
    "roughness 1e-4": material_scene(Material(roughness=1e-4, metallic=1.0)),
    "roughness 0.04": material_scene(Material(roughness=0.04, metallic=1.0)),
    "ior 1": material_scene(Material(roughness=0.3, transmission=1.0, ior=1.0)),
    "ior 1 + 1e-6": material_scene(Material(roughness=0.0, transmission=1.0, ior=1.0 + 1e-6)),
    "ior 0.7": material_scene(Material(roughness=0.1, ior=0.7)),
    "black": material_scene(Material(base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0)),
    "nested glass": balls(CLEAR, dataclasses.replace(CLEAR, ior=1.33), dataclasses.replace(CLEAR, ior=2.4)),
    "total internal reflection": inside_glass(),
    "grazing view": grazing(),
    "long lens": with_view(scenes.lamp_scene(scenes.lamp(LightKind.RECTANGLE)), window=window(1e-3)),
    "wide lens": with_view(scenes.box_scene(), window=window(50.0)),
    "64 alpha planes": curtain(64, Material(base_color=(0.5, 0.5, 0.5), alpha=0.05)),
}


@pytest.mark.parametrize("name", HARD)
def test_float32_follows_float64(device, name):
    if device.name == "reference":
        pytest.skip("the reference is what the others are compared with")
    found, expected = (trace(each, HARD[name], *SIZE) for each in (device, open_device("reference")))
    for what, image in (("radiance", radiance), ("depth", lambda images: images["depth"][..., None])):
        mine, other = image(found), image(expected)
        assert np.isfinite(mine).all(), what
        same = np.abs(mine - other) <= RELATIVE * (np.abs(other) + np.abs(other).mean())
        assert same.all(axis=-1).mean() >= SHARE, what


WHITE = {
    "diffuse": Material(kind=MaterialKind.DIFFUSE, base_color=(1.0, 1.0, 1.0)),
    "mirror": Material(metallic=1.0, base_color=(1.0, 1.0, 1.0), roughness=0.0),
    "rough metal": Material(metallic=1.0, base_color=(1.0, 1.0, 1.0), roughness=0.6),
    "clear glass": CLEAR,
    "rough glass": dataclasses.replace(CLEAR, roughness=0.5),
    "translucent": Material(kind=MaterialKind.TRANSLUCENT, base_color=(1.0, 1.0, 1.0)),
}


@pytest.mark.parametrize("name", WHITE)
def test_white_furnace(device, name):
    """A white body in a white world cannot be seen: within 0.5 %, and what chance allows."""
    # The body is flat, so that no path is caught in it, and seen at up to 60 degrees.
    sheet = (scenes.quad(4.0), scenes.transform(), [WHITE[name]])
    view = scenes.camera((0, -1.0, 1.0), (0, 0, 0), half_width=0.3)
    scene = scenes.build([sheet], view, world=World((1.0, 1.0, 1.0)))
    images = trace(device, scene, *SIZE, samples=4, bounces=8)
    assert (images["object_id"] > 0).all()
    assert_mean(radiance(images)[..., 0].ravel(), 1.0, 1e-5, rounding=5e-3)


def test_a_texture_brighter_than_white_makes_no_light(device):
    """An image may hold any float; a surface gives back no more than it gets."""
    texture = Texture("bright", np.full((2, 2, 4), 50.0, np.float32), srgb=False)
    material = Material(maps={"base_color": TextureMap(0)}, specular_ior_level=0.0)
    sheet = (scenes.quad(4.0), scenes.transform(), [material])
    view = scenes.camera((0, 0, 1.5), (0, 1e-3, 0), half_width=0.3)
    scene = scenes.build([sheet], view, world=World((1.0, 1.0, 1.0)), textures=[texture])
    np.testing.assert_allclose(radiance(trace(device, scene, 8, 5)), 1.0, rtol=1e-5)


@pytest.mark.parametrize("opposite", [False, True], ids=["same side", "back to back"])
def test_a_doubled_surface_is_a_surface(device, opposite):
    """Faces that lie on each other do not shade each other, whichever way they face.

    Where Cycles doubles a face, rounding decides ray by ray whether the one is in the shadow of the other.
    """
    single = scenes.quad(4.0)
    second = single.triangles[:, ::-1] if opposite else single.triangles
    doubled = scenes.mesh(single.positions, np.concatenate([single.triangles, second]), name="doubled")
    turned = scenes.rotation("x", 0.37) @ scenes.rotation("y", 0.61)
    view = scenes.camera((0.5, -3.0, 2.5), (0, 0, 0), half_width=0.2)
    images = [
        radiance(trace(device, scenes.build([(mesh, scenes.transform((0.1, 0.2, 0.3), turned), [scenes.WHITE])], view,
                                            [scenes.lamp(LightKind.RECTANGLE)]), *SIZE))
        for mesh in (single, doubled)
    ]  # fmt: skip
    assert images[0].min() > 0
    np.testing.assert_allclose(images[1], images[0], rtol=1e-4)
