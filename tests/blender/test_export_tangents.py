# SPDX-License-Identifier: Apache-2.0
"""Tangents of normal maps: Blender's own on the same triangles, exported only for meshes whose materials need them."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
import pytest
from blend import add_camera, add_image, add_material, add_shader, export
from svgf_blender.export import Exporter
from svgf_blender.export.tangents import corner_tangents


def ball(segments=12, mirrored=False, smooth=True, triangulated=True):
    """A ball whose right half may have the UVs of its left one."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=segments // 2)
    mesh = bpy.context.object.data
    if smooth:
        mesh.shade_smooth()
    if mirrored:
        for point in mesh.uv_layers.active.uv:
            u, v = point.vector
            point.vector = (abs(u - 0.5) * 2, v)
    if triangulated:
        edited = bmesh.new()
        edited.from_mesh(mesh)
        bmesh.ops.triangulate(edited, faces=edited.faces)
        edited.to_mesh(mesh)
        edited.free()
    return bpy.context.object


def arrays(mesh):
    """What corner_tangents takes, of a mesh of triangles."""
    positions = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", positions.ravel())
    triangles = np.empty((len(mesh.polygons), 3), np.int32)
    mesh.loops.foreach_get("vertex_index", triangles.ravel())
    normals, uvs = np.empty((*triangles.shape, 3), np.float32), np.empty((*triangles.shape, 2), np.float32)
    mesh.corner_normals.foreach_get("vector", normals.ravel())
    mesh.uv_layers.active.uv.foreach_get("vector", uvs.ravel())
    return positions, triangles, normals, uvs


def of_blender(mesh):
    mesh.calc_tangents(uvmap=mesh.uv_layers.active.name)
    tangents = np.empty((len(mesh.polygons), 3, 4), np.float32)
    vectors, signs = np.empty((len(mesh.loops), 3), np.float32), np.empty(len(mesh.loops), np.float32)
    mesh.loops.foreach_get("tangent", vectors.ravel())
    mesh.loops.foreach_get("bitangent_sign", signs)
    tangents[..., :3], tangents[..., 3] = vectors.reshape(-1, 3, 3), signs.reshape(-1, 3)
    mesh.free_tangents()
    return tangents


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("mirrored", [False, True])
def test_as_blender_computes_them(mirrored, smooth):
    mesh = ball(mirrored=mirrored, smooth=smooth).data
    expected, found = of_blender(mesh), corner_tangents(*arrays(mesh))
    assert set(np.unique(expected[..., 3])) == ({-1, 1} if mirrored else {1})
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_as_blender_computes_them_for_random_uvs():
    """Each face with corners of its own."""
    mesh = ball().data
    random = np.random.default_rng(0)
    mesh.uv_layers.active.uv.foreach_set("vector", random.random(2 * len(mesh.loops), np.float32))
    np.testing.assert_allclose(corner_tangents(*arrays(mesh)), of_blender(mesh), atol=1e-3)


def test_triangles_without_area_have_what_is_around_them():
    positions, triangles, normals, uvs = arrays(ball().data)
    uvs[7] = uvs[7, 0]
    found = corner_tangents(positions, triangles, normals, uvs)
    assert np.isfinite(found).all() and (np.abs(found[..., 3]) == 1).all()
    lengths = np.linalg.norm(np.delete(found, 7, axis=0)[..., :3], axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-5)
    assert not corner_tangents(positions, triangles, normals, np.zeros_like(uvs))[..., :3].any()


def normal_mapped(material, image, uv_map="", shader="ShaderNodeBsdfDiffuse"):
    tree, target = material.node_tree, add_shader(material, shader)
    texture, normal = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image, normal.uv_map = image, uv_map
    if uv_map:
        source = tree.nodes.new("ShaderNodeUVMap")
        source.uv_map = uv_map
        tree.links.new(source.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], normal.inputs["Color"])
    tree.links.new(normal.outputs["Normal"], target.inputs["Normal"])


@pytest.fixture
def image():
    return add_image("bumps", np.random.default_rng(0).random((4, 4, 4)), "Non-Color", is_float=True)


def test_only_what_has_a_normal_map_has_tangents(image):
    add_camera((0, -6, 0))
    plain, mapped = ball(), ball(triangulated=False)
    add_material(obj=plain)
    normal_mapped(add_material(obj=mapped), image)
    meshes = {mesh.name: mesh for mesh in export().meshes}
    assert meshes[plain.name].tangents is None
    found = meshes[mapped.name]
    assert found.tangents.shape == (len(found.triangles), 3, 4) and found.tangents.dtype == np.float32
    np.testing.assert_array_equal(
        found.tangents, corner_tangents(found.positions, found.triangles, found.normals, found.uvs)
    )


def test_bumps_need_no_tangents(image):
    add_camera((0, -6, 0))
    material = add_material(obj=ball())
    target = add_shader(material, "ShaderNodeBsdfDiffuse")
    texture, bump = (material.node_tree.nodes.new(f"ShaderNode{name}") for name in ("TexImage", "Bump"))
    texture.image = image
    material.node_tree.links.new(texture.outputs["Color"], bump.inputs["Height"])
    material.node_tree.links.new(bump.outputs["Normal"], target.inputs["Normal"])
    scene = export()
    assert "normal" in scene.materials[0].maps and scene.meshes[0].tangents is None


def test_tangents_are_those_of_the_named_uv_map(image):
    add_camera((0, -6, 0))
    obj = ball()
    other = obj.data.uv_layers.new(name="turned")
    for point in other.uv:
        point.vector = point.vector.yx
    normal_mapped(add_material(obj=obj), image, uv_map="turned")
    mesh = export().meshes[0]
    assert mesh.tangent_layer == 1 and mesh.uvs.ndim == 4
    np.testing.assert_array_equal(
        mesh.tangents, corner_tangents(mesh.positions, mesh.triangles, mesh.normals, mesh.uvs[1])
    )


def test_tangents_are_kept_where_nothing_changed(image):
    add_camera((0, -6, 0))
    obj = ball()
    normal_mapped(add_material(obj=obj), image)
    exporter = Exporter()
    first = exporter.export(bpy.context.evaluated_depsgraph_get()).meshes[0]
    obj.location.x = 1
    assert exporter.export(bpy.context.evaluated_depsgraph_get()).meshes[0] is first
    obj.data.vertices[0].co.z += 0.5
    obj.data.update()
    moved = exporter.export(bpy.context.evaluated_depsgraph_get()).meshes[0]
    assert moved.previous_positions is first.positions and not np.array_equal(moved.tangents, first.tangents)
    rested = exporter.export(bpy.context.evaluated_depsgraph_get()).meshes[0]
    assert rested.previous_positions is None and rested.tangents is moved.tangents
