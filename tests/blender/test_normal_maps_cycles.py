# SPDX-License-Identifier: Apache-2.0
"""Normal maps against Cycles: on a coarse smooth ball, where the tangents of triangles are far from MikkTSpace's.

A map is relative to the corners' normals as they are interpolated, of a length below 1 [Mikkelsen08]; so it is baked,
and so Cycles of Blender 5.0 reads it. That of 5.2 makes them as long as 1 first, so that U's share of the slopes on this
ball is up to 4 % smaller. There its own nodes undo that before the pictures are compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
import pytest
from blend import add_camera, add_image, add_light, add_material, add_shader, add_world
from test_cycles_light import assert_same_picture, render_svgf

pytestmark = pytest.mark.skipif(not hasattr(bpy.types.Scene, "cycles"), reason="The Cycles add-on is disabled.")


def waves(side: int = 64) -> bpy.types.Image:
    """A normal map that leans up to 35 degrees to all sides."""
    rows, columns = np.mgrid[0:side, 0:side] / side * 2 * np.pi
    pixels = np.ones((side, side, 4))
    pixels[..., 0], pixels[..., 1] = 0.5 + 0.35 * np.sin(columns), 0.5 + 0.35 * np.cos(rows)
    return add_image("waves", pixels, "Non-Color", is_float=True)


def ball(shader: str, mirrored: bool = False, **inputs) -> tuple[bpy.types.NodeTree, bpy.types.Node, bpy.types.Node]:
    """Fills the picture. Returns its nodes: the tree, the shader and a Normal Map node that nothing reads yet."""
    scene = bpy.context.scene
    if scene.camera:
        bpy.data.objects.remove(scene.camera)
    add_camera((0, -4, 0)).data.angle = 0.5
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8)
    obj = bpy.context.object
    obj.data.shade_smooth()
    if mirrored:
        for point in obj.data.uv_layers.active.uv:
            point.vector = (abs(point.vector.x - 0.75), point.vector.y)
    material = add_material(obj=obj)
    tree, target = material.node_tree, add_shader(material, shader, **inputs)
    texture, normal = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = waves()
    tree.links.new(texture.outputs["Color"], normal.inputs["Color"])
    add_light("SUN", energy=3, angle=0.2, location=(0, 0, 5)).rotation_euler = (0.8, 0.4, 0)
    return tree, target, normal


@contextmanager
def interpolated_normals(obj: bpy.types.Object, tree: bpy.types.NodeTree, normal: bpy.types.Node) -> Iterator[None]:
    """Has Cycles read the map relative to normals of the length they are interpolated with.

    With n of length l, MikkTSpace's x t + y (n x t) + z n is that of the unit normal with y l and z l.
    """
    if bpy.app.version < (5, 2, 0):
        yield
        return
    mesh, color = obj.data, normal.inputs["Color"]
    normals = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    mesh.attributes.new("interpolated", "FLOAT_VECTOR", "CORNER").data.foreach_set("vector", normals)
    source = color.links[0].from_socket
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "interpolated"
    length, scale = (tree.nodes.new("ShaderNodeVectorMath") for _ in range(2))
    length.operation, scale.operation = "LENGTH", "MULTIPLY_ADD"
    factors, offset = tree.nodes.new("ShaderNodeCombineXYZ"), tree.nodes.new("ShaderNodeVectorMath")
    factors.inputs["X"].default_value = 1.0
    # The map's numbers are 0.5 + 0.5 x: (color - 0.5) l + 0.5.
    offset.operation, offset.inputs[1].default_value = "SUBTRACT", (0.5, 0.5, 0.5)
    scale.inputs[2].default_value = (0.5, 0.5, 0.5)
    tree.links.new(attribute.outputs["Vector"], length.inputs[0])
    for axis in "YZ":
        tree.links.new(length.outputs["Value"], factors.inputs[axis])
    tree.links.new(source, offset.inputs[0])
    tree.links.new(offset.outputs["Vector"], scale.inputs[0])
    tree.links.new(factors.outputs["Vector"], scale.inputs[1])
    tree.links.new(scale.outputs["Vector"], color)
    yield
    tree.links.new(source, color)


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents(tmp_path, mirrored):
    tree, shader, normal = ball("ShaderNodeBsdfDiffuse", mirrored, Color=(0.8, 0.8, 0.8))
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    assert_same_picture(tmp_path, in_cycles=interpolated_normals(bpy.context.object, tree, normal))


def test_tangents_of_triangles_would_show(monkeypatch):
    """The tests above would find them."""
    tree, shader, normal = ball("ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8))
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    smooth = render_svgf(64, 1)
    monkeypatch.setattr("svgf_blender.export.exporter.add_tangents", lambda meshes, *_: meshes)
    rough = render_svgf(64, 1)
    assert (np.abs(rough - smooth).max(axis=2) > 0.03 * smooth.mean()).mean() > 0.05


@pytest.mark.parametrize(
    "inputs",
    [{"Roughness": 0.5}, {"Roughness": 0.4, "Metallic": 1.0}],
    ids=["plastic", "metal"],
)
def test_normals_that_lean_away_from_the_viewer(tmp_path, inputs):
    """Diffuse light has the map's normal, reflections one that keeps them above the surface."""
    tree, shader, normal = ball("ShaderNodeBsdfPrincipled", **{"Base Color": (0.5, 0.6, 0.7), **inputs})
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    add_world((0.2, 0.25, 0.3), 1.0)
    bpy.context.scene.cycles.max_bounces = 0
    assert_same_picture(tmp_path)


@pytest.mark.parametrize("roughness", [0.0, 0.3])
@pytest.mark.parametrize("follows", [False, True])
def test_coat(tmp_path, roughness, follows):
    """Smooth over the normal map, unless the map is linked to it, too."""
    tree, shader, normal = ball(
        "ShaderNodeBsdfPrincipled",
        **{"Base Color": (0.5, 0.1, 0.1), "Roughness": 0.5, "Coat Weight": 1.0, "Coat Roughness": roughness},
    )
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    if follows:
        tree.links.new(normal.outputs["Normal"], shader.inputs["Coat Normal"])
    add_world((0.4, 0.5, 0.6), 1.0)
    cycles = bpy.context.scene.cycles
    cycles.max_bounces, cycles.blur_glossy, cycles.sample_clamp_indirect = 2, 0.0, 0.0
    assert_same_picture(tmp_path)
