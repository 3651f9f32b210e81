# SPDX-License-Identifier: Apache-2.0
"""The lights of a FlatScene: lamps, the environment and triangles that shine, and how one of them is chosen."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .effects import instances_by_mesh
from .environment import linear_pixels, mean_radiance, sampling_map
from .light_tree import LightBounds, build_light_tree
from .scene import Light, LightKind, Mesh, Scene, TextureMap

# light_kind after those of LightKind
TRIANGLE = 5
ENVIRONMENT = 6

# Columns of light_data by which a light is chosen, see FlatScene.
AMBIENT, WEIGHT = 21, 22
SHARE_END = AMBIENT

# The emissive triangles of an instance that has no more of them, as a box has, are one leaf of the light tree.
LARGEST_LEAF = 12

# Share of a sun's irradiance that surfaces turned away from it count with: they may have a coat that is not.
LEAST_AMBIENT = 0.02

# What the samples of an environment bring differs more than what those of one lamp do, so it is chosen as if it were
# brighter. Least variance, of 1, 2, 3 (and 0.3, 10): in one scene 12 % less than with 1, in another 5 %.
ENVIRONMENT_FACTOR = 2.0

# Radiance of an area lamp, times its area, over its power.
AREA_LAMP_RADIANCE = 1.0 / np.pi

# An area lamp without width is a limit that no sampling reaches; this narrow one has the same power. Metres.
SMALLEST_LAMP_WIDTH = 1e-6

# The narrowest spread, as in Cycles. Radians.
SMALLEST_SPREAD = np.pi / 180.0


@dataclass
class Emission:
    """Of materials. radiance: [M, 3], by which the map is multiplied where there is one."""

    radiance: np.ndarray
    maps: tuple[TextureMap | None, ...]


@dataclass
class _Rows:
    """Lights of one kind. intensity: [n], W / sr along the axis, of suns and the environment irradiance; for choosing
    one."""

    kind: np.ndarray
    data: np.ndarray
    visibility: np.ndarray
    intensity: np.ndarray


def flatten_lights(
    scene: Scene,
    instances: dict[str, np.ndarray],
    emission: Emission,
    origin: np.ndarray,
) -> dict[str, Any]:
    """The fields of a FlatScene that are about choosing and finding lights. instances: its fields of instances."""
    lamps = _lamps(scene.lights, origin)
    environment, row_cdf, column_cdf = _environment(scene)
    triangles, emitters = _emissive_triangles(scene, instances, emission)
    is_sun = lamps.kind == LightKind.SUN
    groups = (_chosen(lamps, is_sun), environment, _chosen(lamps, ~is_sun), triangles)
    kind, data, visibility, intensity = (
        np.concatenate([getattr(rows, name) for rows in groups])
        for name in ("kind", "data", "visibility", "intensity")
    )
    # Only their ratios count. These fit into every float.
    intensity /= intensity.max(initial=np.finfo(float).tiny)
    everywhere = np.count_nonzero(is_sun) + len(environment.kind)
    first_triangle = everywhere + np.count_nonzero(~is_sun)
    emitters["emitters"][:, 0] += first_triangle
    emission_map = np.full(len(kind), -1, dtype=np.int32)
    emission_map[first_triangle:] = emitters.pop("emission_map")
    owner = np.append(np.full(first_triangle - everywhere, -1), emitters.pop("owner"))
    data[:everywhere, WEIGHT] = intensity[:everywhere]
    first, bounds, data[everywhere:, SHARE_END], data[everywhere:, WEIGHT] = _leaves(
        kind[everywhere:], data[everywhere:], intensity[everywhere:], owner
    )
    tree, light_of_leaf = build_light_tree(bounds)
    light_of_leaf[light_of_leaf >= 0] = everywhere + first[light_of_leaf[light_of_leaf >= 0]]
    return {
        "light_kind": kind,
        "light_data": data,
        "light_visibility": visibility,
        "light_tree": tree,
        "light_of_leaf": light_of_leaf,
        "emission_map": emission_map,
        **emitters,
        "row_cdf": row_cdf,
        "column_cdf": column_cdf,
    }


def _chosen(rows: _Rows, chosen: np.ndarray) -> _Rows:
    return _Rows(*(values[chosen] for values in vars(rows).values()))


def _leaves(
    kind: np.ndarray, data: np.ndarray, intensity: np.ndarray, owner: np.ndarray
) -> tuple[np.ndarray, LightBounds, np.ndarray, np.ndarray]:
    """Of n lights that are somewhere, the leaves of the light tree: the first light and the bounds of each leaf; where
    the share of each light in its leaf ends, and that share, [n]. owner: [n], instances of triangles, else -1."""
    count = len(owner)
    starts = np.flatnonzero(np.append(True, (owner[1:] != owner[:-1]) | (owner[1:] < 0))[:count])
    of_owner = np.diff(np.append(starts, count))
    is_first = np.repeat(of_owner > LARGEST_LEAF, of_owner)
    is_first[starts] = True
    first = np.flatnonzero(is_first)
    sizes = np.diff(np.append(first, count))
    each = _bounds(kind, data, intensity)
    bounds = each.rows(first)
    if count:
        bounds.low, bounds.high = np.minimum.reduceat(each.low, first), np.maximum.reduceat(each.high, first)
        bounds.intensity = np.add.reduceat(intensity, first)
        cosine = np.abs(np.einsum("ni,ni->n", each.axis, np.repeat(bounds.axis, sizes, axis=0)))
        is_flat = np.minimum.reduceat(cosine, first) > 1.0 - 1e-6
        bounds.cos_normals = np.where(is_flat | (sizes == 1), bounds.cos_normals, -1.0)
    total = np.repeat(bounds.intensity, sizes)
    share = np.divide(intensity, total, out=np.zeros(count), where=total > 0.0)
    end = np.cumsum(share)
    end -= np.repeat(end[first] - share[first], sizes)
    end[first + sizes - 1] = 1.0
    return first, bounds, end, share


def _bounds(kind: np.ndarray, data: np.ndarray, intensity: np.ndarray) -> LightBounds:
    """Of lights that are somewhere."""
    position, axis_x, axis_y, axis_z = (data[:, i : i + 3] for i in (0, 3, 6, 9))
    size, tangent = data[:, 15:17], data[:, 18]
    is_triangle = kind == TRIANGLE
    is_ball = (kind == LightKind.POINT) | (kind == LightKind.SPOT)
    # Of a triangle, three corners; of an area lamp, the box of its rectangle; of a ball, its cube.
    corners = np.stack([position, position + axis_x, position + axis_y])
    half = np.where(is_ball[:, None], size[:, 0:1], (np.abs(axis_x) * size[:, 0:1] + np.abs(axis_y) * size[:, 1:2]) / 2)
    low = np.where(is_triangle[:, None], corners.min(axis=0), position - half)
    high = np.where(is_triangle[:, None], corners.max(axis=0), position + half)
    # An area lamp with a spread fades out at its angle. A spot is as bright all over its cone, but for the blend: as if
    # it were many that each shine straight on, and hardly beside that.
    has_spread = ~is_triangle & ~is_ball & (data[:, 19] > 0.0)
    cos_emission = np.where(has_spread, np.cos(np.arctan(np.where(has_spread, tangent, 0.0))), 0.0)
    is_spot = kind == LightKind.SPOT
    cos_normals = np.where(is_spot, data[:, 18], np.where(kind == LightKind.POINT, -1.0, 1.0))
    return LightBounds(
        low=low,
        high=high,
        axis=np.where(is_triangle[:, None], axis_z, -axis_z),
        cos_normals=cos_normals,
        cos_emission=np.where(is_spot, 1.0 - 1e-6, cos_emission),
        intensity=intensity,
        two_sided=is_triangle,
    )


def _environment(scene: Scene) -> tuple[_Rows, np.ndarray, np.ndarray]:
    """No row or one, row_cdf and column_cdf."""
    world = scene.world
    row_cdf, column_cdf, mean, axis = np.zeros(0, np.float32), np.zeros((0, 1), np.float32), 0.0, np.zeros(3)
    if world.environment >= 0 and max(world.radiance) > 0.0:
        row_cdf, column_cdf, mean, axis = sampling_map(mean_radiance(scene.textures[world.environment]))
    # What is sampled is taken for a sun that sends the directed part of it, and the rest for light from all around, of
    # which a surface gets a quarter.
    irradiance = ENVIRONMENT_FACTOR * float(np.mean(world.radiance)) * mean * 4.0 * np.pi
    count = int(0.0 < irradiance < np.inf)
    data = np.zeros((count, 24))
    data[:, 9:12] = axis @ np.asarray(world.world_to_environment, dtype=np.float64).reshape(3, 3)
    data[:, AMBIENT] = max(LEAST_AMBIENT, (1.0 - np.linalg.norm(axis)) / 4.0)
    rows = _Rows(
        np.full(count, ENVIRONMENT, dtype=np.int32),
        data,
        np.full(count, int(world.visibility), dtype=np.uint8),
        np.full(count, irradiance),
    )
    return rows, row_cdf, column_cdf


def _lamps(lights: tuple[Light, ...], origin: np.ndarray) -> _Rows:
    """The lamps that shine."""
    kinds, rows, intensities, visibilities = [], [], [], []
    for light in lights:
        row, intensity = _lamp(light, origin)
        if 0.0 < intensity < np.inf:
            kinds.append(int(light.kind))
            rows.append(row)
            intensities.append(intensity)
            visibilities.append(int(light.visibility))
    return _Rows(
        np.array(kinds, dtype=np.int32),
        np.array(rows).reshape(-1, 24),
        np.array(visibilities, dtype=np.uint8),
        np.array(intensities, dtype=np.float64),
    )


def _lamp(light: Light, origin: np.ndarray) -> tuple[np.ndarray, float]:
    row = np.zeros(24)
    axes = np.asarray(light.light_to_world, dtype=np.float64)[:, :3].T
    row[0:3] = light.light_to_world[:, 3] - origin
    row[3:12] = (axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)).ravel()
    power = np.asarray(light.power, dtype=np.float64)
    mean = float(power.mean())
    if light.kind in (LightKind.POINT, LightKind.SPOT):
        radius = max(light.size[0], 0.0)
        intensity = mean / (4.0 * np.pi)
        row[12:15] = power / (4.0 * np.pi) / (np.pi * radius**2 if radius > 0.0 else 1.0)
        row[15] = radius
        row[20] = radius == 0.0
        row[23] = light.soft_falloff and radius > 0.0
    elif light.kind == LightKind.SUN:
        sine, cosine = np.sin(light.size[0] / 2.0), np.cos(light.size[0] / 2.0)
        row[12:15] = power / (np.pi * sine**2) if sine > 0.0 else power
        row[15:17] = sine, cosine
        row[20] = sine <= 0.0
        intensity = mean
        # At the horizon half a disk is seen: 2 / (3 pi) of its radius, for a small one.
        row[AMBIENT] = max(LEAST_AMBIENT, sine / 4.0)
    else:
        widths = np.maximum(light.size, SMALLEST_LAMP_WIDTH)
        area = widths.prod() * (np.pi / 4.0 if light.kind == LightKind.ELLIPSE else 1.0)
        row[12:15] = power * AREA_LAMP_RADIANCE / area
        row[15:17] = widths
        row[17] = area
        intensity = mean * AREA_LAMP_RADIANCE
        half_spread = max(light.spread, SMALLEST_SPREAD) / 2.0
        # At pi the tangent is without bound, and nothing fades.
        if half_spread < np.pi / 2.0 - 1e-4:
            row[18] = np.tan(half_spread)
            row[19] = 1.0 / (row[18] - half_spread)
            intensity *= row[18] * row[19]
    if light.kind == LightKind.SPOT:
        cos_half = np.cos(light.spot_angle / 2.0)
        row[18] = cos_half
        row[19] = 1.0 / max(1e-3, (1.0 - cos_half) * light.spot_blend)
    return row, intensity


@dataclass
class _Found:
    """What is gathered of triangles that emit, an item for each mesh and list of materials. owner: instances."""

    owner: list[np.ndarray] = field(default_factory=lambda: [np.zeros(0, dtype=np.int64)])
    vertex: list[np.ndarray] = field(default_factory=lambda: [np.zeros((0, 3, 3))])
    radiance: list[np.ndarray] = field(default_factory=lambda: [np.zeros((0, 3))])
    mean: list[np.ndarray] = field(default_factory=lambda: [np.zeros(0)])  # with the map
    emission_map: list[np.ndarray] = field(default_factory=lambda: [np.zeros(0, dtype=np.int32)])


def _emissive_triangles(
    scene: Scene, instances: dict[str, np.ndarray], emission: Emission
) -> tuple[_Rows, dict[str, np.ndarray]]:
    """The triangles that emit, in instance order, and the fields of a FlatScene that say which light a triangle is."""
    meshes, table = scene.meshes, instances["material_table"]
    mean = _mean_emission(scene, emission)
    emits = (mean > 0.0)[table] if len(table) else np.zeros(0, dtype=bool)
    found, emission_maps, map_count = _Found(), [np.zeros((0, 8))], 0
    emitter = np.full(len(instances["instance_mesh"]), -1, dtype=np.int32)
    light_of_triangle, members_of_table, table_start = [np.zeros(0, dtype=np.int32)], [], 0
    if emits.any():
        order, bounds = instances_by_mesh(instances["instance_mesh"], len(meshes))
        for index in np.flatnonzero(np.diff(bounds)):
            members = order[bounds[index] : bounds[index + 1]]
            slots = np.asarray(meshes[index].material_slots)
            corners = meshes[index].positions[meshes[index].triangles].astype(np.float64)
            starts, group = np.unique(instances["material_start"][members], return_inverse=True)
            by_start = np.argsort(group, kind="stable")
            ends = np.cumsum(np.bincount(group, minlength=len(starts)))
            for which in np.flatnonzero(emits[np.add.outer(starts, np.unique(slots))].any(axis=1)):
                users = members[by_start[(ends[which - 1] if which else 0) : ends[which]]]
                entries = starts[which] + slots
                chosen = np.flatnonzero(emits[entries] & _has_area(corners))
                transform = instances["object_to_world"][users]
                world = np.einsum("nij,tcj->ntci", transform[:, :, :3], corners[chosen])
                world += transform[:, None, None, :, 3]
                found.owner.append(np.repeat(users, len(chosen)))
                found.vertex.append(world.reshape(-1, 3, 3))
                shining = table[entries[chosen]]
                found.radiance.append(np.tile(emission.radiance[shining], (len(users), 1)))
                found.mean.append(np.tile(mean[shining], len(users)))
                has_map = np.array([emission.maps[index] is not None for index in shining], dtype=bool)
                numbers = np.where(has_map, map_count + np.cumsum(has_map) - 1, -1)
                found.emission_map.append(np.tile(numbers, len(users)))
                emission_maps.append(_emission_maps(meshes[index], chosen[has_map], shining[has_map], emission))
                map_count += np.count_nonzero(has_map)
                numbers = np.full(len(slots), -1, dtype=np.int32)
                numbers[chosen] = np.arange(len(chosen))
                light_of_triangle.append(numbers)
                members_of_table.append((users, table_start))
                table_start += len(slots)
    owner = np.concatenate(found.owner)
    in_order = np.argsort(owner, kind="stable")
    owner, vertex, radiance, mean, emission_map = (np.concatenate(parts)[in_order] for parts in vars(found).values())

    emitters = np.zeros((0, 2), dtype=np.int32)
    if members_of_table:
        users = np.concatenate([users for users, _ in members_of_table])
        tables = np.concatenate([np.full(len(users), start) for users, start in members_of_table])
        emitter[users] = np.arange(len(users))
        emitters = np.column_stack([np.searchsorted(owner, users), tables]).astype(np.int32)
    rows = _triangle_rows(vertex, radiance, mean, instances["visibility"][owner])
    return rows, {
        "owner": owner,
        "emitter": emitter,
        "emitters": emitters,
        "light_of_triangle": np.concatenate(light_of_triangle),
        "emission_map": emission_map.astype(np.int32),
        "emission_maps": np.concatenate(emission_maps),
    }


def _mean_emission(scene: Scene, emission: Emission) -> np.ndarray:
    """[M] mean of the channels, over the image where there is a map."""
    color = emission.radiance.copy()
    for row, texture_map in zip(color, emission.maps):
        if texture_map is not None and row.any():
            pixels = linear_pixels(scene.textures[texture_map.texture])
            row *= pixels.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    return color.mean(axis=1)


def _emission_maps(mesh: Mesh, triangles: np.ndarray, materials: np.ndarray, emission: Emission) -> np.ndarray:
    """[n, 8], see FlatScene."""
    rows = np.zeros((len(triangles), 8))
    layers = np.zeros((0, len(mesh.triangles), 3, 2)) if mesh.uvs is None else np.asarray(mesh.uvs)
    layers = layers.reshape(-1, len(mesh.triangles), 3, 2)
    for row, triangle, material in zip(rows, triangles, materials):
        texture_map = emission.maps[material]
        uv = np.zeros((3, 2)) if texture_map.uv_layer >= len(layers) else layers[texture_map.uv_layer, triangle]
        matrix = np.reshape(texture_map.uv_transform, (2, 3))
        row[:6] = (uv @ matrix[:, :2].T + matrix[:, 2]).ravel()
        row[6] = texture_map.texture
    return rows


def _has_area(corners: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", over="ignore"):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.isfinite(normal).all(axis=1) & (normal != 0.0).any(axis=1)


def _triangle_rows(vertex: np.ndarray, radiance: np.ndarray, mean: np.ndarray, visibility: np.ndarray) -> _Rows:
    """vertex: [n, 3, 3]. mean: [n], of the radiance. Triangles that a transform makes too large or small for
    numbers have no intensity."""
    rows = np.zeros((len(vertex), 24))
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        edge1, edge2 = vertex[:, 1] - vertex[:, 0], vertex[:, 2] - vertex[:, 0]
        normal = np.cross(edge1, edge2)
        length = np.linalg.norm(normal, axis=1)
        intensity = mean * (length / 2.0)
        rows[:, 0:3], rows[:, 3:6], rows[:, 6:9] = vertex[:, 0], edge1, edge2
        rows[:, 9:12] = normal / length[:, None]
        rows[:, 12:15] = radiance
        rows[:, 17] = length / 2.0
    solid = (intensity > 0.0) & (intensity < np.inf)
    rows[~solid] = 0.0
    return _Rows(np.full(len(rows), TRIANGLE, dtype=np.int32), rows, visibility, np.where(solid, intensity, 0.0))
