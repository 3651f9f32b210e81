# SPDX-License-Identifier: Apache-2.0
"""Scene -> FlatScene: the arrays that a tracer reads.

World positions become relative to an origin near the camera while they are still float64, so that a tracer in float32
keeps its precision a million metres away from Blender's origin. The origin lies on a grid as coarse as the scene
allows: it is a pure function of the frame, and stays put while the camera moves little, so that what does not move
keeps the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .effects import Effects, find_effects, instances_by_mesh
from .scene import MATERIAL_INPUTS, Instances, Light, LightKind, Material, MaterialKind, Mesh, Scene, Texture

TRIANGLE = 5  # light_kind after those of LightKind

# Radiance of an area lamp, times its area, over its power.
AREA_LAMP_RADIANCE = 1.0 / np.pi

# An area lamp without width is a limit that no sampling reaches; this narrow one has the same power. Metres.
SMALLEST_LAMP_WIDTH = 1e-6

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
}
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
)
_LIGHT_ARRAYS = ("light_kind", "light_data", "light_probability", "light_cdf", "triangle_light_scale")

_FLOAT32_MAX = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class FlatScene:
    """One frame, ready for ``Tracer``. float64 unless said; world positions are relative to ``origin``.

    scene: what it was made from. origin: [3] metres. extent: diagonal of the bounding box of all instances, metres.
    effects: see ``Effects``. warnings: the scene's and this module's own.

    meshes, textures: the scene's. mesh_bounds: [meshes, 2, 3] smallest and largest finite vertex, NaN without any.
    Instances (N rows): instance_mesh int32 [N], object_to_world, world_to_object, previous_object_to_world [N, 3, 4],
    object_id int32 [N], material_start int32 [N], material_table int32.

    materials [M, 48]: see MATERIAL_COLUMNS; 47 is zero. material_maps [K, 12], those of a material one after the other:
    column that the value goes to 0, texture 1, channel 2 (-1: RGB), uv_layer 3, uv_transform 4:10, 10:12 zero.

    camera_to_world, previous_camera_to_world [3, 4]; window, previous_window [4] (left, right, bottom, top); clip [2].
    world_radiance [3].

    Lights (L rows; lamps that shine, in the scene's order, then triangles that do, in instance order): light_kind int32
    [L] (LightKind or TRIANGLE), light_probability [L], light_cdf [L + 1] from 0 to 1, and light_data [L, 24]:

    - 0:3 position; TRIANGLE: vertex 0
    - 3:6, 6:9, 9:12 unit axes X, Y, Z, the lamp shines along -Z; TRIANGLE: the edges v1 - v0, v2 - v0, the unit normal
    - 12:15 radiance; without size: intensity in W / sr, of a sun irradiance in W / m^2
    - 15:17 POINT, SPOT: radius, 0; SUN: sine and cosine of half the angle; area lamps: full widths
    - 17 area of area lamps and triangles
    - 18, 19 SPOT: cosine of half the angle, 1 / width of the blend in cosine
    - 20 whether without size, 21:24 zero

    A triangle that a ray hits is chosen as light with probability mean(emission) * area * triangle_light_scale.
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

    materials: np.ndarray
    material_maps: np.ndarray
    textures: tuple[Texture, ...]

    camera_to_world: np.ndarray
    previous_camera_to_world: np.ndarray
    window: np.ndarray
    previous_window: np.ndarray
    clip: np.ndarray

    world_radiance: np.ndarray
    light_kind: np.ndarray
    light_data: np.ndarray
    light_probability: np.ndarray
    light_cdf: np.ndarray
    triangle_light_scale: float


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

    if same_instances and same_materials and _same_items(scene.lights, previous.scene.lights):
        light_arrays = {name: getattr(previous, name) for name in _LIGHT_ARRAYS}
    else:
        lamps = _lamps(scene.lights, origin, extent)
        triangles = _emissive_triangles(scene.meshes, instance_arrays, materials)
        light_arrays = _light_arrays(lamps, triangles)

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
        world_radiance=np.asarray(scene.world.radiance, dtype=np.float64),
        **light_arrays,
    )


def _same_items(items: tuple, others: tuple) -> bool:
    return items is others or (len(items) == len(others) and all(a is b for a, b in zip(items, others)))


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
    warnings: tuple[str, ...] = ()
    if not exists.all():
        names = ", ".join(sorted({scene.meshes[index].name for index in np.unique(mesh[~exists])})[:3])
        count = np.count_nonzero(~exists)
        warnings = (f"{count} instance(s) left out, their transform has no inverse (meshes: {names}).",)
        object_to_world, previous, inverse = object_to_world[exists], previous[exists], inverse[exists]
        mesh, object_id, material_start = mesh[exists], object_id[exists], material_start[exists]

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


def _mixed_emission(material: Material, first: np.ndarray, second: np.ndarray) -> np.ndarray | None:
    if material.kind == MaterialKind.ADD:
        return first + second
    varies = "factor" in material.maps or material.factor_fresnel_ior > 0.0 or material.factor_facing_blend >= 0.0
    if varies and (first.any() or second.any()):
        return None
    return first * (1.0 - material.factor) + second * material.factor


def _lamps(lights: tuple[Light, ...], origin: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds, rows and selection weights of the lamps that shine."""
    kinds, rows, weights = [], [], []
    for light in lights:
        row, weight = _lamp(light, origin, extent)
        if 0.0 < weight < np.inf:
            kinds.append(int(light.kind))
            rows.append(row)
            weights.append(weight)
    return np.array(kinds, dtype=np.int32), np.array(rows).reshape(-1, 24), np.array(weights, dtype=np.float64)


def _lamp(light: Light, origin: np.ndarray, extent: float) -> tuple[np.ndarray, float]:
    row = np.zeros(24)
    transform = _relative(light.light_to_world, origin)
    axes = transform[:, :3].T
    row[0:3] = transform[:, 3]
    row[3:12] = (axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)).ravel()
    power = np.asarray(light.power, dtype=np.float64)
    weight = power.mean()
    if light.kind in (LightKind.POINT, LightKind.SPOT):
        radius = max(light.size[0], 0.0)
        intensity = power / (4.0 * np.pi)
        row[12:15] = intensity / (np.pi * radius**2) if radius > 0.0 else intensity
        row[15] = radius
        row[20] = radius == 0.0
        row[23] = light.soft_falloff and radius > 0.0
    elif light.kind == LightKind.SUN:
        sine, cosine = np.sin(light.size[0] / 2.0), np.cos(light.size[0] / 2.0)
        row[12:15] = power / (np.pi * sine**2) if sine > 0.0 else power
        row[15:17] = sine, cosine
        row[20] = sine <= 0.0
        weight *= np.pi * (extent / 2.0) ** 2
    else:
        widths = np.maximum(light.size, SMALLEST_LAMP_WIDTH)
        area = widths.prod() * (np.pi / 4.0 if light.kind == LightKind.ELLIPSE else 1.0)
        row[12:15] = power * AREA_LAMP_RADIANCE / area
        row[15:17] = widths
        row[17] = area
    if light.kind == LightKind.SPOT:
        cos_half = np.cos(light.spot_angle / 2.0)
        row[18] = cos_half
        row[19] = 1.0 / max(1e-3, (1.0 - cos_half) * light.spot_blend)
    return row, float(weight)


def _emissive_triangles(
    meshes: tuple[Mesh, ...], instances: dict, materials: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds, rows and selection weights of the triangles that emit, in instance order."""
    emission = materials[:, MATERIAL_COLUMNS["light_emission"] :][:, :3]
    table = instances["material_table"]
    emits = (emission.mean(axis=1) > 0.0)[table] if len(table) else np.zeros(0, dtype=bool)
    owners, vertices, radiances = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    if emits.any():
        order, bounds = instances_by_mesh(instances["instance_mesh"], len(meshes))
        for index in np.flatnonzero(np.diff(bounds)):
            members = order[bounds[index] : bounds[index + 1]]
            slots = np.asarray(meshes[index].material_slots)
            starts, group = np.unique(instances["material_start"][members], return_inverse=True)
            by_start = np.argsort(group, kind="stable")
            ends = np.cumsum(np.bincount(group, minlength=len(starts)))
            for which in np.flatnonzero(emits[np.add.outer(starts, np.unique(slots))].any(axis=1)):
                users = members[by_start[(ends[which - 1] if which else 0) : ends[which]]]
                entries = starts[which] + slots
                chosen = np.flatnonzero(emits[entries])
                corners = meshes[index].positions[meshes[index].triangles[chosen]].astype(np.float64)
                transform = instances["object_to_world"][users]
                world = np.einsum("nij,tcj->ntci", transform[:, :, :3], corners) + transform[:, None, None, :, 3]
                owners.append(np.repeat(users, len(chosen)))
                vertices.append(world.reshape(-1, 3, 3))
                radiances.append(np.tile(emission[table[entries[chosen]]], (len(users), 1)))
    owner, vertex, radiance = (np.concatenate(parts) for parts in (owners, vertices, radiances))
    in_order = np.argsort(owner, kind="stable")
    vertex, radiance = vertex[in_order], radiance[in_order]

    with np.errstate(invalid="ignore", over="ignore"):
        edge1, edge2 = vertex[:, 1] - vertex[:, 0], vertex[:, 2] - vertex[:, 0]
        normal = np.cross(edge1, edge2)
        length = np.linalg.norm(normal, axis=1)
        weight = radiance.mean(axis=1) * (length / 2.0) * np.pi
        solid = (weight > 0.0) & (weight < np.inf)
    rows = np.zeros((np.count_nonzero(solid), 24))
    rows[:, 0:3] = vertex[solid, 0]
    rows[:, 3:6], rows[:, 6:9] = edge1[solid], edge2[solid]
    rows[:, 9:12] = normal[solid] / length[solid, None]
    rows[:, 12:15] = radiance[solid]
    rows[:, 17] = length[solid] / 2.0
    return np.full(len(rows), TRIANGLE, dtype=np.int32), rows, weight[solid]


def _light_arrays(lamps: tuple, triangles: tuple) -> dict:
    kind, data, weight = (np.concatenate(parts) for parts in zip(lamps, triangles))
    total = weight.sum()
    cdf = np.zeros(len(weight) + 1)
    if len(weight):
        np.cumsum(weight / total, out=cdf[1:])
        cdf[1:] /= cdf[-1]
    return {
        "light_kind": kind,
        "light_data": data,
        "light_probability": weight / total if len(weight) else weight,
        "light_cdf": cdf,
        "triangle_light_scale": float(np.pi / total) if len(weight) else 0.0,
    }
