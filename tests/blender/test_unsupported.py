# SPDX-License-Identifier: Apache-2.0
"""What Blender and Cycles can do and svgf cannot is named once where it is used, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
import pytest
from blend import add_image, add_light, add_material, add_mesh, add_world, export, principled


def cycles_of(owner: bpy.types.ID) -> bpy.types.PropertyGroup:
    if not hasattr(owner, "cycles"):
        pytest.skip("The Cycles add-on is disabled.")
    return owner.cycles


def scene_with(**settings) -> Callable[[], None]:
    def change() -> None:
        for name, value in settings.items():
            setattr(bpy.context.scene.render, name, value)

    return change


def cycles_with(simplify: bool = False, transparent: bool = False, **settings) -> Callable[[], None]:
    def change() -> None:
        render = bpy.context.scene.render
        render.use_simplify, render.film_transparent = simplify, transparent
        for name, value in settings.items():
            setattr(cycles_of(bpy.context.scene), name, value)

    return change


def object_with(**attributes) -> Callable[[], None]:
    def change() -> None:
        for name, value in attributes.items():
            setattr(bpy.data.objects["Quad"], name, value)

    return change


def lamp_with(**settings) -> Callable[[], None]:
    def change() -> None:
        data = add_light("POINT").data
        for name, value in settings.items():
            setattr(cycles_of(data), name, value)

    return change


def world_with(**settings) -> Callable[[], None]:
    def change() -> None:
        world = add_world()
        for name, value in settings.items():
            if not hasattr(cycles_of(world), name):
                pytest.skip(f"This Blender's worlds have no {name}.")
            setattr(world.cycles, name, value)

    return change


def adaptive_subdivision() -> None:
    modifier = bpy.data.objects["Quad"].modifiers.new("Subdivision", "SUBSURF")
    if not hasattr(modifier, "use_adaptive_subdivision"):
        pytest.skip("This Blender has adaptive subdivision elsewhere.")
    modifier.use_adaptive_subdivision = True


def light_linking() -> None:
    bpy.data.objects["Quad"].light_linking.receiver_collection = bpy.data.collections.new("Receivers")


def opaque_shadows() -> None:
    add_material("Leaf", bpy.data.objects["Quad"], Alpha=0.5).use_transparent_shadow = False


def bumps_without_correction() -> None:
    image = add_image("bumps", np.random.default_rng(0).random((4, 4, 4)), "Non-Color", is_float=True)
    quad = bpy.data.objects["Quad"]
    quad.data.uv_layers.new()
    material = add_material("Bark", quad)
    tree = material.node_tree
    texture, normal = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = image
    tree.links.new(texture.outputs["Color"], normal.inputs["Color"])
    tree.links.new(normal.outputs["Normal"], principled(material).inputs["Normal"])
    assert not export().warnings
    cycles_of(material).use_bump_map_correction = False
    material.update_tag()


CASES = {
    "stereo": (scene_with(use_multiview=True), 'Scene "Scene": stereoscopy is not supported'),
    "Freestyle": (scene_with(use_freestyle=True), 'Scene "Scene": Freestyle is not supported'),
    "transparent glass": (
        cycles_with(transparent=True, film_transparent_glass=True),
        'Scene "Scene": transparent glass is not supported',
    ),
    "fast global illumination": (cycles_with(use_fast_gi=True), 'Scene "Scene": fast global illumination'),
    "pixel filter": (cycles_with(pixel_filter_type="GAUSSIAN"), 'Scene "Scene": Cycles\' pixel filter is not'),
    "width of the pixel filter": (cycles_with(filter_width=3), 'Scene "Scene": Cycles\' pixel filter is not'),
    "bumps without correction": (bumps_without_correction, 'Material "Bark": bumps without Cycles\' bump map'),
    "culling": (cycles_with(simplify=True, use_camera_cull=True), 'Scene "Scene": culling of objects'),
    "texture limit": (
        cycles_with(simplify=True, texture_limit_render="128"),
        'Scene "Scene": a limit on the size of textures',
    ),
    "shadow catcher": (object_with(is_shadow_catcher=True), 'Object "Quad": shadow catchers are not supported'),
    "shadow terminator": (
        object_with(shadow_terminator_shading_offset=0.5),
        'Object "Quad": a shading offset of the shadow terminator',
    ),
    "adaptive subdivision": (adaptive_subdivision, 'Object "Quad": adaptive subdivision is not supported'),
    "light linking": (light_linking, 'Object "Quad": light linking is not supported'),
    "opaque shadows": (opaque_shadows, 'Material "Leaf": opaque shadows of what is transparent'),
    "caustics of a lamp": (lamp_with(is_caustics_light=True), 'Light "Lamp": shadow caustics are not supported'),
    "bounces of a lamp": (lamp_with(max_bounces=3), 'Light "Lamp": a limit on a lamp\'s own bounces'),
    "caustics of a world": (world_with(is_caustics_light=True), 'World "World": shadow caustics are not supported'),
    "bounces of a world": (world_with(max_bounces=3), 'World "World": a limit on the world\'s own bounces'),
    "world without shadows": (world_with(use_shadows=False), 'World "World": a world without shadows'),
}


@pytest.mark.parametrize("name", CASES)
def test_it_is_named_once(name):
    change, start = CASES[name]
    add_mesh()
    assert not export().warnings
    change()
    (warning,) = export().warnings
    assert warning.startswith(start) and warning.endswith(".")


def test_what_has_no_effect_is_not_named():
    """Culling and limits count with Simplify on, transparent glass with a transparent film, opaque shadows of glass,
    corrections with bumps; svgf has a box filter itself, which knows no width."""
    quad = add_mesh()
    cycles_with(use_camera_cull=True, texture_limit_render="128", film_transparent_glass=True)()
    cycles_with(pixel_filter_type="BOX", filter_width=3)()
    wall = add_material("Wall", quad)
    wall.use_transparent_shadow = cycles_of(wall).use_bump_map_correction = False
    assert not export().warnings
