# SPDX-License-Identifier: Apache-2.0
"""What a scene calls for. The renderer simulates these effects and no others."""

from __future__ import annotations

from enum import IntFlag, auto
from weakref import WeakKeyDictionary

import numpy as np

from .scene import Instances, Light, LightKind, Material, MaterialKind, Mesh, RayVisibility, Scene


class Effects(IntFlag):
    """The bits are those of ``core/effects.h``.

    TEXTURES: a material reads an image. SPECULAR: a material has a lobe besides Lambert's. TRANSMISSION: a
    material lets light through, other than straight. MESH_LIGHTS: a mesh emits. DELTA_LIGHTS: lamps without size.
    AREA_LIGHTS: lamps with size. ENVIRONMENT: the world emits. CAMERA_MOTION, OBJECT_MOTION: moved since the previous
    frame. DEFORMATION: vertices moved within an object. ALPHA: a material lets rays straight through. NORMAL_MAPS,
    COAT, SHEEN, ANISOTROPY: a material has one. MATERIAL_MIXES: a material is a mix or a sum of others.
    ENVIRONMENT_MAP: the world is an image. DEPTH_OF_FIELD: the lens has an opening. RAY_VISIBILITY: not all kinds of
    rays see the same. LIGHT_PATH_LIMITS: see ``LightPaths``. MANY_LIGHTS: there is more than one light to choose from:
    lamps, triangles that shine, the image of the world. PERFECT_SPECULAR: a material is a mirror or clear glass,
    without roughness and nothing diffuse.
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
    ENVIRONMENT_MAP = auto()
    DEPTH_OF_FIELD = auto()
    RAY_VISIBILITY = auto()
    LIGHT_PATH_LIMITS = auto()
    MANY_LIGHTS = auto()
    PERFECT_SPECULAR = auto()


# Below it a lobe is a mirror: alpha < 1e-3, see native/trace/microfacet.h.
SMOOTH_ROUGHNESS = 1e-3**0.5

_slots: WeakKeyDictionary[Mesh, np.ndarray] = WeakKeyDictionary()  # distinct ones

MOTION_EFFECTS = Effects.CAMERA_MOTION | Effects.OBJECT_MOTION | Effects.DEFORMATION


def find_effects(scene: Scene) -> Effects:
    """The effects of one frame. Materials and meshes that no instance uses do not count."""
    effects = _world_and_camera_effects(scene)
    for index in np.flatnonzero(used_materials(scene)):
        effects |= _material_effects(scene.materials[index])
    for light in scene.lights:
        effects |= _light_effects(light)
    if sum(_count_lights(scene, effects).values()) > 1:
        effects |= Effects.MANY_LIGHTS
    instances = scene.instances
    if not np.array_equal(instances.object_to_world, instances.previous_object_to_world):
        effects |= Effects.OBJECT_MOTION
    if any(scene.meshes[index].previous_positions is not None for index in np.unique(instances.mesh)):
        effects |= Effects.DEFORMATION
    return effects


def _world_and_camera_effects(scene: Scene) -> Effects:
    effects = Effects.NONE
    pictures = [(scene.world.radiance, scene.world.environment), scene.world.backdrop]
    seen = [environment for radiance, environment in pictures if max(radiance) > 0.0]
    if seen:
        effects |= Effects.ENVIRONMENT
        if max(seen) >= 0:
            effects |= Effects.ENVIRONMENT_MAP
        if scene.world.visibility | RayVisibility.SHADOW != RayVisibility.ALL:
            effects |= Effects.RAY_VISIBILITY
    camera, previous = scene.camera, scene.previous_camera
    same_view = camera.window == previous.window and camera.projection is previous.projection
    if not same_view or not np.array_equal(camera.camera_to_world, previous.camera_to_world):
        effects |= Effects.CAMERA_MOTION
    if camera.aperture.radius > 0.0:
        effects |= Effects.DEPTH_OF_FIELD
    visibility = scene.instances.visibility
    seen_by_all = visibility is None or bool((np.asarray(visibility) == RayVisibility.ALL).all())
    every_bounce = RayVisibility.DIFFUSE | RayVisibility.GLOSSY | RayVisibility.TRANSMISSION
    if not seen_by_all or any(light.visibility & every_bounce != every_bounce for light in scene.lights):
        effects |= Effects.RAY_VISIBILITY
    if scene.defaults.light_paths.changes(scene.defaults.bounces):
        effects |= Effects.LIGHT_PATH_LIMITS
    return effects


def find_causes(scene: Scene) -> dict[Effects, tuple[str, ...]]:
    """For each effect of a scene, what calls for it: materials, lamps and meshes by their kind and name."""
    found = find_effects(scene)
    causes: dict[Effects, dict[str, None]] = {effect: {} for effect in found}

    def blame(name: str, effects: Effects) -> None:
        for effect in effects & found:
            causes[effect][name] = None

    for index in np.flatnonzero(used_materials(scene)):
        blame(f'material "{scene.materials[index].name}"', _material_effects(scene.materials[index]))
    for light in scene.lights:
        blame(f'lamp "{light.name}"', _light_effects(light))
    for index in np.unique(scene.instances.mesh):
        if scene.meshes[index].previous_positions is not None:
            blame(f'mesh "{scene.meshes[index].name}"', Effects.DEFORMATION)
    blame("the world", Effects.ENVIRONMENT | Effects.ENVIRONMENT_MAP)
    blame("the camera", Effects.CAMERA_MOTION | Effects.DEPTH_OF_FIELD)
    if Effects.OBJECT_MOTION in found:
        moving = scene.instances.object_to_world != scene.instances.previous_object_to_world
        count = int(moving.any(axis=(1, 2)).sum())
        blame(f"{count} moving instance{'s' if count > 1 else ''}", Effects.OBJECT_MOTION)
    blame("settings of objects, lamps or the world", Effects.RAY_VISIBILITY)
    blame("the render settings", Effects.LIGHT_PATH_LIMITS)
    for name, count in _count_lights(scene, found).items():
        if count:
            blame(name, Effects.MANY_LIGHTS)
    return {effect: tuple(names) for effect, names in causes.items()}


def _count_lights(scene: Scene, effects: Effects) -> dict[str, int]:
    """Where light comes from that paths aim at. effects: the others. Of emissive triangles any number counts as two."""
    lamps = sum(_light_effects(light) != Effects.NONE for light in scene.lights)
    has_image = scene.world.environment >= 0 and max(scene.world.radiance) > 0.0
    return {
        f"{lamps} lamp{'s' if lamps > 1 else ''}": lamps,
        "triangles that shine": 2 if Effects.MESH_LIGHTS in effects else 0,
        "the image of the world": int(has_image),
    }


def _light_effects(light: Light) -> Effects:
    if max(light.power) <= 0.0:
        return Effects.NONE
    has_size = light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE) or light.size[0] > 0.0
    return Effects.AREA_LIGHTS if has_size else Effects.DELTA_LIGHTS


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
        yield _slots_of(meshes[index]), starts[bounds[index] : bounds[index + 1]]


def _slots_of(mesh: Mesh) -> np.ndarray:
    """Once for each mesh: of a million triangles this takes 15 ms, which a view would pay in every frame."""
    slots = _slots.get(mesh)
    if slots is None:
        slots = _slots[mesh] = np.unique(mesh.material_slots)
    return slots


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
            effects |= Effects.PERFECT_SPECULAR if _may_be_smooth(material, "roughness") else Effects.NONE
            if "anisotropic" in material.maps or material.anisotropic != 0.0:
                effects |= Effects.ANISOTROPY
        case MaterialKind.GLASS | MaterialKind.REFRACTION:
            effects |= Effects.SPECULAR | Effects.TRANSMISSION
            effects |= Effects.PERFECT_SPECULAR if _may_be_clear(material) else Effects.NONE
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
    is_coated = material.may_have("coat_weight") and _may_be_smooth(material, "coat_roughness")
    mirrors = effects & Effects.SPECULAR and (_may_be_smooth(material, "roughness") or is_coated)
    is_black = "base_color" in material.maps or max(material.base_color) <= 0.0
    has_no_base = is_black or any(
        name in material.maps or getattr(material, name) >= 1.0 for name in ("metallic", "transmission")
    )
    if has_no_base and (mirrors or (is_glass and _may_be_clear(material))):
        effects |= Effects.PERFECT_SPECULAR
    return effects


def _may_be_smooth(material: Material, roughness: str) -> bool:
    return roughness in material.maps or getattr(material, roughness) < SMOOTH_ROUGHNESS


def _may_be_clear(material: Material) -> bool:
    """Whether it may refract without roughness. Without an interface there is nothing rough about glass."""
    return _may_be_smooth(material, "roughness") or "ior" in material.maps or material.ior == 1.0
