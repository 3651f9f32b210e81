# SPDX-License-Identifier: Apache-2.0
"""Every type of object that Blender has, and what a view layer does with it: exported, read as what it is, or named."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_camera, add_cube, add_light, add_mesh, export, instance_of, link, save, validate
from svgf.flatten import flatten
from svgf.scene import RayVisibility
from svgf_blender.export import export_file


def add_text() -> bpy.types.Object:
    data = bpy.data.curves.new("FONT", "FONT")
    data.body = "svgf"
    return link("FONT", data)


def add_with(operator, **options) -> bpy.types.Object:
    operator(**options)
    return bpy.context.object


def add_curve() -> bpy.types.Object:
    curve = add_with(bpy.ops.curve.primitive_bezier_circle_add)
    curve.data.bevel_depth = 0.1
    return curve


SURFACES = {
    "MESH": add_cube,
    "CURVE": add_curve,
    "SURFACE": lambda: add_with(bpy.ops.surface.primitive_nurbs_surface_sphere_add),
    "META": lambda: add_with(bpy.ops.object.metaball_add),
    "FONT": add_text,
}
NAMED = {
    "CURVES": (lambda: link("CURVES", bpy.data.hair_curves.new("Hair")), "hair curves are not supported yet"),
    "POINTCLOUD": (lambda: link("POINTCLOUD", bpy.data.pointclouds.new("Cloud")), "point clouds are not supported yet"),
    "VOLUME": (lambda: link("VOLUME", bpy.data.volumes.new("Smoke")), "volumes are not supported yet"),
    "GREASEPENCIL": (
        lambda: add_with(bpy.ops.object.grease_pencil_add, type="MONKEY"),
        "grease pencil is not supported yet",
    ),
}
UNSEEN = {
    "EMPTY": lambda: link("EMPTY", None),
    "ARMATURE": lambda: add_with(bpy.ops.object.armature_add),
    "LATTICE": lambda: link("LATTICE", bpy.data.lattices.new("Lattice")),
    "LIGHT_PROBE": lambda: link("LIGHT_PROBE", bpy.data.lightprobes.new("Probe", "SPHERE")),
    "SPEAKER": lambda: link("SPEAKER", bpy.data.speakers.new("Speaker")),
    "CAMERA": lambda: add_camera(name="CAMERA"),
    "LIGHT": lambda: add_light("POINT", "LIGHT"),
}


def test_every_type_is_looked_at():
    types = {item.identifier for item in bpy.types.Object.bl_rna.properties["type"].enum_items}
    assert types - {"GPENCIL"} == SURFACES.keys() | NAMED.keys() | UNSEEN.keys()  # GPENCIL: Blender 4's, unused


@pytest.mark.parametrize("kind", SURFACES)
def test_surfaces_become_triangles(kind):
    obj = SURFACES[kind]()
    assert obj.type == kind
    scene = export()
    validate(scene)
    assert len(scene.instances.mesh) == 1 and len(scene.meshes[0].triangles) >= 12
    assert not scene.warnings


@pytest.mark.parametrize("kind", NAMED)
def test_what_is_no_surface_is_named(kind):
    add, reason = NAMED[kind]
    obj = add()
    add_mesh()
    assert obj.type == kind
    scene = export()
    assert len(scene.instances.mesh) == 1
    assert any(f'"{obj.name}"' in warning and reason in warning for warning in scene.warnings)


@pytest.mark.parametrize("kind", UNSEEN)
def test_what_is_not_seen_is_no_triangle(kind):
    obj = UNSEEN[kind]()
    add_mesh()
    assert obj.type == kind
    scene = export()
    validate(scene)
    assert len(scene.instances.mesh) == 1 and len(scene.lights) == (kind == "LIGHT")
    assert not scene.warnings


def test_hair_of_particles_is_named():
    quad = add_with(bpy.ops.mesh.primitive_plane_add)
    bpy.ops.object.particle_system_add()
    quad.particle_systems[0].settings.type = "HAIR"
    assert any("hair of particle system" in warning for warning in export().warnings)


@pytest.mark.parametrize("kind", ["VERTS", "FACES"])
def test_instances_on_vertices_and_faces(tmp_path, kind):
    parent = add_cube("Parent")
    parent.instance_type = kind
    parent.show_instancer_for_render = False
    child = add_mesh("Child")
    child.parent = parent
    (scene,) = export_file(save(tmp_path / "instances.blend"), frames=[1])
    assert [mesh.name for mesh in scene.meshes] == ["Child"]
    assert len(scene.instances.mesh) == len(set(scene.instances.object_id)) == (8 if kind == "VERTS" else 6)


def test_instances_within_instances():
    """A collection of an empty that places another collection."""
    inner, outer = (bpy.data.collections.new(name) for name in ("Inner", "Outer"))
    quad = add_mesh()
    bpy.context.scene.collection.objects.unlink(quad)
    inner.objects.link(quad)
    nested = bpy.data.objects.new("Nested", None)
    outer.objects.link(nested)
    for empty, collection in ((nested, inner), (link("A", None), outer), (link("B", None, (5, 0, 0)), outer)):
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
    nested.location.y = 2
    scene = export()
    assert len(scene.meshes) == 1
    assert {tuple(matrix[:, 3]) for matrix in scene.instances.object_to_world} == {(0, 2, 0), (5, 2, 0)}
    assert len(set(scene.instances.object_id)) == 2


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 0, 1)])
def test_matrices_without_inverse(scale):
    """The object is left out of what is rendered, and said; the others are there."""
    add_mesh("Flat").scale = scale
    add_cube()
    scene = export()
    validate(scene)
    flat = flatten(scene)
    assert len(flat.instance_mesh) == 1 and np.isfinite(flat.world_to_object).all()
    assert any("transform has no inverse (meshes: Flat)" in warning for warning in flat.warnings)


def test_matrix_that_is_not_finite():
    add_mesh("Lost").location.x = float("nan")
    add_cube()
    scene = export()
    validate(scene)
    assert len(scene.instances.mesh) == 1
    assert 'Object "Lost": its transform is not finite; it is left out.' in scene.warnings


def test_ray_visibility():
    """Of the object, of its instancer, and of its collection."""
    seen, ghost = add_mesh("Seen"), add_mesh("Ghost")
    assert (export().instances.visibility == RayVisibility.ALL).all()
    ghost.visible_camera = ghost.visible_shadow = False
    collection = bpy.data.collections.new("Reflected")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(add_mesh("Indirect"))
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Indirect"])
    bpy.context.view_layer.layer_collection.children["Reflected"].indirect_only = True
    scene = export()
    validate(scene)
    expected = {
        "Seen": RayVisibility.ALL,
        "Ghost": RayVisibility.ALL & ~(RayVisibility.CAMERA | RayVisibility.SHADOW),
        "Indirect": RayVisibility.ALL & ~RayVisibility.CAMERA,
    }
    for name, rays in expected.items():
        assert scene.instances.visibility[instance_of(scene, name)] == rays, name
    assert not scene.warnings and seen.visible_camera


def test_terminator_offset():
    """Blender's own unless the object has another; of an instance that of what is placed."""
    plain, rough = add_mesh("Plain"), add_mesh("Rough")
    rough.shadow_terminator_geometry_offset = 0.7
    scene = export()
    validate(scene)
    offsets = scene.instances.terminator_offset
    assert offsets[instance_of(scene, "Plain")] == np.float32(0.1)
    assert offsets[instance_of(scene, "Rough")] == np.float32(0.7)
    assert not scene.warnings
    rough.shadow_terminator_geometry_offset = 1e30
    validate(export())
    rough.shadow_terminator_geometry_offset = 0.7

    rough.parent, plain.instance_type = plain, "VERTS"
    plain.shadow_terminator_geometry_offset = 0.3
    scene = export()
    names = [scene.meshes[mesh].name for mesh in scene.instances.mesh]
    placed = [offset for name, offset in zip(names, scene.instances.terminator_offset, strict=True) if name == "Rough"]
    assert placed == [np.float32(0.7)] * 5  # four, and the object itself


def test_an_instance_is_seen_by_what_sees_its_instancer():
    collection = bpy.data.collections.new("Collection")
    quad = add_mesh()
    bpy.context.scene.collection.objects.unlink(quad)
    collection.objects.link(quad)
    quad.visible_diffuse = False
    empty = link("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.visible_glossy = False
    (rays,) = export().instances.visibility
    assert rays == RayVisibility.ALL & ~(RayVisibility.DIFFUSE | RayVisibility.GLOSSY)


def test_view_layers_leave_out_collections(tmp_path):
    """Excluded ones are not there; a holdout is named."""
    for name in ("Excluded", "Holdout"):
        collection = bpy.data.collections.new(name)
        bpy.context.scene.collection.children.link(collection)
        quad = add_mesh(f"In {name}")
        bpy.context.scene.collection.objects.unlink(quad)
        collection.objects.link(quad)
    layers = bpy.context.view_layer.layer_collection.children
    layers["Excluded"].exclude = layers["Holdout"].holdout = True
    (scene,) = export_file(save(tmp_path / "layers.blend"), frames=[1])
    assert [mesh.name for mesh in scene.meshes] == ["In Holdout"]
    (warning,) = scene.warnings
    assert warning == 'Object "In Holdout": holdouts are not supported yet; the object is an ordinary one.'


def test_what_a_view_layer_switches_off_is_named():
    add_mesh()
    assert not export().warnings
    layer = bpy.context.view_layer
    layer.use_sky = layer.use_solid = False
    (warning,) = export().warnings
    assert warning == 'Scene "Scene": view layers without sky, surfaces are not supported yet; they are there.'
