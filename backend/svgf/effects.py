# SPDX-License-Identifier: Apache-2.0
"""What a scene calls for. The renderer simulates these effects and no others."""

from __future__ import annotations

from enum import IntFlag, auto

import numpy as np

from .scene import Instances, LightKind, Material, Mesh, Scene


class Effects(IntFlag):
    """The bits are those of ``core/effects.h``.

    TEXTURES: a material reads an image. SPECULAR: a material has a lobe besides Lambert's. TRANSMISSION: a material
    refracts. MESH_LIGHTS: a mesh emits. DELTA_LIGHTS: lamps without size. AREA_LIGHTS: lamps with size. ENVIRONMENT:
    the world emits. CAMERA_MOTION, OBJECT_MOTION: moved since the previous frame. DEFORMATION: vertices moved within an
    object.
    """

    NONE = 0
    TEXTURES = auto()
    SPECULAR = auto()
    TRANSMISSION = auto()
    MESH_LIGHTS = auto()
    DELTA_LIGHTS = auto()
    AREA_LIGHTS = auto()
    ENVIRONMENT = auto()
    CAMERA_MOTION = auto()
    OBJECT_MOTION = auto()
    DEFORMATION = auto()


MOTION_EFFECTS = Effects.CAMERA_MOTION | Effects.OBJECT_MOTION | Effects.DEFORMATION


def find_effects(scene: Scene) -> Effects:
    """The effects of one frame. Materials and meshes that no instance uses do not count."""
    effects = Effects.NONE
    for index in np.flatnonzero(used_materials(scene)):
        effects |= _material_effects(scene.materials[index])
    for light in scene.lights:
        if max(light.power) > 0.0:
            has_size = light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE) or light.size[0] > 0.0
            effects |= Effects.AREA_LIGHTS if has_size else Effects.DELTA_LIGHTS
    if max(scene.world.radiance) > 0.0:
        effects |= Effects.ENVIRONMENT
    camera, previous = scene.camera, scene.previous_camera
    if not np.array_equal(camera.camera_to_world, previous.camera_to_world) or camera.window != previous.window:
        effects |= Effects.CAMERA_MOTION
    instances = scene.instances
    if not np.array_equal(instances.object_to_world, instances.previous_object_to_world):
        effects |= Effects.OBJECT_MOTION
    if any(scene.meshes[index].previous_positions is not None for index in np.unique(instances.mesh)):
        effects |= Effects.DEFORMATION
    return effects


def used_materials(scene: Scene) -> np.ndarray:
    """bool [M]: the materials that a triangle of an instance has."""
    used = np.zeros(len(scene.materials), dtype=bool)
    for slots, starts in slots_and_starts(scene.meshes, scene.instances):
        entries = np.asarray(scene.instances.material_table)[np.add.outer(np.unique(starts), slots)]
        used[entries.ravel()] = True
    return used


def slots_and_starts(meshes: tuple[Mesh, ...], instances: Instances):
    """For every mesh with instances: its distinct material slots, and the material_start of each of its instances."""
    order, bounds = instances_by_mesh(instances.mesh, len(meshes))
    starts = np.asarray(instances.material_start)[order]
    for index in np.flatnonzero(np.diff(bounds)):
        yield np.unique(meshes[index].material_slots), starts[bounds[index] : bounds[index + 1]]


def instances_by_mesh(instance_mesh: np.ndarray, mesh_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Order that sorts instances by mesh, and int [mesh_count + 1]: where the instances of each mesh start in it."""
    order = np.argsort(instance_mesh, kind="stable")
    bounds = np.searchsorted(np.asarray(instance_mesh)[order], np.arange(mesh_count + 1))
    return order, bounds


def _material_effects(material: Material) -> Effects:
    effects = Effects.NONE
    if material.base_color_texture >= 0:
        effects |= Effects.TEXTURES
    dielectric = material.specular_ior_level > 0.0 and material.ior != 1.0
    if material.metallic > 0.0 or material.transmission > 0.0 or dielectric:
        effects |= Effects.SPECULAR
    if material.transmission > 0.0:
        effects |= Effects.TRANSMISSION
    if max(material.emission) > 0.0:
        effects |= Effects.MESH_LIGHTS
    return effects
