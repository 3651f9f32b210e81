# SPDX-License-Identifier: Apache-2.0
"""Modelling with numpy: every mesh of the scenes is made here, so the scenes are the same on every Blender version.

A `Shape` is a polygon mesh as plain arrays. Builders return shapes around the origin, +Z up, in metres; `join` puts
parts together and `studio.mesh` hands the result to Blender. Texture coordinates count texture tiles: 1.0 is one
repetition of the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Shape:
    """Polygons of any size over shared vertices.

    positions: float64 [V, 3]. corners: int [C], the vertices of all faces, one face after another, counter-clockwise
    seen from outside. sizes: int [F], corners of each face. uvs: float64 [C, 2]. slots: int [F], material slot.
    smooth: bool [F]. normals: float64 [C, 3], zero where Blender is to compute the normal.
    """

    positions: np.ndarray
    corners: np.ndarray
    sizes: np.ndarray
    uvs: np.ndarray
    slots: np.ndarray
    smooth: np.ndarray
    normals: np.ndarray

    @property
    def triangle_count(self) -> int:
        return int((self.sizes - 2).sum())

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Shape:
        return replace(self, positions=self.positions + (x, y, z))

    def scaled(self, x: float, y: float | None = None, z: float | None = None) -> Shape:
        """Scaled along the axes by positive factors; one factor scales all three."""
        factors = np.array([x, x if y is None else y, x if z is None else z])
        normals = self.normals / factors
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return replace(self, positions=self.positions * factors, normals=normals / np.where(length > 0, length, 1))

    def rotated(self, axis: str, degrees: float) -> Shape:
        rotation = rotation_matrix(axis, degrees)
        return replace(self, positions=self.positions @ rotation.T, normals=self.normals @ rotation.T)

    def with_slot(self, slot: int) -> Shape:
        return replace(self, slots=np.full_like(self.slots, slot))

    def box_mapped(self, tile: float) -> Shape:
        """Texture coordinates from the position, projected along the axis that each face looks at; tile in metres."""
        face = np.repeat(np.arange(len(self.sizes)), self.sizes)
        start = np.cumsum(self.sizes) - self.sizes
        points = self.positions[self.corners]
        following = np.arange(len(self.corners)) + 1
        following[start + self.sizes - 1] = start
        area = np.zeros((len(self.sizes), 3))
        np.add.at(area, face, np.cross(points, points[following]))  # Newell's formula for the polygon normal
        axis = np.abs(area).argmax(axis=1)[face]
        u = np.where(axis == 0, points[:, 1], points[:, 0])
        v = np.where(axis == 2, points[:, 1], points[:, 2])
        return replace(self, uvs=np.stack([u, v], axis=1) / tile)

    def mapped_from_above(self, radius: float) -> Shape:
        """Texture coordinates that lay an image over the square around the disc of this radius."""
        return replace(self, uvs=self.positions[self.corners, :2] / (2 * radius) + 0.5)


def rotation_matrix(axis: str, degrees: float) -> np.ndarray:
    """The 3x3 matrix of a right-handed rotation around "x", "y" or "z"."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix[i, i] = matrix[j, j] = cos
    matrix[i, j], matrix[j, i] = -sin, sin
    return matrix


def join(*shapes: Shape) -> Shape:
    """One shape of many; vertices are not merged."""
    first_vertex = np.cumsum([0] + [len(shape.positions) for shape in shapes])
    return Shape(
        positions=np.concatenate([shape.positions for shape in shapes]),
        corners=np.concatenate([shape.corners + first for shape, first in zip(shapes, first_vertex)]),
        sizes=np.concatenate([shape.sizes for shape in shapes]),
        uvs=np.concatenate([shape.uvs for shape in shapes]),
        slots=np.concatenate([shape.slots for shape in shapes]),
        smooth=np.concatenate([shape.smooth for shape in shapes]),
        normals=np.concatenate([shape.normals for shape in shapes]),
    )


def polygons(positions: np.ndarray, faces: Sequence[Sequence[int]], smooth: bool = False) -> Shape:
    """A shape from a vertex list and a list of faces; texture coordinates are zero."""
    sizes = np.array([len(face) for face in faces])
    corners = np.array([vertex for face in faces for vertex in face])
    return Shape(
        positions=np.asarray(positions, dtype=np.float64),
        corners=corners,
        sizes=sizes,
        uvs=np.zeros((len(corners), 2)),
        slots=np.zeros(len(sizes), dtype=int),
        smooth=np.full(len(sizes), smooth),
        normals=np.zeros((len(corners), 3)),
    )


def surface(
    points: np.ndarray,
    closed: tuple[bool, bool] = (False, False),
    tiles: tuple[float, float] = (1, 1),
    smooth: bool = True,
) -> Shape:
    """Quads over a grid of points [M, N, 3]; rows run along v, columns along u, and the front is where du x dv points.

    closed: whether the last (row, column) connects to the first. tiles: texture repetitions along (u, v).
    Points that coincide (a pole) share one vertex, and their quads become triangles.
    """
    rows, columns = points.shape[:2]
    positions, vertex = np.unique(points.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    vertex = vertex.reshape(rows, columns)
    faces, uvs = [], []
    for i in range(rows if closed[0] else rows - 1):
        for j in range(columns if closed[1] else columns - 1):
            steps = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
            face = [vertex[a % rows, b % columns] for a, b in steps]
            kept = [k for k in range(4) if face[k] != face[k - 1]]
            if len(kept) < 3:
                continue
            faces.append([face[k] for k in kept])
            spans = (rows if closed[0] else rows - 1, columns if closed[1] else columns - 1)
            uvs += [(steps[k][1] / spans[1] * tiles[0], steps[k][0] / spans[0] * tiles[1]) for k in kept]
    return replace(polygons(positions, faces, smooth), uvs=np.array(uvs))


def quad(width: float, depth: float, tile: float | None = None) -> Shape:
    """A horizontal rectangle that faces up; tile: metres per texture repetition, None maps the image onto it once."""
    x, y = width / 2, depth / 2
    shape = polygons(np.array([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]), [(0, 1, 2, 3)])
    if tile is not None:
        return shape.box_mapped(tile)
    return replace(shape, uvs=np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]))


def box(width: float, depth: float, height: float, tile: float = 1.0) -> Shape:
    """A box that stands on z = 0."""
    return rounded_box(width, depth, height, 0.0, 0, tile)


def rounded_box(
    width: float, depth: float, height: float, radius: float, segments: int = 2, tile: float = 1.0
) -> Shape:
    """A box that stands on z = 0, edges rounded with exact normals so that its faces stay flat to the eye."""
    half = np.array([width, depth, height]) / 2
    angles = np.linspace(-45, 0, segments + 1) if segments else np.array([0.0])
    parts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            other = [(axis + 1) % 3, (axis + 2) % 3][:: int(sign)]  # u x v points outwards
            # Each side is a grid: `segments` strips of the rounding on either end and the flat middle between them.
            tangent = np.tan(np.radians(np.concatenate([angles, -angles[::-1]])))
            u, v = np.meshgrid(tangent, tangent)
            core_u, core_v = np.meshgrid(*[np.repeat([-1.0, 1.0], len(angles))] * 2)
            direction = np.empty(u.shape + (3,))
            direction[..., axis], direction[..., other[0]], direction[..., other[1]] = sign, u, v
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            core = np.empty_like(direction)
            core[..., axis], core[..., other[0]], core[..., other[1]] = sign, core_u, core_v
            points = core * (half - radius) + direction * radius
            side = surface(points)
            offset = side.positions[side.corners] - np.clip(side.positions[side.corners], radius - half, half - radius)
            if radius > 0:
                parts.append(replace(side, normals=offset / np.linalg.norm(offset, axis=1, keepdims=True)))
            else:
                parts.append(replace(side, smooth=np.zeros_like(side.smooth)))
    return join(*parts).box_mapped(tile).moved(z=height / 2)


def lathe(profile: Sequence[tuple[float, float]], segments: int = 24, tile: float | None = None) -> Shape:
    """A surface of revolution around Z. profile: (radius, z) from bottom to top along the outside."""
    profile = np.asarray(profile, dtype=np.float64)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    points = np.empty((len(profile), segments, 3))
    points[..., 0] = profile[:, :1] * np.cos(angle)
    points[..., 1] = profile[:, :1] * np.sin(angle)
    points[..., 2] = profile[:, 1:]
    length = np.linalg.norm(np.diff(profile, axis=0), axis=1).sum()
    around = 2 * np.pi * profile[:, 0].max()
    tiles = (1, 1) if tile is None else (max(1, round(around / tile)), length / tile)
    return surface(points, (False, True), tiles)


def sphere(radius: float, segments: int = 24, rings: int = 12) -> Shape:
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius
    profile[[0, -1], 0] = 0.0
    return lathe(profile, segments)


def cylinder(radius: float, height: float, segments: int = 24, bevel: float = 0.0) -> Shape:
    """A cylinder that stands on z = 0, its rims cut by `bevel`."""
    rim = [(radius, 0.0), (radius, height)]
    if bevel:
        rim = [(radius - bevel, 0.0), (radius, bevel), (radius, height - bevel), (radius - bevel, height)]
    return lathe([(0.0, 0.0), *rim, (0.0, height)], segments)


def torus(radius: float, tube_radius: float, segments: int = 32, sides: int = 14) -> Shape:
    around = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    across = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    ring = radius + tube_radius * np.cos(across)
    height = np.broadcast_to(tube_radius * np.sin(across), (sides, segments))
    return surface(np.stack([ring * np.cos(around), ring * np.sin(around), height], axis=-1), (True, True))


def tube(path: np.ndarray, radii: Sequence[float], sides: int = 10) -> Shape:
    """A round tube along a path [N, 3] with the radius of each point; a radius of 0 closes an end."""
    path = np.asarray(path, dtype=np.float64)
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    normal = np.eye(3)[np.abs(tangents[0]).argmin()]
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    rings = []
    for point, tangent, radius in zip(path, tangents, radii):
        normal = normal - tangent * (normal @ tangent)  # parallel transport keeps the tube from twisting
        normal = normal / np.linalg.norm(normal)
        rings.append(point + radius * (np.cos(angle) * normal + np.sin(angle) * np.cross(tangent, normal)))
    return surface(np.array(rings), (False, True))


def prism(outline: np.ndarray, height: float, bevel: float = 0.0) -> Shape:
    """An outline [N, 2], counter-clockwise, extruded from z = 0 to height; bevel shrinks the caps to the centre."""
    outline = np.asarray(outline, dtype=np.float64)
    inner = outline * (1 - bevel / np.linalg.norm(outline, axis=1).max())
    levels = [(inner, 0.0), (outline, bevel), (outline, height - bevel), (inner, height)]
    if not bevel:
        levels = levels[1:3]
    count, rows = len(outline), len(levels)
    positions = np.concatenate([np.column_stack([ring, np.full(count, z)]) for ring, z in levels])
    faces = [list(range(count))[::-1], list(range((rows - 1) * count, rows * count))]
    for row in range(rows - 1):
        for i in range(count):
            j = (i + 1) % count
            faces.append([row * count + i, row * count + j, (row + 1) * count + j, (row + 1) * count + i])
    return polygons(positions, faces)


def arc_moulding(radius: float, profile: Sequence[tuple[float, float]], segments: int = 24, tile: float = 1.0) -> Shape:
    """A moulding along a half circle in the XZ plane that opens downwards.

    profile: (outwards, y) offsets from the circle, in the order that puts the visible side on top.
    """
    angle = np.linspace(np.pi, 0, segments + 1)[:, None]
    profile = np.asarray(profile, dtype=np.float64)
    reach = radius + profile[:, 0]
    depth = np.broadcast_to(profile[:, 1], (segments + 1, len(profile)))
    points = np.stack([reach * np.cos(angle), depth, reach * np.sin(angle)], axis=-1)
    across = np.linalg.norm(np.diff(profile, axis=0), axis=1).sum()
    return surface(points, tiles=(across / tile, np.pi * radius / tile))


def arch_panel(
    width: float, height: float, radius: float, depth: float, segments: int = 24, tile: float = 1.0
) -> Shape:
    """A wall of the given size with a half-round opening at its foot, centred on Y; the springing line is z = 0.

    Two walls and the underside; the top and the ends, which the neighbours hide, are left open.
    """
    corner = np.arctan2(height, width / 2)
    angle = np.unique(np.concatenate([np.linspace(0, np.pi, segments + 1), [corner, np.pi - corner]]))[::-1]
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    to_side = width / 2 / np.maximum(np.abs(direction[:, 0]), 1e-9)
    to_top = height / np.maximum(direction[:, 1], 1e-9)
    reach = np.minimum(to_side, to_top)
    inner, outer = direction * radius, direction * reach[:, None]

    def wall(y: float, first: np.ndarray, second: np.ndarray) -> Shape:
        rows = [np.column_stack([edge[:, 0], np.full(len(edge), y), edge[:, 1]]) for edge in (first, second)]
        return surface(np.array(rows), smooth=False)

    front, back = wall(-depth / 2, inner, outer), wall(depth / 2, outer, inner)
    rows = [np.column_stack([inner[:, 0], np.full(len(inner), y), inner[:, 1]]) for y in (depth / 2, -depth / 2)]
    underside = surface(np.array(rows), tiles=(np.pi * radius / tile, depth / tile))
    return join(front.box_mapped(tile), back.box_mapped(tile), underside)


def groin_vault(width: float, segments: int = 16, tile: float = 1.0) -> Shape:
    """Two crossing half-round barrels over a square bay, seen from below; the springing line is z = 0."""
    radius = width / 2
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments + 1)
    x, z = radius * np.sin(angle), radius * np.cos(angle)
    along = np.linspace(0, 1, 4)[:, None]
    y = np.abs(x) + along * (radius - np.abs(x))  # each web runs from the groin (|x| = y) to the edge of the bay
    points = np.stack([np.broadcast_to(x, y.shape), y, np.broadcast_to(z, y.shape)], axis=-1)
    web = surface(points[::-1], tiles=(np.pi * radius / tile, radius / tile))
    return join(*[web.rotated("z", 90.0 * quarter) for quarter in range(4)])


def foliage(radius: float, leaves: int, leaf_length: float, rng: np.random.Generator) -> Shape:
    """A ball of single leaves around the origin, each a folded rhombus."""
    parts = []
    outline = np.array([(0, 0, 0), (0.5, 0.28, 0.08), (1, 0, -0.1), (0.5, -0.28, 0.08)]) * leaf_length
    for direction in fibonacci_sphere(leaves):
        roll, lift, distance = rng.uniform(0, 360), rng.uniform(-70, 10), radius * rng.uniform(0.72, 1.0)
        leaf = polygons(outline, [(0, 1, 2), (0, 2, 3)][::-1]).rotated("x", rng.uniform(-50, 50)).rotated("y", lift)
        leaf = leaf.rotated("z", roll)
        parts.append(replace(leaf, positions=leaf.positions + direction * distance))
    return join(*parts)


def fibonacci_sphere(count: int) -> np.ndarray:
    """Unit vectors [count, 3] spread evenly over the sphere."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


class Scatter:
    """Random places on the floor that keep clear of one another (dart throwing)."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self._circles = np.empty((0, 3))

    def occupy(self, x: float, y: float, radius: float) -> None:
        """Keep a disc free of later places."""
        self._circles = np.vstack([self._circles, (x, y, radius)])

    def place(self, radius: float, inner: float, outer: float, keep_off: float) -> tuple[float, float]:
        """A free place for a disc in the ring between two radii that does not touch the circle of radius keep_off.

        It lies on a grid of a millimetre: short numbers make the exported scene small.
        """
        for _ in range(10_000):
            distance = np.sqrt(self.rng.uniform(inner**2, outer**2))
            turn = self.rng.uniform(0, 2 * np.pi)
            x, y = (round(value * 1024) / 1024 for value in (distance * np.cos(turn), distance * np.sin(turn)))
            gap = np.hypot(self._circles[:, 0] - x, self._circles[:, 1] - y) - self._circles[:, 2]
            if gap.min(initial=np.inf) >= radius and abs(np.hypot(x, y) - keep_off) >= radius:
                self.occupy(x, y, radius)
                return x, y
        raise ValueError("There is no room left.")
