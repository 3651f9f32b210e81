# SPDX-License-Identifier: Apache-2.0
"""What a ray hit: the scene as the stages read it, and the point, normals and material at hits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .bsdf import Bsdf, make_bsdf
from .intersect import Geometry, Hierarchy, Hits, solid_triangles
from .lights import Lights
from .texture import Texture
from .vec import normalize, transform_normal, transform_point


class Mesh:
    """Triangles in object space and their hierarchy. Arguments: see svgf.scene.Mesh."""

    def __init__(self, device, positions, triangles, normals, uvs, material_slots, previous_positions=None) -> None:
        triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
        self.corners = np.asarray(positions, dtype=np.float64)[triangles]
        self.normals = np.asarray(normals, dtype=np.float64).reshape(-1, 3, 3)
        self.uvs = np.zeros((len(triangles), 3, 2)) if uvs is None else np.asarray(uvs, dtype=np.float64)
        self.slots = np.asarray(material_slots, dtype=np.int64)
        self.previous_corners = self.corners
        if previous_positions is not None:
            self.previous_corners = np.asarray(previous_positions, dtype=np.float64)[triangles]
        self.solid = solid_triangles(self.corners)
        solid = self.corners[self.solid]
        self.hierarchy = Hierarchy(solid.min(axis=1), solid.max(axis=1), leaf_size=4)

    def refit(self, device, positions, normals, previous_positions) -> bool:
        """The reference makes meshes anew."""
        return False


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
    ) -> None:
        def transforms(rows) -> np.ndarray:
            return np.asarray(rows, dtype=np.float64).reshape(-1, 3, 4)

        super().__init__(
            meshes, np.asarray(instance_mesh, dtype=np.int64), transforms(object_to_world), transforms(world_to_object)
        )
        self.previous_object_to_world = transforms(previous_object_to_world)
        self.object_id = np.asarray(object_id, dtype=np.int64)
        self.material_start = np.asarray(material_start, dtype=np.int64)
        self.material_table = np.asarray(material_table, dtype=np.int64)
        self.normals = np.concatenate([np.zeros((0, 3, 3)), *(mesh.normals for mesh in meshes)])
        self.uvs = np.concatenate([np.zeros((0, 3, 2)), *(mesh.uvs for mesh in meshes)])
        self.slots = np.concatenate([np.zeros(0, dtype=np.int64), *(mesh.slots for mesh in meshes)])
        self.previous_corners = np.concatenate([np.zeros((0, 3, 3)), *(mesh.previous_corners for mesh in meshes)])


@dataclass
class SceneView:
    """materials: [M, 16], see FlatScene."""

    shapes: Shapes
    materials: np.ndarray
    textures: list[Texture]
    lights: Lights


@dataclass
class Surface:
    """Rows of hits. position, geometric_normal, shading_normal (unit, outside of the mesh), previous_position: [n, 3],
    world. magnitude: [n], of the terms that the position was summed from. material: [n]. base: [n, 3], texture
    included."""

    position: np.ndarray
    previous_position: np.ndarray
    geometric_normal: np.ndarray
    shading_normal: np.ndarray
    magnitude: np.ndarray
    object_id: np.ndarray
    material: np.ndarray
    rows: np.ndarray
    base: np.ndarray

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
    rows = scene.materials[material]
    return Surface(
        position=position,
        previous_position=np.where(np.isfinite(previous_position).all(axis=1)[:, None], previous_position, position),
        geometric_normal=geometric_normal,
        shading_normal=shading_normal,
        magnitude=magnitude,
        object_id=shapes.object_id[instance],
        material=material,
        rows=rows,
        base=_base_color(scene, rows, interpolate(shapes.uvs[triangle])),
    )


def _shading_normal(normal, inverse, geometric_normal) -> np.ndarray:
    """normal: interpolated. The face's stands in where there is none, or where the corners' cancel."""
    there = np.abs(normal).max(axis=1, initial=0.0) > 1e-6
    with np.errstate(invalid="ignore"):
        shading_normal = normalize(transform_normal(inverse, normal))
    return np.where(there[:, None], shading_normal, geometric_normal)


def _base_color(scene: SceneView, rows: np.ndarray, uv: np.ndarray) -> np.ndarray:
    base = rows[:, 0:3].copy()
    texture = rows[:, 3].astype(np.int64)
    for index in np.unique(texture[texture >= 0]):
        chosen = texture == index
        # A surface reflects no more than it gets, whatever an image holds.
        base[chosen] = np.clip(scene.textures[index].lookup(uv[chosen]), 0.0, 1.0)
    return base
