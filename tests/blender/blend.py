# SPDX-License-Identifier: Apache-2.0
"""Building Blender scenes, a line for each thing."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler

QUAD = ([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])


def link(name: str, data, location=(0, 0, 0)) -> bpy.types.Object:
    obj = bpy.data.objects.new(name, data)
    obj.location = location
    bpy.context.scene.collection.objects.link(obj)
    return obj


def add_camera(location=(0, -10, 0), name="Camera") -> bpy.types.Object:
    obj = link(name, bpy.data.cameras.new(name), location)
    obj.rotation_euler = Euler((np.pi / 2, 0, 0))
    bpy.context.scene.camera = obj
    return obj


def add_mesh(name="Quad", geometry=QUAD, location=(0, 0, 0)) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(geometry[0], [], geometry[1])
    return link(name, mesh, location)


def add_cube(name="Cube", location=(0, 0, 0)) -> bpy.types.Object:
    bpy.ops.mesh.primitive_cube_add(location=location)
    bpy.context.object.name = name
    return bpy.context.object


def add_light(kind: str, name="Lamp", location=(0, 0, 5), **attributes) -> bpy.types.Object:
    light = bpy.data.lights.new(name, kind)
    for key, value in attributes.items():
        setattr(light, key, value)
    return link(name, light, location)


def add_material(name="Material", obj=None, **inputs) -> bpy.types.Material:
    """A material with a Principled BSDF; inputs by socket name with underscores."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    for key, value in inputs.items():
        socket = principled(material).inputs[key.replace("_", " ")]
        socket.default_value = (*value, 1) if socket.type == "RGBA" else value
    if obj is not None:
        obj.data.materials.append(material)
    return material


def principled(material: bpy.types.Material) -> bpy.types.Node:
    return next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")


def add_shader(material: bpy.types.Material, kind: str, **inputs) -> bpy.types.Node:
    """Replaces the material's surface by one shader node."""
    tree = material.node_tree
    node = tree.nodes.new(kind)
    for key, value in inputs.items():
        socket = node.inputs[key]
        socket.default_value = (*value, 1) if socket.type == "RGBA" else value
    tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    return node


def add_image(name="Image", pixels=None, color_space="sRGB", is_float=False) -> bpy.types.Image:
    """pixels: [H, W, 4] in [0, 1], row 0 at the bottom. The image is packed."""
    pixels = np.asarray(np.ones((2, 2, 4)) if pixels is None else pixels, np.float32)
    image = bpy.data.images.new(name, pixels.shape[1], pixels.shape[0], alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = color_space
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def link_texture(material: bpy.types.Material, image, socket="Base Color") -> bpy.types.Node:
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.links.new(node.outputs["Color"], principled(material).inputs[socket])
    return node


def add_world(color=(0.2, 0.4, 0.6), strength=2.0) -> bpy.types.World:
    world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*color, 1)
    background.inputs["Strength"].default_value = strength
    bpy.context.scene.world = world
    return world


def split_by_camera_ray(world: bpy.types.World, backdrop) -> bpy.types.Node:
    """What the camera sees of the world becomes that of another Background node, of this colour, which is returned."""
    tree = world.node_tree
    first = next(node for node in tree.nodes if node.type == "BACKGROUND")
    second, mix, path = (tree.nodes.new(f"ShaderNode{name}") for name in ("Background", "MixShader", "LightPath"))
    second.inputs["Color"].default_value = (*backdrop, 1)
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(first.outputs[0], mix.inputs[1])
    tree.links.new(second.outputs[0], mix.inputs[2])
    output = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return second


def add_geometry_nodes(obj: bpy.types.Object, build) -> None:
    """build(tree, input, output) links nodes between the geometry sockets input and output."""
    tree = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    build(tree, start.outputs[0], end.inputs[0])
    obj.modifiers.new("Nodes", "NODES").node_group = tree


def animate(owner, path: str, *keys: tuple[float, float], index: int = -1) -> None:
    """Keys (frame, value), straight lines between and beyond them."""
    for frame, value in keys:
        target = getattr(owner, path)
        if index >= 0:
            target[index] = value
        else:
            setattr(owner, path, value)
        owner.keyframe_insert(path, index=index, frame=frame)
    for curve in _curves((owner.id_data.animation_data or owner.animation_data).action):
        curve.extrapolation = "LINEAR"
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def _curves(action):
    return action.layers[0].strips[0].channelbags[0].fcurves


def save(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def export(frame: int | None = None, **options):
    """The scene as it is, with the visibility of the viewport."""
    from svgf_blender.export import export_scene

    if frame is not None:
        bpy.context.scene.frame_set(frame)
    return export_scene(bpy.context.evaluated_depsgraph_get(), **options)


def instance_of(scene, name: str) -> int:
    """The row of the only instance of the mesh of that name."""
    (row,) = (row for row, mesh in enumerate(scene.instances.mesh) if scene.meshes[mesh].name == name)
    return row


def materials_of(scene, row: int) -> list:
    """The material of each triangle of an instance."""
    instances = scene.instances
    mesh = scene.meshes[instances.mesh[row]]
    table = instances.material_table[instances.material_start[row] + mesh.material_slots]
    return [scene.materials[index] for index in table]


def validate(scene) -> None:
    from svgf.scene_validation import SceneValidator

    assert not SceneValidator().check(scene)
