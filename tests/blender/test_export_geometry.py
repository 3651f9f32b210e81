# SPDX-License-Identifier: Apache-2.0
"""Every kind of object and instance as triangles."""

from __future__ import annotations

import sys

import bpy
import numpy as np
import pytest
from blend import (
    QUAD,
    add_camera,
    add_cube,
    add_geometry_nodes,
    add_light,
    add_material,
    add_mesh,
    export,
    link,
    materials_of,
    save,
    validate,
)
from svgf.errors import InputError
from svgf_blender.export import Exporter, export_file
from svgf_blender.export.instances import object_ids


def world_bounds(scene) -> tuple[np.ndarray, np.ndarray]:
    points = []
    for mesh, matrix in zip(scene.instances.mesh, scene.instances.object_to_world, strict=True):
        used = scene.meshes[mesh].positions[scene.meshes[mesh].triangles.ravel()]
        points.append(used @ matrix[:, :3].T + matrix[:, 3])
    points = np.concatenate(points)
    return points.min(axis=0), points.max(axis=0)


def test_mesh_arrays():
    add_mesh(geometry=([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (2, 0, 0)], [(0, 1, 2, 3), (1, 4, 2)]))
    scene = export()
    (mesh,) = scene.meshes
    assert mesh.positions.dtype == np.float32 and mesh.positions.shape == (5, 3)
    assert mesh.triangles.dtype == np.int32 and mesh.triangles.shape == (3, 3)
    assert mesh.normals.shape == (3, 3, 3) and mesh.material_slots.shape == (3,)
    assert mesh.uvs is None and mesh.previous_positions is None
    corners = mesh.positions[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    assert np.isclose(np.linalg.norm(normals, axis=1).sum() / 2, 5)


@pytest.mark.parametrize("kind", ["curve", "surface", "metaball", "text"])
def test_objects_without_mesh_become_triangles(kind):
    if kind == "curve":
        bpy.ops.curve.primitive_bezier_circle_add(radius=1)
        bpy.context.object.data.bevel_depth = 0.1
    elif kind == "surface":
        bpy.ops.surface.primitive_nurbs_surface_sphere_add(radius=1)
    elif kind == "metaball":
        bpy.ops.object.metaball_add(radius=1)
    else:
        bpy.ops.object.text_add()
        bpy.context.object.data.body = "svgf"
    add_material("Paint", bpy.context.object, Base_Color=(1, 0, 0))
    scene = export()
    validate(scene)
    assert len(scene.meshes) == 1 and len(scene.meshes[0].triangles) > 50
    assert {material.name for material in materials_of(scene, 0)} == {"Paint"}
    assert not scene.warnings


def test_curve_without_thickness_is_nothing_to_render():
    bpy.ops.curve.primitive_bezier_circle_add()
    with pytest.raises(InputError, match="no mesh"):
        export()


@pytest.mark.parametrize(
    ("kind", "settings", "triangles"),
    [
        ("SUBSURF", {"levels": 2, "render_levels": 2}, 192),
        ("ARRAY", {"count": 3}, 36),
        ("MIRROR", {"use_mirror_merge": False}, 24),
        ("SOLIDIFY", {"thickness": 0.1}, 24),
        ("BEVEL", {"segments": 1}, 44),
        ("TRIANGULATE", {}, 12),
        ("WIREFRAME", {}, None),
        ("DECIMATE", {"ratio": 0.5}, None),
        ("BOOLEAN", {}, 12),
    ],
)
def test_modifiers_are_applied(kind, settings, triangles):
    modifier = add_cube().modifiers.new("Modifier", kind)
    for name, value in settings.items():
        setattr(modifier, name, value)
    scene = export()
    validate(scene)
    count = len(scene.meshes[0].triangles)
    assert count == triangles if triangles else count not in (0, 12)


def test_flat_faces_have_no_normals_and_smooth_ones_have():
    cube = add_cube()
    assert not export().meshes[0].normals.any()
    cube.data.shade_smooth()
    normals = export().meshes[0].normals
    mesh = export().meshes[0]
    expected = mesh.positions[mesh.triangles] / np.sqrt(3)
    assert np.allclose(normals, expected, atol=1e-5)


def test_sharp_faces_and_edges():
    cube = add_cube()
    cube.data.shade_smooth()
    cube.data.polygons[0].use_smooth = False
    mesh = export().meshes[0]
    flat = ~mesh.normals.any(axis=(1, 2))
    assert flat.sum() == 2
    away = next(edge for edge in cube.data.edges if edge.key not in cube.data.polygons[0].edge_keys)
    for edge in cube.data.edges:
        edge.use_edge_sharp = edge != away
    normals = export().meshes[0].normals[~flat]
    along_axis = np.isclose(np.abs(normals).max(axis=2), 1, atol=1e-5)
    assert 0.5 < along_axis.mean() < 1
    away.use_edge_sharp = True  # all are sharp now
    assert not export().meshes[0].normals.any()


def test_custom_normals():
    quad = add_mesh()
    custom = np.array([0.6, 0, 0.8])
    quad.data.normals_split_custom_set([custom] * 4)
    assert np.allclose(export().meshes[0].normals, custom, atol=1e-3)


def test_uvs_are_those_of_the_render_layer():
    quad = add_mesh()
    for name, offset in (("first", 0.0), ("second", 0.5)):
        layer = quad.data.uv_layers.new(name=name)
        layer.uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]) + np.float32(offset))
    quad.data.uv_layers["second"].active_render = True
    mesh = export().meshes[0]
    assert np.allclose(mesh.uvs, mesh.positions[mesh.triangles][..., :2] / 2 + 1.0)


def test_several_materials_per_mesh_and_slots_of_the_object():
    cube = add_cube()
    for name in ("A", "B"):
        add_material(name, cube)
    cube.data.polygons[2].material_index = 1
    cube.data.polygons[3].material_index = 7  # beyond the slots: Cycles takes the last one
    other = link("Other", cube.data, (5, 0, 0))
    other.material_slots[0].link = "OBJECT"
    other.material_slots[0].material = add_material("C")
    scene = export()
    validate(scene)
    assert len(scene.meshes) == 1 and len(scene.instances.mesh) == 2
    names = [sorted(material.name for material in materials_of(scene, row)) for row in (0, 1)]
    assert names == [["A"] * 8 + ["B"] * 4, ["B"] * 4 + ["C"] * 8]


def test_material_override_of_the_view_layer():
    add_material("A", add_mesh())
    bpy.context.view_layer.material_override = add_material("Override")
    assert [material.name for material in export().materials] == ["Override"]


def test_linked_duplicates_share_their_mesh():
    cube = add_cube()
    for index in range(5):
        link(f"Copy {index}", cube.data, (index, 0, 0))
    scene = export()
    assert len(scene.meshes) == 1 and len(scene.instances.mesh) == 6
    assert len(set(scene.instances.object_id)) == 6 and scene.instances.object_id.min() > 0


def test_collection_instances():
    collection = bpy.data.collections.new("Collection")
    for index in range(2):
        mesh = add_mesh(f"Quad {index}", location=(index, 0, 0))
        bpy.context.scene.collection.objects.unlink(mesh)
        collection.objects.link(mesh)
    for index in range(3):
        empty = link(f"Empty {index}", None, (0, index, 0))
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
    scene = export()
    assert len(scene.meshes) == 2 and len(scene.instances.mesh) == 6
    positions = {tuple(matrix[:, 3]) for matrix in scene.instances.object_to_world}
    assert positions == {(x, y, 0) for x in (0, 1) for y in (0, 1, 2)}
    assert len(set(scene.instances.object_id)) == 6


def test_geometry_nodes_instances():
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=10, y_subdivisions=10)

    def cones_on_points(tree, start, end):
        instance, cone, join = (
            tree.nodes.new(f"GeometryNode{name}") for name in ("InstanceOnPoints", "MeshCone", "JoinGeometry")
        )
        tree.links.new(start, instance.inputs["Points"])
        tree.links.new(cone.outputs["Mesh"], instance.inputs["Instance"])
        tree.links.new(instance.outputs[0], join.inputs[0])
        tree.links.new(start, join.inputs[0])
        tree.links.new(join.outputs[0], end)

    add_geometry_nodes(bpy.context.object, cones_on_points)
    scene = export()
    validate(scene)
    assert len(scene.meshes) == 2 and len(scene.instances.mesh) == 122
    assert len(set(scene.instances.object_id)) == 122


def test_materials_set_by_geometry_nodes():
    paint = add_material("Paint")

    def set_material(tree, start, end):
        node = tree.nodes.new("GeometryNodeSetMaterial")
        node.inputs["Material"].default_value = paint
        tree.links.new(start, node.inputs[0])
        tree.links.new(node.outputs[0], end)

    add_geometry_nodes(add_cube(), set_material)
    assert {material.name for material in materials_of(export(), 0)} == {"Paint"}


def test_particle_instances():
    particle = add_cube("Particle", (0, 0, -50))
    bpy.ops.mesh.primitive_plane_add()
    bpy.ops.object.particle_system_add()
    settings = bpy.context.object.particle_systems[0].settings
    settings.count, settings.frame_start, settings.frame_end = 20, 0, 1
    settings.render_type, settings.instance_object = "OBJECT", particle
    for frame in range(1, 4):
        bpy.context.scene.frame_set(frame)
    scene = export()
    assert len(scene.meshes) == 2 and len(scene.instances.mesh) == 22
    assert len(set(scene.instances.object_id)) == 22


def test_simplified_child_particles():
    """Half of ten for each particle."""
    quad, leaf = add_mesh("Emitter"), add_mesh("Leaf", location=(0, 0, -50))
    quad.modifiers.new("Particles", "PARTICLE_SYSTEM")
    settings = quad.particle_systems[0].settings
    settings.count, settings.frame_start, settings.frame_end = 8, 0, 1
    settings.render_type, settings.instance_object = "OBJECT", leaf
    settings.child_type, settings.child_percent, settings.rendered_child_count = "SIMPLE", 10, 10
    render, counts = bpy.context.scene.render, []
    for simplified in (False, True):
        render.use_simplify = simplified
        render.simplify_child_particles = render.simplify_child_particles_render = 0.5
        bpy.context.scene.frame_set(2)
        counts.append(len(export().instances.mesh) - 2)
    assert counts == [80, 40]


def test_vertex_instances_replace_instancer_and_child(tmp_path):
    parent = add_mesh("Parent")
    parent.instance_type = "VERTS"
    parent.show_instancer_for_render = False
    add_cube("Child").parent = parent
    (scene,) = export_file(save(tmp_path / "instances.blend"), frames=[1])
    assert len(scene.meshes) == 1 and len(scene.instances.mesh) == 4


def test_a_thousand_instances_are_one_mesh():
    cube = add_cube()
    for index in range(999):
        link(f"Copy {index}", cube.data, (index, 0, 0))
    scene = export()
    assert len(scene.meshes) == 1 and len(scene.instances.mesh) == 1000
    assert len(np.unique(scene.instances.object_id)) == 1000


def test_negative_scale_keeps_the_mesh_and_mirrors_the_matrix():
    cube = add_cube()
    cube.scale = (-1, 2, 3)
    scene = export()
    (matrix,) = scene.instances.object_to_world
    assert np.allclose(matrix[:, :3], np.diag([-1, 2, 3]))
    assert np.allclose(world_bounds(scene), [(-1, -2, -3), (1, 2, 3)])


def test_parents_and_constraints_place_objects():
    parent = link("Parent", None, (1, 2, 3))
    child = add_mesh(location=(0, 0, 1))
    child.parent = parent
    child.constraints.new("LIMIT_LOCATION").use_max_z = True
    (matrix,) = export().instances.object_to_world
    assert np.allclose(matrix[:, 3], (1, 2, 0))


def test_hidden_objects(tmp_path):
    """The render's visibility counts, not the viewport's."""
    add_mesh("Seen")
    add_mesh("Hidden").hide_render = True
    add_mesh("Hidden in viewport").hide_viewport = True
    invisible = add_mesh("Invisible to rays")
    for ray in ("camera", "diffuse", "glossy", "transmission", "shadow"):
        setattr(invisible, f"visible_{ray}", False)
    add_light("POINT", "Hidden lamp").hide_render = True
    (scene,) = export_file(save(tmp_path / "hidden.blend"), frames=[1])
    assert {mesh.name for mesh in scene.meshes} == {"Seen", "Hidden in viewport"}
    assert not scene.lights


def test_render_levels_of_modifiers(tmp_path):
    modifier = add_cube().modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 1
    (scene,) = export_file(save(tmp_path / "levels.blend"), frames=[1])
    assert len(scene.meshes[0].triangles) == 48


def test_vertices_that_are_not_finite():
    quad = add_mesh(geometry=(QUAD[0] + [(3, 0, 0), (3, 1, 0)], QUAD[1] + [(1, 4, 5)]))
    quad.data.vertices[4].co.x = float("nan")
    scene = export()
    validate(scene)
    assert len(scene.meshes[0].triangles) == 2
    assert scene.warnings == ('Object "Quad": 1 triangles with vertices that are not finite are left out.',)


def test_loose_vertices_and_edges_are_no_triangles():
    mesh = add_mesh(geometry=([(0, 0, 0), (1, 0, 0)], []))
    mesh.data.edges.add(1)
    add_cube()
    scene = export()
    assert len(scene.meshes) == len(scene.instances.mesh) == 1


@pytest.mark.parametrize("missing", ["camera", "mesh"])
def test_nothing_to_render(missing):
    if missing == "camera":
        add_mesh()
        bpy.data.objects.remove(bpy.context.scene.camera)
    with pytest.raises(InputError, match=f"has no {missing}") as error:
        export()
    assert error.value.hint.startswith("Add")


def test_object_ids_are_a_function_of_the_keys():
    keys = [(f"Object {index}", "", b"") for index in range(20_000)]
    ids = object_ids(keys)
    assert len(np.unique(ids)) == len(ids) and ids.min() > 0 and ids.max() < 1 << 24
    order = np.random.default_rng(0).permutation(len(keys))
    assert np.array_equal(object_ids([keys[index] for index in order]), ids[order])
    # Few of them change where half of the objects are gone.
    assert np.mean(object_ids(keys[::2]) != ids[::2]) < 0.001


def test_no_python_for_each_triangle():
    """A hundred times the triangles, with n-gons among them, take the same calls."""
    counts = []
    for side in (10, 100):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=side, y_subdivisions=side)
        bpy.ops.object.shade_smooth()
        add_mesh("Pentagon", ([(0, 0, 0), (1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0)], [(0, 1, 2, 3, 4)]))
        add_camera()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        Exporter().export(depsgraph)
        calls = []
        sys.setprofile(lambda frame, event, argument: calls.append(event))
        try:
            scene = Exporter().export(depsgraph)
        finally:
            sys.setprofile(None)
        assert max(len(mesh.triangles) for mesh in scene.meshes) == 2 * side**2
        counts.append(len(calls))
    assert counts[0] == counts[1] < 2000


def test_quads_are_split_as_blender_splits_them():
    """Flat, bent, and concave ones, among triangles."""
    random = np.random.default_rng(0)
    vertices, faces = [], []
    for index in range(400):
        count = 3 if index % 5 == 0 else 4
        points = random.normal(size=(count, 3)) * (1, 1, index % 2)
        faces.append(tuple(range(len(vertices), len(vertices) + count)))
        vertices += points.tolist()
    data = add_mesh(geometry=(vertices, faces)).data
    data.calc_loop_triangles()
    expected = np.empty((len(data.loop_triangles), 3), np.int32)
    data.loop_triangles.foreach_get("vertices", expected.ravel())
    assert np.array_equal(np.sort(export().meshes[0].triangles), np.sort(expected))
