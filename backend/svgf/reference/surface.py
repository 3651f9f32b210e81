# SPDX-License-Identifier: Apache-2.0
"""What a ray hit: the scene as the stages read it, and the point, normals and material at hits."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..flatten import MATERIAL_COLUMNS
from ..scene import MaterialKind
from .bsdf import Bsdf
from .bsdf_lobes import make_bsdf
from .environment import World
from .intersect import Geometry, Hierarchy, Hits, solid_triangles
from .layers import column, has_smooth_coat_normal, make_layers
from .lights import Lights
from .microfacet import fresnel_dielectric
from .shadow_terminator import find_patch_offsets
from .texture import Texture
from .vec import dot, normalize, transform_normal, transform_point, transform_vector

MIXES = (MaterialKind.MIX, MaterialKind.ADD)
LARGEST_CHOICE = 1.0 - 2.0**-24


# Of what a map may give a scalar input that is not a share.
_RANGES = {
    MATERIAL_COLUMNS["ior"]: (1e-5, 1000.0),
    MATERIAL_COLUMNS["coat_ior"]: (1e-5, 1000.0),
    MATERIAL_COLUMNS["specular_ior_level"]: (0.0, np.inf),
    MATERIAL_COLUMNS["normal_strength"]: (0.0, np.inf),
}


class Mesh:
    """Triangles in object space and their hierarchy. Arguments: see svgf.scene.Mesh."""

    def __init__(
        self,
        device,
        positions,
        triangles,
        normals,
        uvs,
        material_slots,
        previous_positions=None,
        tangents=None,
        tangent_layer=0,
    ) -> None:
        triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
        self.corners = np.asarray(positions, dtype=np.float64)[triangles]
        self.normals = np.asarray(normals, dtype=np.float64).reshape(-1, 3, 3)
        self.uvs = np.asarray(() if uvs is None else uvs, dtype=np.float64).reshape(-1, len(triangles), 3, 2)
        self.tangents = np.zeros((len(triangles), 3, 4)) if tangents is None else np.asarray(tangents, np.float64)
        self.tangent_layer = np.full(len(triangles), -1 if tangents is None else tangent_layer)
        self.slots = np.asarray(material_slots, dtype=np.int64)
        self.previous_corners = self.corners
        if previous_positions is not None:
            self.previous_corners = np.asarray(previous_positions, dtype=np.float64)[triangles]
        self.solid = solid_triangles(self.corners)
        solid = self.corners[self.solid]
        vertices = solid.reshape(-1, 3)
        self.box = (vertices.min(axis=0), vertices.max(axis=0)) if len(vertices) else np.zeros((2, 3))
        self.hierarchy = Hierarchy(solid.min(axis=1), solid.max(axis=1), leaf_size=4)

    def refit(self, device, positions, normals, previous_positions, tangents=None) -> bool:
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
        visibility,
        emitter,
        terminator_offset,
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
        self.terminator_offset = np.asarray(terminator_offset, dtype=np.float64)
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
        self.tangents = np.concatenate([np.zeros((0, 3, 4)), *(mesh.tangents for mesh in meshes)])
        self.tangent_layer = np.concatenate([np.zeros(0, int), *(mesh.tangent_layer for mesh in meshes)])
        self.boxes = np.array([mesh.box for mesh in meshes]).reshape(-1, 2, 3)
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
    world. smooth_normal: without the normal map. tangent: [n, 3], of anisotropy. magnitude: [n], of the terms that the
    position was summed from. material: [n], in the mesh's slot. rows: [n, 48], of the material itself, which may be a
    part of that one, with the values of its maps. weight: [n], of all that it does. straight: [n, 3], what a ray that
    goes straight on is multiplied by where the hit lets it pass, else 0. emission: [n, 3], towards the viewer.
    light: [n], of the lights, -1 for none. terminator_offset: [n], of triangles with smooth normals; patch_offset:
    [n, 2, 3], outside and inside, see shadow_terminator.py."""

    position: np.ndarray
    previous_position: np.ndarray
    geometric_normal: np.ndarray
    shading_normal: np.ndarray
    smooth_normal: np.ndarray
    tangent: np.ndarray
    magnitude: np.ndarray
    object_id: np.ndarray
    material: np.ndarray
    rows: np.ndarray
    weight: np.ndarray
    straight: np.ndarray
    emission: np.ndarray
    light: np.ndarray
    terminator_offset: np.ndarray
    patch_offset: np.ndarray

    def chosen(self, rows: np.ndarray) -> Surface:
        return Surface(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def bsdf(self, view: np.ndarray) -> Bsdf:
        """view: [n, 3] unit, towards the viewer."""
        return make_bsdf(
            view, self.shading_normal, self.geometric_normal, self.rows, self.smooth_normal, self.tangent, self.weight
        )


def surface_at(scene: SceneView, hits: Hits, found: np.ndarray, view: np.ndarray, choice: np.ndarray) -> Surface:
    """found: rows of hits that did hit. view: [n, 3] unit, of these, towards where their rays came from. choice: [n],
    uniform in [0, 1), of the part of a mix and of passing straight."""
    shapes = scene.shapes
    instance, triangle, weights = hits.instance[found], hits.triangle[found], hits.weights[found]
    corners = shapes.corners[triangle]

    def interpolate(values: np.ndarray) -> np.ndarray:
        return np.einsum("nc,nci->ni", weights, values)

    to_world, inverse = shapes.object_to_world[instance], shapes.world_to_object[instance]
    object_position = interpolate(corners)
    position = transform_point(to_world, object_position)
    magnitude = (transform_point(np.abs(to_world), interpolate(np.abs(corners)))).max(axis=1)
    previous_position = transform_point(
        shapes.previous_object_to_world[instance], interpolate(shapes.previous_corners[triangle])
    )
    face_normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    geometric_normal = normalize(transform_normal(inverse, normalize(face_normal)))
    normal = interpolate(shapes.normals[triangle])
    shading_normal = _shading_normal(normal, inverse, geometric_normal)

    material = shapes.material_table[shapes.material_start[instance] + shapes.slots[triangle]]
    rows, weight, choice = _find_materials(
        scene, hits, found, material, choice, shading_normal, dot(geometric_normal, view) > 0.0, view
    )
    smooth_normal = shading_normal
    has_normal = np.abs(normal).max(axis=1, initial=0.0) > 1e-6
    object_normal = np.where(has_normal[:, None], normal, face_normal)
    layer = rows[:, MATERIAL_COLUMNS["normal_uv_layer"]].astype(int)
    axes = _normal_map_axes(shapes, triangle, weights, corners, layer, object_normal)
    shading_normal = _mapped_normal(rows, axes, inverse, shading_normal)
    tangent = _anisotropy_tangent(
        shapes, instance, triangle, weights, corners, object_position, rows, to_world, inverse
    )

    opacity, tint = find_opacity(rows)
    coat_normal = np.where(has_smooth_coat_normal(rows)[:, None], smooth_normal, shading_normal)
    below = make_layers(rows, np.abs(dot(shading_normal, view)), np.abs(dot(coat_normal, view))).below
    emission = column(rows, "emission") * below * (opacity * weight)[:, None]
    light_emission = column(scene.materials[material], "light_emission")
    # Of a mix of lamps that paths aim at: all of it, always.
    kind = scene.materials[material][:, MATERIAL_COLUMNS["kind"]]
    whole = np.isin(kind, MIXES) & (light_emission.max(axis=1, initial=0.0) > 0.0)
    return Surface(
        position=position,
        previous_position=np.where(np.isfinite(previous_position).all(axis=1)[:, None], previous_position, position),
        geometric_normal=geometric_normal,
        shading_normal=shading_normal,
        smooth_normal=smooth_normal,
        tangent=tangent,
        magnitude=magnitude,
        object_id=shapes.object_id[instance],
        material=material,
        rows=rows,
        weight=weight,
        straight=np.where((choice >= opacity)[:, None], tint * weight[:, None], 0.0),
        emission=np.where(whole[:, None], light_emission, emission),
        light=scene.lights.find(
            shapes.emitter[instance], triangle - shapes.first_triangle[shapes.instance_mesh[instance]]
        ),
        terminator_offset=np.where(has_normal, shapes.terminator_offset[instance], 0.0),
        patch_offset=find_patch_offsets(corners, shapes.normals[triangle], weights, to_world, geometric_normal),
    )


def find_opacity(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share [n] of materials that does not let light straight through, and the tint [n, 3] of what it lets."""
    kind = rows[:, MATERIAL_COLUMNS["kind"]]
    is_transparent = kind == MaterialKind.TRANSPARENT
    opacity = np.where(kind == MaterialKind.PRINCIPLED, column(rows, "alpha"), 1.0)
    return np.where(is_transparent, 0.0, opacity), np.where(is_transparent[:, None], column(rows, "base_color"), 1.0)


def material_rows_at(scene: SceneView, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
    """Indices [n] of the materials of hits, all of which did hit, and their rows [n, 48] with the values of their
    maps; mixes as a whole."""
    shapes = scene.shapes
    material = shapes.material_table[shapes.material_start[hits.instance] + shapes.slots[hits.triangle]]
    return material, _apply_maps(scene, hits, np.arange(len(material)), material)


def transmittance_at(
    scene: SceneView, hits: Hits, found: np.ndarray, view: np.ndarray, choice: np.ndarray
) -> np.ndarray:
    """What is left, [n, 3], of light that goes straight through a hit, on the mean over choice. Arguments: see
    surface_at."""
    surface = surface_at(scene, hits, found, view, choice)
    opacity, tint = find_opacity(surface.rows)
    return tint * ((1.0 - opacity) * surface.weight)[:, None]


def _find_materials(
    scene: SceneView,
    hits: Hits,
    found: np.ndarray,
    material: np.ndarray,
    choice: np.ndarray,
    normal: np.ndarray,
    entering: np.ndarray,
    view: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of materials that are no mixes, with the values of their maps; their weights; and what is left of choice.

    Of a mix, one part is chosen with its share as probability; of a sum, each with one half and twice its weight."""
    material, choice, weight = material.copy(), np.array(choice, dtype=np.float64), np.ones(len(material))
    rows = _apply_maps(scene, hits, found, material)
    while True:
        kind = rows[:, MATERIAL_COLUMNS["kind"]]
        mixes = np.flatnonzero(np.isin(kind, MIXES))
        if not len(mixes):
            return rows, weight, choice
        is_sum = kind[mixes] == MaterialKind.ADD
        factor = _find_factor(rows[mixes], np.abs(dot(normal[mixes], view[mixes])), entering[mixes])
        share = np.where(is_sum, 0.5, factor)
        second = choice[mixes] < share
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = np.where(second, choice[mixes] / share, (choice[mixes] - share) / (1.0 - share))
        choice[mixes] = np.minimum(rest, LARGEST_CHOICE)
        parts = np.where(second, column(rows[mixes], "second"), column(rows[mixes], "first"))
        material[mixes] = parts.astype(np.int64)
        weight[mixes] *= np.where(is_sum, 2.0, 1.0)
        rows[mixes] = _apply_maps(scene, hits, found[mixes], material[mixes])


def _find_factor(rows: np.ndarray, cosine: np.ndarray, entering: np.ndarray) -> np.ndarray:
    """Share of the second part of mixes. cosine: [n], |N.V|."""
    ior, blend = column(rows, "factor_fresnel_ior"), column(rows, "factor_facing_blend")
    safe = np.maximum(ior, 1e-5)
    fresnel = fresnel_dielectric(cosine, np.where(entering, safe, 1.0 / safe))
    bounded = np.clip(blend, 0.0, 1.0 - 1e-5)
    facing = 1.0 - cosine ** np.where(bounded < 0.5, 2.0 * bounded, 0.5 / (1.0 - bounded))
    return np.where(ior > 0.0, fresnel, np.where(blend >= 0.0, facing, column(rows, "factor")))


def _uv_axes(
    shapes: Shapes, triangle: np.ndarray, corners: np.ndarray, layer: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Direction [n, 3] of the U axis of UV layers in object space, 0 where they do not say, and whether V lies to its
    right as seen from the front."""
    if not len(shapes.uvs):
        return np.zeros((len(triangle), 3)), np.zeros(len(triangle), dtype=bool)
    uvs = shapes.uvs[np.clip(layer, 0, len(shapes.uvs) - 1), triangle]
    (u1, v1), (u2, v2) = (uvs[:, 1] - uvs[:, 0]).T, (uvs[:, 2] - uvs[:, 0]).T
    area = u1 * v2 - u2 * v1
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    along = np.sign(area)[:, None] * (edge1 * v2[:, None] - edge2 * v1[:, None])
    there = (layer >= 0) & (layer < len(shapes.uvs))
    return np.where(there[:, None], along, 0.0), area < 0.0


def _mesh_tangent(shapes: Shapes, triangle: np.ndarray, weights: np.ndarray, layer: np.ndarray) -> np.ndarray:
    """The meshes' own tangents [n, 4] of UV layers, with the side of V; 0 where they have none."""
    tangent = np.einsum("nc,nci->ni", weights, shapes.tangents[triangle])
    return np.where((shapes.tangent_layer[triangle] == layer)[:, None], tangent, 0.0)


def _normal_map_axes(
    shapes: Shapes,
    triangle: np.ndarray,
    weights: np.ndarray,
    corners: np.ndarray,
    layer: np.ndarray,
    normal: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tangent, bitangent and normal that a normal map is relative to. With tangents of the mesh's own, all three stay
    as they are interpolated [Mikkelsen08]; that of a triangle is made perpendicular to the normal."""
    own = _mesh_tangent(shapes, triangle, weights, layer)
    along, mirrored = _uv_axes(shapes, triangle, corners, layer)
    n = normalize(normal)
    along = normalize(along - n * dot(n, along)[:, None])
    there = own[:, :3].any(axis=1)[:, None]
    tangent, n = np.where(there, own[:, :3], along), np.where(there, normal, n)
    side = np.where(there[:, 0], own[:, 3], np.where(mirrored, -1.0, 1.0))
    return tangent, np.cross(n, tangent) * side[:, None], n


def _mapped_normal(rows, axes, inverse, shading_normal) -> np.ndarray:
    """Shading normals turned by the normal map."""
    tangent, bitangent, n = axes
    strength = column(rows, "normal_strength")[:, None]
    x, y, z = ((2.0 * column(rows, "normal") - 1.0)[:, i : i + 1] for i in range(3))
    local_z = 1.0 + (z - 1.0) * np.clip(strength, 0.0, 1.0)
    mapped = transform_normal(inverse, tangent * x * strength + bitangent * y * strength + n * local_z)
    there = (rows[:, MATERIAL_COLUMNS["normal_uv_layer"]] >= 0) & tangent.any(axis=1) & mapped.any(axis=1)
    return np.where(there[:, None], normalize(mapped), shading_normal)


def _anisotropy_tangent(
    shapes, instance, triangle, weights, corners, object_position, rows, to_world, inverse
) -> np.ndarray:
    """That of a UV layer, or without one Blender's default, circles around the object's Z axis through the middle of
    its box."""
    layer = column(rows, "tangent_uv_layer").astype(int)
    own, (along, _) = _mesh_tangent(shapes, triangle, weights, layer)[:, :3], _uv_axes(shapes, triangle, corners, layer)
    along = np.where(own.any(axis=1)[:, None], own, along)
    low, high = shapes.boxes[shapes.instance_mesh[instance]].transpose(1, 0, 2)
    width = high - low
    scaled = (object_position - (low + high) / 2.0) / np.where(width > 0.0, width, np.inf)
    around = np.stack([-scaled[:, 1], scaled[:, 0], np.zeros(len(scaled))], axis=1)
    return np.where(
        along.any(axis=1)[:, None], transform_vector(to_world, along), transform_normal(inverse, around)
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
        for place, texture, channel, layer, *transform in scene.material_maps[start : start + count, :10]:
            uv = np.zeros((len(chosen), 2))
            if layer < len(shapes.uvs):
                corners = shapes.uvs[int(layer), hits.triangle[found[chosen]]]
                uv = np.einsum("nc,nci->ni", hits.weights[found[chosen]], corners)
            uv = uv @ np.reshape(transform, (2, 3))[:, :2].T + np.reshape(transform, (2, 3))[:, 2]
            texel = scene.textures[int(texture)].lookup(uv)
            place = int(place)
            if place == MATERIAL_COLUMNS["emission"]:
                rows[chosen, place : place + 3] *= texel[:, :3]
            elif place == MATERIAL_COLUMNS["normal"]:
                rows[chosen, place : place + 3] = texel[:, :3]
            elif channel < 0:
                rows[chosen, place : place + 3] = np.clip(texel[:, :3], 0.0, 1.0)
            else:
                low, high = _RANGES.get(place, (0.0, 1.0))
                rows[chosen, place] = np.clip(texel[:, int(channel)], low, high)
    return rows
