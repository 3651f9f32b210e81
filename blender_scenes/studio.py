# SPDX-License-Identifier: Apache-2.0
"""The Blender side of the scenes: from shapes, colours and numbers to data-blocks. Works with Blender 4.5 to 5.2."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import bpy
import numpy as np
from geometry import Shape
from mathutils import Matrix, Vector

FIRST_FRAME, LAST_FRAME = 1, 48
WIDTH, HEIGHT = 960, 540


def new_scene(name: str, bounces: int, world: Sequence[float]) -> None:
    """Start over with an empty file whose render settings let Cycles and svgf compute the same picture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.name = name
    scene.frame_start, scene.frame_end = FIRST_FRAME, LAST_FRAME
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.fps = 24
    scene.view_settings.view_transform = "Standard"
    cycles = scene.cycles
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.seed, cycles.use_animated_seed = 0, False
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = bounces
    scene.world = bpy.data.worlds.new(name)
    if scene.world.node_tree is None:  # Blender 4.5
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*world, 1.0)
    background.inputs["Strength"].default_value = 1.0


def image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """A packed 8-bit sRGB image from values in [0, 1], [H, W, 3], row 0 at the bottom."""
    height, width = pixels.shape[:2]
    block = bpy.data.images.new(name, width, height)
    block.colorspace_settings.name = "sRGB"
    opaque = np.concatenate([pixels, np.ones((height, width, 1))], axis=-1)
    block.pixels.foreach_set(opaque.astype(np.float32).ravel())
    block.update()
    block.pack()
    return block


def material(
    name: str,
    color: Sequence[float] | bpy.types.Image,
    roughness: float = 0.5,
    metallic: float = 0.0,
    transmission: float = 0.0,
    ior: float = 1.5,
    emission: float = 0.0,
) -> bpy.types.Material:
    """A Principled BSDF. color: linear RGB or an image; emission: strength, in the base colour."""
    block = bpy.data.materials.new(name)
    if block.node_tree is None:  # Blender 4.5
        block.use_nodes = True
    tree = block.node_tree
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    principled.distribution = "GGX"
    inputs = principled.inputs
    if isinstance(color, bpy.types.Image):
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = color
        tree.links.new(texture.outputs["Color"], inputs["Base Color"])
        block.diffuse_color = (0.7, 0.7, 0.7, 1.0)
    else:
        inputs["Base Color"].default_value = block.diffuse_color = (*color, 1.0)
        inputs["Emission Color"].default_value = (*color, 1.0)
    inputs["Roughness"].default_value = block.roughness = roughness
    inputs["Metallic"].default_value = block.metallic = metallic
    inputs["Transmission Weight"].default_value = transmission
    inputs["IOR"].default_value = ior
    inputs["Emission Strength"].default_value = emission
    return block


def mesh(
    name: str, shape: Shape, materials: Sequence[bpy.types.Material] = (), sharp_degrees: float = 40.0
) -> bpy.types.Mesh:
    """A mesh data-block. Edges that bend by more than sharp_degrees stay sharp where faces are smooth.

    Without materials the mesh gets one empty slot, which each object may fill (`place`).
    """
    block = bpy.data.meshes.new(name)
    ends = np.cumsum(shape.sizes)
    corners = shape.corners.tolist()
    block.from_pydata(shape.positions.tolist(), [], [corners[end - size:end] for end, size in zip(ends, shape.sizes)])
    block.polygons.foreach_set("use_smooth", shape.smooth)
    block.polygons.foreach_set("material_index", shape.slots.astype(np.int32))
    block.uv_layers.new(name="UVMap").data.foreach_set("uv", shape.uvs.astype(np.float32).ravel())
    for slot in materials or (None,):
        block.materials.append(slot)
    block.set_sharp_from_angle(angle=np.radians(sharp_degrees))
    if shape.normals.any():
        block.normals_split_custom_set(shape.normals.tolist())
    block.update()
    return block


def place(
    block: bpy.types.Mesh,
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    turn: float = 0.0,
    tilt: float = 0.0,
    scale: float | Sequence[float] = 1.0,
    material: bpy.types.Material | None = None,
) -> bpy.types.Object:
    """An object of a mesh that others may share. turn: degrees around Z; tilt: degrees around X before that;
    material: fills the first slot of this object only."""
    obj = bpy.data.objects.new(block.name, block)
    obj.location = (x, y, z)
    obj.rotation_euler = np.radians([tilt, 0.0, turn])
    obj.scale = (scale,) * 3 if np.isscalar(scale) else scale
    if material is not None:
        obj.material_slots[0].link = "OBJECT"
        obj.material_slots[0].material = material
    bpy.context.scene.collection.objects.link(obj)
    return obj


def light(
    kind: str,
    name: str,
    energy: float,
    color: Sequence[float],
    location: Sequence[float],
    target: Sequence[float] = (0.0, 0.0, 0.0),
    **settings: object,
) -> bpy.types.Object:
    """A lamp ("POINT", "SUN", "SPOT" or "AREA") that looks at target; settings are attributes of Blender's light."""
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = energy, color
    if kind in ("POINT", "SPOT"):
        data.use_soft_falloff = False  # a sphere like any other, near to it as well
    for key, value in settings.items():
        setattr(data, key, value)
    obj = bpy.data.objects.new(name, data)
    obj.matrix_world = look_at(location, target)
    obj.visible_camera = False
    bpy.context.scene.collection.objects.link(obj)
    return obj


def camera(
    focal_length: float,
    path: Callable[[int], tuple[Sequence[float], Sequence[float]]],
    clip: tuple[float, float] = (0.05, 200.0),
) -> bpy.types.Object:
    """The scene's camera. path: frame -> (position, point looked at); focal length in mm on a 36 mm wide sensor."""
    data = bpy.data.cameras.new("Camera")
    data.lens, data.sensor_width = focal_length, 36.0
    data.clip_start, data.clip_end = clip
    obj = bpy.data.objects.new("Camera", data)
    obj.rotation_mode = "QUATERNION"
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.scene.camera = obj
    poses = [look_at(*path(frame)) for frame in animated_frames()]
    if all(pose == poses[0] for pose in poses):
        obj.matrix_world = poses[0]
    else:
        animate(obj, "location", [pose.translation for pose in poses])
        animate(obj, "rotation_quaternion", [pose.to_quaternion() for pose in poses])
    return obj


def look_at(position: Sequence[float], target: Sequence[float]) -> Matrix:
    """The pose at position that looks along -Z to the target with +Y up."""
    direction = Vector(target) - Vector(position)
    return Matrix.Translation(position) @ direction.to_track_quat("-Z", "Y").to_matrix().to_4x4()


def animated_frames() -> range:
    """The frames that get keys: one more at either end, so that the first and last frame move as all others do."""
    return range(FIRST_FRAME - 1, LAST_FRAME + 2)


def animate(owner: bpy.types.bpy_struct, property_name: str, values: Iterable[Sequence[float]]) -> None:
    """Keys of an object's or pose bone's property for each of `animated_frames`."""
    for frame, value in zip(animated_frames(), values):
        setattr(owner, property_name, value)
        owner.keyframe_insert(property_name, frame=frame)
