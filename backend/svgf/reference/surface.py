# SPDX-License-Identifier: Apache-2.0
"""What a ray hit: the scene as the stages read it, and the point, normals and material at hits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..flatten import MATERIAL_COLUMNS
from .bsdf import Bsdf, make_bsdf
from .environment import World
from .intersect import Geometry, Hierarchy, Hits, solid_triangles
from .lights import Lights
from .texture import Texture
from .vec import normalize, transform_normal, transform_point


# Of what a map may give a scalar input that is not a share.
_RANGES = {
    MATERIAL_COLUMNS["ior"]: (1e-5, 1000.0),
    MATERIAL_COLUMNS["coat_ior"]: (1e-5, 1000.0),
    MATERIAL_COLUMNS["specular_ior_level"]: (0.0, np.inf),
    MATERIAL_COLUMNS["normal_strength"]: (0.0, np.inf),
}


class Mesh:
    """Triangles in object space and their hierarchy. Arguments: see svgf.scene.Mesh."""

    def __init__(self, device, positions, triangles, normals, uvs, material_slots, previous_positions=None) -> None:
        triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
        self.corners = np.asarray(positions, dtype=np.float64)[triangles]
        self.normals = np.asarray(normals, dtype=np.float64).reshape(-1, 3, 3)
        self.uvs = np.asarray(() if uvs is None else uvs, dtype=np.float64).reshape(-1, len(triangles), 3, 2)
        self.slots = np.asarray(material_slots, dtype=np.int64)
        self.previous_corners = self.corners
        if previous_positions is not None:
            self.previous_corners = np.asarray(previous_positions, dtype=np.float64)[triangles]
        self.solid = solid_triangles(self.corners)
        solid = self.corners[self.solid]
        self.hierarchy = Hierarchy(solid.min(axis=1), solid.max(axis=1), leaf_size=4)


class Shapes(Geometry):
    """Instances of meshes with all that is read at a hit. Arrays: see FlatScene."""

    def __init__(
        self,
        meshes: list[Mesh],
        instance_mesh,
        object_to_world,
        world_to_object,
        previous_object_to_world,
        object_id,
        material_start,
        material_table,
        visibility,
        emitter,
    ) -> None:
        def transforms(rows) -> np.ndarray:
            return np.asarray(rows, dtype=np.float64).reshape(-1, 3, 4)

        super().__init__(
            meshes,
            np.asarray(instance_mesh, dtype=np.int64),
            transforms(object_to_world),
            transforms(world_to_object),
            np.asarray(visibility, dtype=np.int64),
        )
        self.emitter = np.asarray(emitter, dtype=np.int64)
        self.previous_object_to_world = transforms(previous_object_to_world)
        self.object_id = np.asarray(object_id, dtype=np.int64)
        self.material_start = np.asarray(material_start, dtype=np.int64)
        self.material_table = np.asarray(material_table, dtype=np.int64)
        self.normals = np.concatenate([np.zeros((0, 3, 3)), *(mesh.normals for mesh in meshes)])
        layers = max((len(mesh.uvs) for mesh in meshes), default=0)
        self.uvs = np.concatenate(
            [
                np.zeros((layers, 0, 3, 2)),
                *(np.pad(mesh.uvs, ((0, layers - len(mesh.uvs)), *[(0, 0)] * 3)) for mesh in meshes),
            ],
            axis=1,
        )
        self.slots = np.concatenate([np.zeros(0, dtype=np.int64), *(mesh.slots for mesh in meshes)])
        self.previous_corners = np.concatenate([np.zeros((0, 3, 3)), *(mesh.previous_corners for mesh in meshes)])


@dataclass
class SceneView:
    """materials: [M, 48], material_maps: [K, 12], see FlatScene."""

    shapes: Shapes
    materials: np.ndarray
    material_maps: np.ndarray
    textures: list[Texture]
    lights: Lights
    world: World


@dataclass
class Surface:
    """Rows of hits. position, geometric_normal, shading_normal (unit, outside of the mesh), previous_position: [n, 3],
    world. magnitude: [n], of the terms that the position was summed from. material: [n]. base: [n, 3], texture
    included. light: [n], of the lights, -1 for none."""

    position: np.ndarray
    previous_position: np.ndarray
    geometric_normal: np.ndarray
    shading_normal: np.ndarray
    magnitude: np.ndarray
    object_id: np.ndarray
    material: np.ndarray
    rows: np.ndarray
    base: np.ndarray
    light: np.ndarray

    @property
    def emission(self) -> np.ndarray:
        return self.rows[:, 12:15]

    def bsdf(self, view: np.ndarray) -> Bsdf:
        """view: [n, 3] unit, towards the viewer."""
        return make_bsdf(view, self.shading_normal, self.geometric_normal, self.rows, self.base)


def surface_at(scene: SceneView, hits: Hits, found: np.ndarray) -> Surface:
    """found: rows of hits that did hit."""
    shapes = scene.shapes
    instance, triangle, weights = hits.instance[found], hits.triangle[found], hits.weights[found]
    corners = shapes.corners[triangle]

    def interpolate(values: np.ndarray) -> np.ndarray:
        return np.einsum("nc,nci->ni", weights, values)

    to_world, inverse = shapes.object_to_world[instance], shapes.world_to_object[instance]
    position = transform_point(to_world, interpolate(corners))
    magnitude = (transform_point(np.abs(to_world), interpolate(np.abs(corners)))).max(axis=1)
    previous_position = transform_point(
        shapes.previous_object_to_world[instance], interpolate(shapes.previous_corners[triangle])
    )
    face_normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    geometric_normal = normalize(transform_normal(inverse, normalize(face_normal)))
    shading_normal = _shading_normal(interpolate(shapes.normals[triangle]), inverse, geometric_normal)

    material = shapes.material_table[shapes.material_start[instance] + shapes.slots[triangle]]
    rows = _apply_maps(scene, hits, found, material)
    return Surface(
        position=position,
        previous_position=np.where(np.isfinite(previous_position).all(axis=1)[:, None], previous_position, position),
        geometric_normal=geometric_normal,
        shading_normal=shading_normal,
        magnitude=magnitude,
        object_id=shapes.object_id[instance],
        material=material,
        rows=rows,
        base=rows[:, 0:3],
        light=scene.lights.find(
            shapes.emitter[instance], triangle - shapes.first_triangle[shapes.instance_mesh[instance]]
        ),
    )


def _shading_normal(normal, inverse, geometric_normal) -> np.ndarray:
    """normal: interpolated. The face's stands in where there is none, or where the corners' cancel."""
    there = np.abs(normal).max(axis=1, initial=0.0) > 1e-6
    with np.errstate(invalid="ignore"):
        shading_normal = normalize(transform_normal(inverse, normal))
    return np.where(there[:, None], shading_normal, geometric_normal)


def _apply_maps(scene: SceneView, hits: Hits, found: np.ndarray, material: np.ndarray) -> np.ndarray:
    """Rows [n, 48] of materials, with the values of their maps. Shares stay shares, whatever an image holds: a surface
    reflects no more than it gets."""
    shapes = scene.shapes
    rows = scene.materials[material].copy()
    for index in np.unique(material):
        chosen = np.flatnonzero(material == index)
        start, count = rows[chosen[0], 40:42].astype(int)
        for column, texture, channel, layer, *transform in scene.material_maps[start : start + count, :10]:
            uv = np.zeros((len(chosen), 2))
            if layer < len(shapes.uvs):
                corners = shapes.uvs[int(layer), hits.triangle[found[chosen]]]
                uv = np.einsum("nc,nci->ni", hits.weights[found[chosen]], corners)
            uv = uv @ np.reshape(transform, (2, 3))[:, :2].T + np.reshape(transform, (2, 3))[:, 2]
            texel = scene.textures[int(texture)].lookup(uv)
            column = int(column)
            if column == MATERIAL_COLUMNS["emission"]:
                rows[chosen, column : column + 3] *= texel[:, :3]
            elif column == MATERIAL_COLUMNS["normal"]:
                rows[chosen, column : column + 3] = texel[:, :3]
            elif channel < 0:
                rows[chosen, column : column + 3] = np.clip(texel[:, :3], 0.0, 1.0)
            else:
                low, high = _RANGES.get(column, (0.0, 1.0))
                rows[chosen, column] = np.clip(texel[:, int(channel)], low, high)
    return rows
