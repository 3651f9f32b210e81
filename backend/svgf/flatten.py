# SPDX-License-Identifier: Apache-2.0
"""Scene -> FlatScene: the arrays that a tracer reads.

World positions become relative to an origin near the camera while they are still float64, so that a tracer in float32
keeps its precision a million metres away from Blender's origin. The origin lies on a grid as coarse as the scene
allows: it is a pure function of the frame, and stays put while the camera moves little, so that what does not move
keeps the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .effects import Effects, find_effects
from .flat_lights import ENVIRONMENT, Emission, flatten_lights
from .scene import (
    MATERIAL_INPUTS,
    Camera,
    Instances,
    Material,
    MaterialKind,
    Mesh,
    Projection,
    RayVisibility,
    Scene,
    Texture,
    TextureMap,
)

# Determinant over the product of the column lengths, below which a matrix counts as not invertible.
SMALLEST_DETERMINANT = 1e-12

# First column of each value in FlatScene.materials. Names are those of Material, and "normal": the texel of the normal
# map; normal_uv_layer: of the tangents, -1 without a normal map; map_start, map_count: its rows of material_maps;
# light_emission: its radiance as a light that paths aim at, 0 where that depends on the place or the direction (its
# light is then found by the rays that hit it).
MATERIAL_COLUMNS = {
    "base_color": 0,
    "kind": 3,
    "metallic": 4,
    "roughness": 5,
    "ior": 6,
    "transmission": 7,
    "specular_ior_level": 8,
    "specular_tint": 9,
    "emission": 12,
    "alpha": 15,
    "diffuse_roughness": 16,
    "anisotropic": 17,
    "anisotropic_rotation": 18,
    "normal_strength": 19,
    "coat_weight": 20,
    "coat_roughness": 21,
    "coat_ior": 22,
    "sheen_weight": 23,
    "coat_tint": 24,
    "sheen_roughness": 27,
    "sheen_tint": 28,
    "factor": 31,
    "first": 32,
    "second": 33,
    "factor_fresnel_ior": 34,
    "factor_facing_blend": 35,
    "normal": 36,
    "normal_uv_layer": 39,
    "map_start": 40,
    "map_count": 41,
    "tangent_uv_layer": 42,
    "multiscatter": 43,
    "light_emission": 44,
    "coat_normal_mapped": 47,
}
# Beyond these Fresnel's terms lose their digits.
SMALLEST_IOR, LARGEST_IOR = 1e-5, 1000.0
# A normal map's texel that leaves the normal as it is.
NEUTRAL_NORMAL = (0.5, 0.5, 1.0)

_INSTANCE_ARRAYS = (
    "instance_mesh",
    "object_to_world",
    "world_to_object",
    "previous_object_to_world",
    "object_id",
    "material_start",
    "material_table",
    "visibility",
    "terminator_offset",
)
# Fields of FlatScene that flatten_lights makes.
_LIGHT_ARRAYS = (
    "light_kind",
    "light_data",
    "light_visibility",
    "light_tree",
    "light_of_leaf",
    "emitter",
    "emitters",
    "light_of_triangle",
    "emission_map",
    "emission_maps",
    "row_cdf",
    "column_cdf",
)

_FLOAT32_MAX = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class FlatScene:
    """One frame, ready for ``Tracer``. float64 unless said; world positions are relative to ``origin``.

    scene: what it was made from. origin: [3] metres. extent: diagonal of the bounding box of all instances, metres.
    effects: see ``Effects``. warnings: the scene's and this module's own.

    meshes, textures: the scene's. mesh_bounds: [meshes, 2, 3] smallest and largest finite vertex, NaN without any.
    Instances (N rows): instance_mesh int32 [N], object_to_world, world_to_object, previous_object_to_world [N, 3, 4],
    object_id int32 [N], material_start int32 [N], material_table int32, visibility uint8 [N], terminator_offset [N].

    materials [M, 48]: see MATERIAL_COLUMNS; 47 is zero. material_maps [K, 12], those of a material one after the other:
    column that the value goes to 0, texture 1, channel 2 (-1: RGB), uv_layer 3, uv_transform 4:10, 10:12 zero.

    camera_to_world, previous_camera_to_world [3, 4]; window, previous_window [4] (left, right, bottom, top); clip [2];
    lens, previous_lens [6]: 1 if orthographic, radius and focus distance of the aperture, its blades, rotation, width
    over height.

    world_radiance [3], world_visibility, environment: index into textures or -1, world_to_environment [9];
    backdrop_radiance [3], backdrop_environment: what the camera's rays see.
    row_cdf float32 [rows + 1], column_cdf float32 [rows, columns + 1]: by which directions of the environment are
    sampled, see svgf.environment; empty where they are not.

    Lights (L rows: suns, the environment, other lamps, triangles that shine, each in the scene's order): light_kind
    int32 [L] (LightKind, TRIANGLE or ENVIRONMENT), light_visibility uint8 [L], light_data [L, 24]:

    - 0:3 position; TRIANGLE: vertex 0
    - 3:6, 6:9, 9:12 unit axes X, Y, Z, the lamp shines along -Z; TRIANGLE: the edges v1 - v0, v2 - v0, the unit normal;
      ENVIRONMENT: 9:12 the mean direction of what is sampled of it, of length 1 or less
    - 12:15 radiance; without size: intensity in W / sr, of a sun irradiance in W / m^2
    - 15:17 POINT, SPOT: radius, 0; SUN: sine and cosine of half the angle; area lamps: full widths
    - 17 area of area lamps and triangles
    - 18, 19 SPOT: cosine of half the angle, 1 / width of the blend in cosine; area lamps: tangent of half the spread,
      1 / (tangent - angle), 0 without one
    - 20 whether without size, 23 soft falloff
    - 21, 22 for choosing it, SUN, ENVIRONMENT: the least share of its irradiance that surfaces count with however they
      face, and that irradiance, in the light tree's unit; others: where its share of its leaf ends, and that share

    light_tree [2^(depth + 1) - 1, 12] and light_of_leaf int32 [2^depth]: see svgf.light_tree, of all lights but those
    two kinds. A leaf is one light, or that one and others after it: the few triangles of an instance.

    The light of a triangle: emitter int32 [N] is the row of an instance in emitters int32 [E, 2], or -1; its light is
    emitters[e, 0] + light_of_triangle[emitters[e, 1] + triangle] (int32), where that last number is not -1.
    emission_map int32 [L]: row of emission_maps [K, 8], by which a triangle's radiance is multiplied, or -1: texture
    coordinates of the corners 0:6, texture 6.
    """

    scene: Scene
    origin: np.ndarray
    extent: float
    effects: Effects
    warnings: tuple[str, ...]

    meshes: tuple[Mesh, ...]
    mesh_bounds: np.ndarray
    instance_mesh: np.ndarray
    object_to_world: np.ndarray
    world_to_object: np.ndarray
    previous_object_to_world: np.ndarray
    object_id: np.ndarray
    material_start: np.ndarray
    material_table: np.ndarray
    visibility: np.ndarray
    terminator_offset: np.ndarray

    materials: np.ndarray
    material_maps: np.ndarray
    textures: tuple[Texture, ...]

    camera_to_world: np.ndarray
    previous_camera_to_world: np.ndarray
    window: np.ndarray
    previous_window: np.ndarray
    clip: np.ndarray
    lens: np.ndarray
    previous_lens: np.ndarray

    world_radiance: np.ndarray
    world_visibility: int
    environment: int
    world_to_environment: np.ndarray
    backdrop_radiance: np.ndarray
    backdrop_environment: int
    row_cdf: np.ndarray
    column_cdf: np.ndarray

    light_kind: np.ndarray
    light_data: np.ndarray
    light_visibility: np.ndarray
    light_tree: np.ndarray
    light_of_leaf: np.ndarray
    emitter: np.ndarray
    emitters: np.ndarray
    light_of_triangle: np.ndarray
    emission_map: np.ndarray
    emission_maps: np.ndarray

    @property
    def environment_light(self) -> int:
        """The environment's row of the lights, -1 where it is none of them."""
        found = np.flatnonzero(self.light_kind == ENVIRONMENT)
        return int(found[0]) if len(found) else -1


def flatten(scene: Scene, previous: FlatScene | None = None) -> FlatScene:
    """Flatten one frame. Arrays that would come out the same are ``previous``' own (``is``), so that a caller can tell
    what changed.

    Instances that cannot be inverted (a scale of zero, a NaN) are left out, with a warning.
    """
    same_meshes = previous is not None and _same_items(scene.meshes, previous.meshes)
    same_instances = same_meshes and scene.instances is previous.scene.instances
    same_materials = previous is not None and _same_items(scene.materials, previous.scene.materials)

    mesh_bounds = previous.mesh_bounds if same_meshes else _mesh_bounds(scene.meshes, previous)
    extent = previous.extent if same_instances else _extent(scene.instances, mesh_bounds)
    origin = _origin(scene.camera.camera_to_world, extent)
    same_instances = same_instances and np.array_equal(origin, previous.origin)
    if same_instances:
        instance_arrays = {name: getattr(previous, name) for name in _INSTANCE_ARRAYS}
        warnings = previous.warnings[len(previous.scene.warnings) :]
    else:
        instance_arrays, warnings = _instance_arrays(scene, origin)
    materials = previous.materials if same_materials else material_rows(scene.materials)
    material_maps = previous.material_maps if same_materials else material_map_rows(scene.materials)

    same_lights = previous is not None and _same_items(scene.lights, previous.scene.lights)
    same_world = previous is not None and _same_world(scene, previous.scene)
    if same_instances and same_materials and same_lights and same_world:
        light_arrays = {name: getattr(previous, name) for name in _LIGHT_ARRAYS}
    else:
        emission = materials[:, MATERIAL_COLUMNS["light_emission"] :][:, :3]
        emission = Emission(*_with_emission_maps(scene.materials, emission))
        light_arrays = flatten_lights(scene, instance_arrays, emission, origin)

    return FlatScene(
        scene=scene,
        origin=origin,
        extent=extent,
        effects=find_effects(scene),
        warnings=(*scene.warnings, *warnings),
        meshes=tuple(scene.meshes),
        mesh_bounds=mesh_bounds,
        **instance_arrays,
        materials=materials,
        material_maps=material_maps,
        textures=tuple(scene.textures),
        camera_to_world=_relative(scene.camera.camera_to_world, origin),
        previous_camera_to_world=_relative(scene.previous_camera.camera_to_world, origin),
        window=np.asarray(scene.camera.window, dtype=np.float64),
        previous_window=np.asarray(scene.previous_camera.window, dtype=np.float64),
        clip=np.asarray(scene.camera.clip, dtype=np.float64),
        lens=_lens(scene.camera),
        previous_lens=_lens(scene.previous_camera),
        world_radiance=np.asarray(scene.world.radiance, dtype=np.float64),
        world_visibility=int(scene.world.visibility),
        environment=scene.world.environment,
        world_to_environment=np.asarray(scene.world.world_to_environment, dtype=np.float64),
        backdrop_radiance=np.asarray(scene.world.backdrop[0], dtype=np.float64),
        backdrop_environment=scene.world.backdrop[1],
        **light_arrays,
    )


def _same_items(items: tuple, others: tuple) -> bool:
    return items is others or (len(items) == len(others) and all(a is b for a, b in zip(items, others)))


def _same_world(scene: Scene, other: Scene) -> bool:
    if scene.world != other.world:
        return False
    used = [index for index in (scene.world.environment, scene.world.backdrop_environment) if index >= 0]
    return all(scene.textures[index] is other.textures[index] for index in used)


def _lens(camera: Camera) -> np.ndarray:
    """[6], see FlatScene."""
    lens = camera.aperture
    is_orthographic = camera.projection is Projection.ORTHOGRAPHIC
    row = (is_orthographic, lens.radius, lens.focus_distance, lens.blades, lens.rotation, 1.0 / lens.ratio)
    return np.array(row, dtype=np.float64)


def _transforms(rows: np.ndarray) -> np.ndarray:
    return np.asarray(rows, dtype=np.float64).reshape(-1, 3, 4)


def _relative(transform: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Transforms [..., 3, 4] to the world around origin."""
    result = np.array(transform, dtype=np.float64)
    result[..., 3] -= origin
    return result


def _mesh_bounds(meshes: tuple[Mesh, ...], previous: FlatScene | None) -> np.ndarray:
    """[meshes, 2, 3]: smallest and largest finite vertex of each mesh, NaN for a mesh without any."""
    known = {} if previous is None else {id(mesh): row for mesh, row in zip(previous.meshes, previous.mesh_bounds)}
    bounds = np.full((len(meshes), 2, 3), np.nan)
    for row, mesh in zip(bounds, meshes):
        if id(mesh) in known:
            row[:] = known[id(mesh)]
            continue
        positions = mesh.positions[np.isfinite(mesh.positions).all(axis=1)]
        if len(positions):
            row[0], row[1] = positions.min(axis=0), positions.max(axis=0)
    return bounds


def _inverse(transform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of the linear parts of transforms [N, 3, 4] as [N, 3, 3], and bool [N]: whether there is one."""
    column_x, column_y, column_z = (transform[:, :, axis] for axis in range(3))
    with np.errstate(all="ignore"):
        # The rows of an inverse are the cross products of the columns over the determinant.
        cofactors = np.stack(
            [np.cross(column_y, column_z), np.cross(column_z, column_x), np.cross(column_x, column_y)], axis=1
        )
        determinant = np.einsum("ni,ni->n", column_x, cofactors[:, 0])
        inverse = cofactors / determinant[:, None, None]
        lengths = np.prod(np.linalg.norm(transform[:, :, :3], axis=1), axis=1)
        exists = np.abs(determinant) > SMALLEST_DETERMINANT * lengths
        for matrix in (transform, inverse):
            exists &= (np.abs(matrix) < _FLOAT32_MAX).all(axis=(1, 2))
    return inverse, exists


def _extent(instances: Instances, mesh_bounds: np.ndarray) -> float:
    """Diagonal of the box around the boxes of all instances; 1 for a scene without size."""
    transform = _transforms(instances.object_to_world)
    bounds = mesh_bounds[instances.mesh]
    with np.errstate(invalid="ignore"):
        centre = np.einsum("nij,nj->ni", transform[:, :, :3], bounds.mean(axis=1)) + transform[:, :, 3]
        half = np.einsum("nij,nj->ni", np.abs(transform[:, :, :3]), (bounds[:, 1] - bounds[:, 0]) / 2)
    filled = np.isfinite(centre + half).all(axis=1)
    if not filled.any():
        return 1.0
    size = (centre + half)[filled].max(axis=0) - (centre - half)[filled].min(axis=0)
    diagonal = float(np.linalg.norm(size))
    return diagonal if 0.0 < diagonal < np.inf else 1.0


def _origin(camera_to_world: np.ndarray, extent: float) -> np.ndarray:
    grid = 2.0 ** np.floor(np.log2(extent)) / 64.0
    return np.round(np.asarray(camera_to_world, dtype=np.float64)[:, 3] / grid) * grid


def _instance_arrays(scene: Scene, origin: np.ndarray) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The arrays of _INSTANCE_ARRAYS, and warnings."""
    instances = scene.instances
    object_to_world = _relative(_transforms(instances.object_to_world), origin)
    previous = _relative(_transforms(instances.previous_object_to_world), origin)
    inverse, exists = _inverse(object_to_world)
    mesh = np.asarray(instances.mesh, dtype=np.int32)
    object_id = np.asarray(instances.object_id, dtype=np.int32)
    material_start = np.asarray(instances.material_start, dtype=np.int32)
    visibility = np.full(len(mesh), int(RayVisibility.ALL), dtype=np.uint8)
    if instances.visibility is not None:
        visibility[:] = instances.visibility
    terminator_offset = np.zeros(len(mesh))
    if instances.terminator_offset is not None:
        terminator_offset[:] = instances.terminator_offset
    warnings: tuple[str, ...] = ()
    if not exists.all():
        names = ", ".join(sorted({scene.meshes[index].name for index in np.unique(mesh[~exists])})[:3])
        count = np.count_nonzero(~exists)
        warnings = (f"{count} instance(s) left out, their transform has no inverse (meshes: {names}).",)
        object_to_world, previous, inverse = object_to_world[exists], previous[exists], inverse[exists]
        mesh, object_id, material_start = mesh[exists], object_id[exists], material_start[exists]
        visibility, terminator_offset = visibility[exists], terminator_offset[exists]

    unknown = ~np.isfinite(previous).all(axis=(1, 2))
    previous[unknown] = object_to_world[unknown]
    translation = -np.einsum("nij,nj->ni", inverse, object_to_world[:, :, 3])
    return {
        "instance_mesh": mesh,
        "object_to_world": object_to_world,
        "world_to_object": np.concatenate([inverse, translation[:, :, None]], axis=2),
        "previous_object_to_world": previous,
        "object_id": object_id,
        "material_start": material_start,
        "material_table": np.asarray(instances.material_table, dtype=np.int32),
        "visibility": visibility,
        "terminator_offset": terminator_offset,
    }, warnings


def material_rows(materials: tuple[Material, ...]) -> np.ndarray:
    """[M, 48], see FlatScene."""
    rows = np.zeros((len(materials), 48))
    map_start = 0
    for row, material in zip(rows, materials):
        for name, column in MATERIAL_COLUMNS.items():
            value = getattr(material, name, None)
            if value is not None:
                row[column : column + np.size(value)] = value
        for name in ("ior", "coat_ior"):
            row[MATERIAL_COLUMNS[name]] = np.clip(row[MATERIAL_COLUMNS[name]], SMALLEST_IOR, LARGEST_IOR)
        row[MATERIAL_COLUMNS["normal"] :][:3] = NEUTRAL_NORMAL
        has_normal = "normal" in material.maps and material.may_have("normal_strength")
        row[MATERIAL_COLUMNS["normal_uv_layer"]] = material.maps["normal"].uv_layer if has_normal else -1
        row[MATERIAL_COLUMNS["map_start"]] = map_start
        row[MATERIAL_COLUMNS["map_count"]] = len(material.maps)
        map_start += len(material.maps)
    emissions: dict[int, np.ndarray | None] = {}
    for index, row in enumerate(rows):
        emission = _light_emission(materials, index, emissions)
        if emission is not None:
            row[MATERIAL_COLUMNS["light_emission"] :][:3] = emission
    return rows


def material_map_rows(materials: tuple[Material, ...]) -> np.ndarray:
    """[K, 12], see FlatScene."""
    rows = [
        (
            MATERIAL_COLUMNS[name],
            source.texture,
            -1 if MATERIAL_INPUTS[name] == 3 else source.channel,
            source.uv_layer,
            *source.uv_transform,
            0,
            0,
        )
        for material in materials
        for name, source in material.maps.items()
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 12)


def _light_emission(
    materials: tuple[Material, ...], index: int, known: dict[int, np.ndarray | None]
) -> np.ndarray | None:
    """Radiance [3] of a material; None where it depends on the place or the direction."""
    if index not in known:
        material = materials[index]
        emission = np.array(material.emission, dtype=np.float64)
        if material.is_mix:
            parts = [_light_emission(materials, part, known) for part in (material.first, material.second)]
            known[index] = None if any(part is None for part in parts) else _mixed_emission(material, *parts)
        elif material.kind == MaterialKind.DIFFUSE or not emission.any():
            known[index] = None if "emission" in material.maps and emission.any() else emission
        elif material.kind == MaterialKind.PRINCIPLED:
            layered = material.may_have("coat_weight") or material.may_have("sheen_weight")
            varies = layered or "emission" in material.maps or "alpha" in material.maps
            known[index] = None if varies else emission * material.alpha
        else:
            known[index] = np.zeros(3)
    return known[index]


def _with_emission_maps(
    materials: tuple[Material, ...], emission: np.ndarray
) -> tuple[np.ndarray, tuple[TextureMap | None, ...]]:
    """Radiance [M, 3] that a map multiplies where there is one, and the maps. Of materials of which nothing else but
    the map varies with the place."""
    emission, maps = emission.copy(), []
    for row, material in zip(emission, materials):
        texture_map = material.maps.get("emission")
        if texture_map is not None and not material.is_mix:
            bare = replace(material, maps={name: item for name, item in material.maps.items() if name != "emission"})
            constant = _light_emission((bare,), 0, {})
            texture_map = texture_map if constant is not None else None
            row[:] = 0.0 if constant is None else constant
        maps.append(None if material.is_mix else texture_map)
    return emission, tuple(maps)


def _mixed_emission(material: Material, first: np.ndarray, second: np.ndarray) -> np.ndarray | None:
    if material.kind == MaterialKind.ADD:
        return first + second
    varies = "factor" in material.maps or material.factor_fresnel_ior > 0.0 or material.factor_facing_blend >= 0.0
    if varies and (first.any() or second.any()):
        return None
    return first * (1.0 - material.factor) + second * material.factor
