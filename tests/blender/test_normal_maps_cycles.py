# SPDX-License-Identifier: Apache-2.0
"""Normal maps against Cycles: on a coarse smooth ball, where the tangents of triangles are far from MikkTSpace's."""

from __future__ import annotations

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


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents(tmp_path, mirrored):
    tree, shader, normal = ball("ShaderNodeBsdfDiffuse", mirrored, Color=(0.8, 0.8, 0.8))
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    assert_same_picture(tmp_path)


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
