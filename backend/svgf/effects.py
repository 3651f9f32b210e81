# SPDX-License-Identifier: Apache-2.0
"""What a scene calls for. The renderer simulates these effects and no others."""

from __future__ import annotations

from enum import IntFlag, auto

import numpy as np

from .scene import Instances, LightKind, Material, MaterialKind, Mesh, Scene


class Effects(IntFlag):
    """The bits are those of ``core/effects.h``.

    TEXTURES: a material reads an image. SPECULAR: a material has a lobe besides Lambert's. TRANSMISSION: a
    material lets light through, other than straight. MESH_LIGHTS: a mesh emits. DELTA_LIGHTS: lamps without size.
    AREA_LIGHTS: lamps with size. ENVIRONMENT: the world emits. CAMERA_MOTION, OBJECT_MOTION: moved since the previous
    frame. DEFORMATION: vertices moved within an object. ALPHA: a material lets rays straight through. NORMAL_MAPS, COAT,
    SHEEN, ANISOTROPY: a material has one. MATERIAL_MIXES: a material is a mix or a sum of others.
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
    ALPHA = auto()
    NORMAL_MAPS = auto()
    COAT = auto()
    SHEEN = auto()
    ANISOTROPY = auto()
    MATERIAL_MIXES = auto()


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
    """bool [M]: the materials that a triangle of an instance has, and those that they mix."""
    used = np.zeros(len(scene.materials), dtype=bool)
    for slots, starts in slots_and_starts(scene.meshes, scene.instances):
        entries = np.asarray(scene.instances.material_table)[np.add.outer(np.unique(starts), slots)]
        used[entries.ravel()] = True
    waiting = list(np.flatnonzero(used))
    while waiting:
        material = scene.materials[waiting.pop()]
        for part in (material.first, material.second) if material.is_mix else ():
            if not used[part]:
                used[part] = True
                waiting.append(part)
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
    """Of one material without those that it mixes."""
    effects = Effects.TEXTURES if material.maps else Effects.NONE
    if material.is_mix:
        return effects | Effects.MATERIAL_MIXES
    if "normal" in material.maps and material.may_have("normal_strength"):
        effects |= Effects.NORMAL_MAPS
    match material.kind:
        case MaterialKind.PRINCIPLED:
            effects |= _principled_effects(material)
        case MaterialKind.DIFFUSE:
            effects |= Effects.MESH_LIGHTS if max(material.emission) > 0.0 else Effects.NONE
            effects |= Effects.SPECULAR if material.may_have("diffuse_roughness") else Effects.NONE
        case MaterialKind.GLOSSY:
            effects |= Effects.SPECULAR
            if "anisotropic" in material.maps or material.anisotropic != 0.0:
                effects |= Effects.ANISOTROPY
        case MaterialKind.GLASS | MaterialKind.REFRACTION:
            effects |= Effects.SPECULAR | Effects.TRANSMISSION
        case MaterialKind.TRANSLUCENT:
            effects |= Effects.TRANSMISSION
        case MaterialKind.TRANSPARENT:
            effects |= Effects.ALPHA
    return effects


def _principled_effects(material: Material) -> Effects:
    effects = Effects.NONE
    if max(material.emission) > 0.0:
        effects |= Effects.MESH_LIGHTS
    if "alpha" in material.maps or material.alpha < 1.0:
        effects |= Effects.ALPHA
    if material.may_have("sheen_weight"):
        effects |= Effects.SHEEN | Effects.SPECULAR
    if material.may_have("coat_weight"):
        effects |= Effects.COAT | Effects.SPECULAR
    if material.may_have("diffuse_roughness"):
        effects |= Effects.SPECULAR
    has_interface = "ior" in material.maps or material.ior != 1.0
    is_metallic, is_glass = material.may_have("metallic"), material.may_have("transmission")
    if is_metallic or is_glass or (has_interface and material.may_have("specular_ior_level")):
        effects |= Effects.SPECULAR
        if material.may_have("anisotropic"):
            effects |= Effects.ANISOTROPY
    if is_glass:
        effects |= Effects.TRANSMISSION
    return effects
