# SPDX-License-Identifier: Apache-2.0
"""Checks that a Scene holds what scene.py promises: native code behind it indexes without asking.

What cannot be rendered raises InputError with the name of the field. What can, but will not look as meant, becomes a
warning: a vertex that is not finite only takes the triangles around it out of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from numbers import Integral, Real
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from .errors import InputError
from .light_paths import LIGHT_PATH_RANGES, LightPaths
from .scene import (
    DEEPEST_MIX,
    MATERIAL_INPUTS,
    Aperture,
    Camera,
    Extension,
    Instances,
    Interpolation,
    Light,
    LightKind,
    Material,
    MaterialKind,
    Mesh,
    Projection,
    RayVisibility,
    RenderDefaults,
    Scene,
    Texture,
    TextureMap,
    World,
)

LARGEST_IMAGE_SIDE = 65536
MOST_UV_LAYERS = 64
# Beyond this, products of two numbers leave the range of float32.
_LARGEST_NUMBER = 1e18
_INT32_MAX = 2**31 - 1
_SHARES = (
    "metallic", "roughness", "transmission", "anisotropic_rotation", "coat_weight", "coat_roughness", "sheen_weight",
    "sheen_roughness", "alpha", "diffuse_roughness", "subsurface_weight", "factor",
)  # fmt: skip


@dataclass(frozen=True)
class _MeshFacts:
    slot_count: int
    warnings: tuple[str, ...]


class SceneValidator:
    """Validates the frames of an animation one by one; meshes and textures that it has seen are not looked at again.

    source: what a message starts with, usually the file.
    """

    def __init__(self, source: str = "Scene") -> None:
        self._source = source
        self._meshes: WeakKeyDictionary[Mesh, _MeshFacts] = WeakKeyDictionary()
        self._textures: WeakKeyDictionary[Texture, bool] = WeakKeyDictionary()

    def check(self, scene: Scene) -> tuple[str, ...]:
        """Warnings about the scene, beside those that it carries. Raises InputError, "SOURCE: FIELD what is wrong"."""
        try:
            return self._check(scene)
        except _Invalid as invalid:
            raise InputError(f"{self._source}: {invalid}", "Correct it, or export the scene again.") from None

    def _check(self, scene: Scene) -> tuple[str, ...]:
        _text("name", scene.name)
        _integer("frame", scene.frame, -_INT32_MAX, _INT32_MAX)
        _instance("cut", scene.cut, bool)
        for index, warning in enumerate(_items("warnings", scene.warnings, str)):
            _text(f"warnings[{index}]", warning)
        _check_defaults(scene.defaults)
        _check_camera("camera", scene.camera)
        _check_camera("previous_camera", scene.previous_camera)
        _check_world(_instance("world", scene.world, World), len(scene.textures))
        for index, light in enumerate(_items("lights", scene.lights, Light)):
            _check_light(f"lights[{index}]", light)
        for index, texture in enumerate(_items("textures", scene.textures, Texture)):
            if texture not in self._textures:
                _check_texture(f"textures[{index}]", texture)
                self._textures[texture] = True
        for index, material in enumerate(_items("materials", scene.materials, Material)):
            _check_material(f"materials[{index}]", material, len(scene.textures), len(scene.materials))
        _check_mixes(scene.materials)
        for index, mesh in enumerate(_items("meshes", scene.meshes, Mesh)):
            if mesh not in self._meshes:
                self._meshes[mesh] = _check_mesh(f"meshes[{index}]", mesh)
        facts = [self._meshes[mesh] for mesh in scene.meshes]
        _check_instances(_instance("instances", scene.instances, Instances), facts, len(scene.materials))
        return tuple(warning for fact in facts for warning in fact.warnings)


class _Invalid(Exception):
    def __init__(self, field: str, problem: str) -> None:
        super().__init__(f"{field} {problem}.")


def _check_defaults(defaults: RenderDefaults) -> None:
    _instance("defaults", defaults, RenderDefaults)
    _integer("defaults.width", defaults.width, 1, LARGEST_IMAGE_SIDE)
    _integer("defaults.height", defaults.height, 1, LARGEST_IMAGE_SIDE)
    _integer("defaults.bounces", defaults.bounces, 0, 1024)
    _number("defaults.exposure", defaults.exposure, 0.0)
    if _number("defaults.frames_per_second", defaults.frames_per_second, 0.0) == 0.0:
        raise _Invalid("defaults.frames_per_second", "is 0")
    _instance("defaults.transparent_film", defaults.transparent_film, bool)
    paths = _instance("defaults.light_paths", defaults.light_paths, LightPaths)
    for name, (low, high) in LIGHT_PATH_RANGES.items():
        check = _integer if isinstance(high, int) else _number
        check(f"defaults.light_paths.{name}", getattr(paths, name), low, high)
    for name in ("reflective_caustics", "refractive_caustics"):
        _instance(f"defaults.light_paths.{name}", getattr(paths, name), bool)


def _check_world(world: World, texture_count: int) -> None:
    _numbers("world.radiance", world.radiance, 3, 0.0)
    _integer("world.environment", world.environment, -1, texture_count - 1)
    rotation = np.array(_numbers("world.world_to_environment", world.world_to_environment, 9)).reshape(3, 3)
    if not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-3):
        raise _Invalid("world.world_to_environment", "is no rotation; its rows must be perpendicular unit vectors")
    _instance("world.visibility", world.visibility, RayVisibility)
    if world.backdrop_radiance is not None:
        _numbers("world.backdrop_radiance", world.backdrop_radiance, 3, 0.0)
    _integer("world.backdrop_environment", world.backdrop_environment, -1, texture_count - 1)


def _check_camera(field: str, camera: Camera) -> None:
    _instance(field, camera, Camera)
    _rigid(f"{field}.camera_to_world", camera.camera_to_world)
    left, right, bottom, top = _numbers(f"{field}.window", camera.window, 4)
    if not (left < right and bottom < top):
        raise _Invalid(
            f"{field}.window", "is empty: it must be (left, right, bottom, top) with left < right, bottom < top"
        )
    near, far = _numbers(f"{field}.clip", camera.clip, 2, 0.0)
    if not near < far:
        raise _Invalid(f"{field}.clip", f"ends at {far:g} before it starts at {near:g}")
    _instance(f"{field}.projection", camera.projection, Projection)
    aperture = _instance(f"{field}.aperture", camera.aperture, Aperture)
    _number(f"{field}.aperture.radius", aperture.radius, 0.0)
    _integer(f"{field}.aperture.blades", aperture.blades, 0, 1024)
    _number(f"{field}.aperture.rotation", aperture.rotation)
    for name in ("focus_distance", "ratio"):
        if _number(f"{field}.aperture.{name}", getattr(aperture, name), 0.0) == 0.0:
            raise _Invalid(f"{field}.aperture.{name}", "is 0")


def _check_light(field: str, light: Light) -> None:
    _text(f"{field}.name", light.name)
    field = _named(field, light.name)
    _instance(f"{field}.kind", light.kind, LightKind)
    _numbers(f"{field}.power", light.power, 3, 0.0)
    _rigid(f"{field}.light_to_world", light.light_to_world)
    _numbers(f"{field}.size", light.size, 2, 0.0, np.pi if light.kind is LightKind.SUN else _LARGEST_NUMBER)
    _number(f"{field}.spot_angle", light.spot_angle, 0.0, np.pi + 1e-6)
    _number(f"{field}.spot_blend", light.spot_blend, 0.0, 1.0)
    _instance(f"{field}.soft_falloff", light.soft_falloff, bool)
    _number(f"{field}.spread", light.spread, 0.0, np.pi + 1e-6)
    _instance(f"{field}.visibility", light.visibility, RayVisibility)


def _check_material(field: str, material: Material, texture_count: int, material_count: int) -> None:
    _text(f"{field}.name", material.name)
    field = _named(field, material.name)
    _instance(f"{field}.kind", material.kind, MaterialKind)
    for name in ("base_color", "specular_tint", "coat_tint", "sheen_tint"):
        _numbers(f"{field}.{name}", getattr(material, name), 3, 0.0, 1.0)
    for name in _SHARES:
        _number(f"{field}.{name}", getattr(material, name), 0.0, 1.0)
    for name in ("ior", "specular_ior_level", "coat_ior", "normal_strength", "factor_fresnel_ior"):
        _number(f"{field}.{name}", getattr(material, name), 0.0)
    _number(f"{field}.anisotropic", material.anisotropic, -1.0, 1.0)
    _number(f"{field}.factor_facing_blend", material.factor_facing_blend, -1.0, 1.0)
    _instance(f"{field}.multiscatter", material.multiscatter, bool)
    _integer(f"{field}.tangent_uv_layer", material.tangent_uv_layer, -1, MOST_UV_LAYERS - 1)
    _numbers(f"{field}.emission", material.emission, 3, 0.0)
    for name, texture_map in _instance(f"{field}.maps", material.maps, dict).items():
        if name not in MATERIAL_INPUTS:
            raise _Invalid(f"{field}.maps", f"has {shown(name)}, which is not an input that a texture can drive")
        _check_texture_map(f"{field}.maps[{name}]", texture_map, texture_count)
    lowest = 0 if material.is_mix else -1
    for name in ("first", "second"):
        _integer(f"{field}.{name}", getattr(material, name), lowest, material_count - 1)


def _check_texture_map(field: str, texture_map: TextureMap, texture_count: int) -> None:
    _instance(field, texture_map, TextureMap)
    _integer(f"{field}.texture", texture_map.texture, 0, texture_count - 1)
    _integer(f"{field}.channel", texture_map.channel, 0, 3)
    _integer(f"{field}.uv_layer", texture_map.uv_layer, 0, MOST_UV_LAYERS - 1)
    _numbers(f"{field}.uv_transform", texture_map.uv_transform, 6)


def _check_mixes(materials: tuple[Material, ...]) -> None:
    """That mixes end in materials that are none."""
    depths: dict[int, int] = {}

    def depth(index: int, above: tuple[int, ...]) -> int:
        material = materials[index]
        field = _named(f"materials[{index}]", material.name)
        if index in above:
            raise _Invalid(field, "mixes itself")
        if len(above) > DEEPEST_MIX:
            raise _Invalid(field, f"lies within more than {DEEPEST_MIX} mixes")
        if index not in depths:
            parts = (material.first, material.second) if material.is_mix else ()
            depths[index] = 1 + max((depth(part, (*above, index)) for part in parts), default=-1)
        if len(above) + depths[index] > DEEPEST_MIX:
            raise _Invalid(field, f"lies within more than {DEEPEST_MIX} mixes")
        return depths[index]

    for index in range(len(materials)):
        depth(index, ())


def _check_texture(field: str, texture: Texture) -> None:
    _text(f"{field}.name", texture.name)
    field = _named(field, texture.name)
    _instance(f"{field}.srgb", texture.srgb, bool)
    _instance(f"{field}.interpolation", texture.interpolation, Interpolation)
    _instance(f"{field}.extension", texture.extension, Extension)
    _instance(f"{field}.associated_alpha", texture.associated_alpha, bool)
    is_float = _instance(f"{field}.pixels", texture.pixels, np.ndarray).dtype == np.float32
    pixels = _array(f"{field}.pixels", texture.pixels, np.float32 if is_float else np.uint8, (None, None, 4))
    if pixels.size == 0 or max(pixels.shape) > LARGEST_IMAGE_SIDE:
        raise _Invalid(
            f"{field}.pixels", f"is {pixels.shape[1]}x{pixels.shape[0]}, not 1 to {LARGEST_IMAGE_SIDE} on each side"
        )
    if is_float:
        _finite(f"{field}.pixels", pixels)
        if texture.srgb:
            raise _Invalid(f"{field}.srgb", "is set, but float32 pixels are linear")


def _check_mesh(field: str, mesh: Mesh) -> _MeshFacts:
    _text(f"{field}.name", mesh.name)
    field = _named(field, mesh.name)
    positions = _array(f"{field}.positions", mesh.positions, np.float32, (None, 3))
    triangles = _array(f"{field}.triangles", mesh.triangles, np.int32, (None, 3))
    count = len(triangles)
    _array(f"{field}.normals", mesh.normals, np.float32, (count, 3, 3))
    slots = _array(f"{field}.material_slots", mesh.material_slots, np.int32, (count,))
    _indices(f"{field}.triangles", triangles, len(positions), "vertices")
    _indices(f"{field}.material_slots", slots, _INT32_MAX, "slots")
    if mesh.uvs is not None:
        layers = (None,) if getattr(mesh.uvs, "ndim", 3) == 4 else ()
        uvs = _array(f"{field}.uvs", mesh.uvs, np.float32, (*layers, count, 3, 2))
        if layers and not 1 <= len(uvs) <= MOST_UV_LAYERS:
            raise _Invalid(f"{field}.uvs", f"has {len(uvs)} layers, not 1 to {MOST_UV_LAYERS}")
        _finite(f"{field}.uvs", uvs)
    if mesh.tangents is not None:
        _finite(f"{field}.tangents", _array(f"{field}.tangents", mesh.tangents, np.float32, (count, 3, 4)))
    _integer(f"{field}.tangent_layer", mesh.tangent_layer, 0, MOST_UV_LAYERS - 1)

    warnings = []
    broken = ~np.isfinite(positions).all(axis=1)
    if mesh.previous_positions is not None:
        previous = _array(f"{field}.previous_positions", mesh.previous_positions, np.float32, positions.shape)
        broken |= ~np.isfinite(previous).all(axis=1)
    if vertices := np.count_nonzero(broken):
        gone = np.count_nonzero(broken[triangles].any(axis=1))
        warnings.append(
            f'Mesh "{mesh.name}": {vertices} of {len(positions)} vertices are not finite; '
            f"{gone} triangles are left out."
        )
    if corners := np.count_nonzero(~np.isfinite(mesh.normals).all(axis=2)):
        warnings.append(f'Mesh "{mesh.name}": {corners} corner normals are not finite; the face normal is used there.')
    return _MeshFacts(int(slots.max(initial=-1)) + 1, tuple(warnings))


def _check_instances(instances: Instances, meshes: list[_MeshFacts], material_count: int) -> None:
    mesh = _array("instances.mesh", instances.mesh, np.int32, (None,))
    count = len(mesh)
    _indices("instances.mesh", mesh, len(meshes), "meshes")
    for name in ("object_to_world", "previous_object_to_world"):
        _finite(f"instances.{name}", _array(f"instances.{name}", getattr(instances, name), np.float64, (count, 3, 4)))
    object_id = _array("instances.object_id", instances.object_id, np.int32, (count,))
    if (object_id <= 0).any():
        raise _Invalid("instances.object_id", f"holds {object_id.min()}; numbers of objects start at 1")
    start = _array("instances.material_start", instances.material_start, np.int32, (count,))
    table = _array("instances.material_table", instances.material_table, np.int32, (None,))
    _indices("instances.material_table", table, material_count, "materials")
    if instances.visibility is not None:
        visibility = _array("instances.visibility", instances.visibility, np.uint8, (count,))
        if visibility.max(initial=0) > RayVisibility.ALL:
            raise _Invalid("instances.visibility", f"holds {visibility.max()}, which is no set of rays")
    if instances.terminator_offset is not None:
        offset = _array("instances.terminator_offset", instances.terminator_offset, np.float32, (count,))
        _finite("instances.terminator_offset", offset)
        if offset.min(initial=0.0) < 0.0:
            raise _Invalid("instances.terminator_offset", f"holds {offset.min():g}; offsets are at least 0")
    slot_count = np.array([facts.slot_count for facts in meshes], np.int64)
    end = start.astype(np.int64) + slot_count[mesh] if count else np.zeros(0, np.int64)
    wrong = np.flatnonzero((start < 0) | (end > len(table)))
    if wrong.size:
        row = wrong[0]
        raise _Invalid(
            f"instances.material_start[{row}]",
            f"is {start[row]}, but its mesh has {end[row] - start[row]} material slots "
            f"and material_table {len(table)} entries",
        )


def _named(field: str, name: str) -> str:
    return f'{field} "{name}"' if name else field


def _instance(field: str, value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        wanted = f"one of {', '.join(kind.__members__)}" if issubclass(kind, Enum) else f"of type {kind.__name__}"
        raise _Invalid(field, f"is {shown(value)}, not {wanted}")
    return value


def _items(field: str, values: Any, kind: type) -> tuple[Any, ...]:
    for index, value in enumerate(_instance(field, values, tuple)):
        _instance(f"{field}[{index}]", value, kind)
    return values


def _text(field: str, value: Any) -> None:
    _instance(field, value, str)


def _integer(field: str, value: Any, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise _Invalid(field, f"is {shown(value)}, not an integer")
    if not low <= value <= high:
        raise _Invalid(field, f"is {shown(value)}, outside of [{low}, {high}]")


def _number(field: str, value: Any, low: float = -_LARGEST_NUMBER, high: float = _LARGEST_NUMBER) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise _Invalid(field, f"is {shown(value)}, not a number")
    if not low <= value <= high:  # NaN is in no interval
        raise _Invalid(field, f"is {shown(value)}, outside of [{low:g}, {high:g}]")
    return float(value)


def _numbers(
    field: str, values: Any, count: int, low: float = -_LARGEST_NUMBER, high: float = _LARGEST_NUMBER
) -> tuple[float, ...]:
    if len(_instance(field, values, tuple)) != count:
        raise _Invalid(field, f"has {len(values)} numbers, not {count}")
    return tuple(_number(f"{field}[{index}]", value, low, high) for index, value in enumerate(values))


def _array(field: str, value: Any, dtype: type, shape: tuple[int | None, ...]) -> np.ndarray:
    array = _instance(field, value, np.ndarray)
    wanted = f"{np.dtype(dtype)} [{', '.join('*' if side is None else str(side) for side in shape)}]"
    matches = array.ndim == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
    if array.dtype != dtype or not matches:
        raise _Invalid(field, f"is {array.dtype} {list(array.shape)}, not {wanted}")
    if max(array.shape) > _INT32_MAX:
        raise _Invalid(field, "has more than 2^31 - 1 rows")
    return array


def _indices(field: str, array: np.ndarray, count: int, what: str) -> None:
    if array.size and array.min() < 0:
        raise _Invalid(field, f"holds {array.min()}, but numbers of {what} start at 0")
    if array.size and array.max() >= count:
        raise _Invalid(field, f"holds {array.max()}, but there are {count} {what}")


def _finite(field: str, array: np.ndarray) -> None:
    # Written so that NaN fails.
    wrong = np.count_nonzero(~(np.abs(array) <= _LARGEST_NUMBER))
    if wrong:
        raise _Invalid(field, f"holds {wrong} numbers that are not finite or beyond {_LARGEST_NUMBER:g}")


def _rigid(field: str, matrix: Any) -> None:
    """Rotation (or reflection) and translation: what a camera's and a light's axes are taken from."""
    _finite(field, _array(field, matrix, np.float64, (3, 4)))
    axes = matrix[:, :3]
    if not np.allclose(axes.T @ axes, np.eye(3), rtol=0.0, atol=1e-3):
        raise _Invalid(field, "scales or shears; its axes must be perpendicular unit vectors")


def shown(value: Any) -> str:
    """A value as it is quoted in a message, not too long."""
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
