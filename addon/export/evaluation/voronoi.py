# SPDX-License-Identifier: GPL-3.0-or-later
"""Cellular noise [Worley96] as the Voronoi Texture node has it, in one to four dimensions, with fractal octaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from .hashing import hash_cells, hash_floats
from .noise import join_coordinates

_MAX_DETAIL = 15.0


@dataclass(frozen=True)
class _Cells:
    """What the searches share: distances, and where the points of cells lie.

    randomness, smoothness, exponent: numbers [n] or [1].
    """

    dimensions: int
    metric: str
    randomness: np.ndarray
    smoothness: np.ndarray
    exponent: np.ndarray

    def neighbours(self, reach: int) -> list[np.ndarray]:
        """int32 [d] offsets of cells, X fastest."""
        steps = range(-reach, reach + 1)
        return [np.array(offset[::-1], np.int32) for offset in product(steps, repeat=self.dimensions)]

    def point(self, cells: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """[n, d] of the cells at an offset, relative to the cell itself."""
        return offset.astype(np.float32) + self._hash(cells + offset) * self.randomness[:, None]

    def color(self, cells: np.ndarray) -> np.ndarray:
        """[n, 3]"""
        if self.dimensions == 1:
            key = cells[:, 0].astype(np.float32)
            return np.stack([hash_floats(key)] + [hash_floats(key, np.float32([seed])) for seed in (1, 2)], 1)
        if self.dimensions == 2:
            cells = np.concatenate([cells, np.zeros((len(cells), 1), np.int32)], 1)
        return hash_cells(cells)[:, :3]

    def distance(self, difference: np.ndarray) -> np.ndarray:
        """[n] of differences [n, d]."""
        size = np.abs(difference)
        if self.dimensions == 1:
            return size[:, 0]
        if self.metric == "MANHATTAN":
            return size.sum(1)
        if self.metric == "CHEBYCHEV":
            return size.max(1)
        if self.metric == "MINKOWSKI":
            return (size ** self.exponent[:, None]).sum(1) ** (1 / self.exponent)
        return np.sqrt((size * size).sum(1))

    def _hash(self, cells: np.ndarray) -> np.ndarray:
        if self.dimensions == 1:
            return hash_floats(cells[:, 0].astype(np.float32))[:, None]
        return hash_cells(cells)


@dataclass
class _Octave:
    """distance: [n]. color: [n, 3]. position: [n, d]."""

    distance: np.ndarray
    color: np.ndarray
    position: np.ndarray


def voronoi_texture(
    vector: np.ndarray,
    w: np.ndarray,
    scale: np.ndarray,
    detail: np.ndarray,
    roughness: np.ndarray,
    lacunarity: np.ndarray,
    smoothness: np.ndarray,
    exponent: np.ndarray,
    randomness: np.ndarray,
    *,
    dimensions: int,
    feature: str,
    metric: str,
    normalize: bool,
    output: str,
) -> np.ndarray:
    """The Voronoi Texture node. output: Distance, W, Radius [n]; Color, Position [n, 3]."""
    points = join_coordinates(vector, w, dimensions) * scale[:, None]
    points = np.where(np.isfinite(points), points, 0).astype(np.float32)
    detail = np.clip(detail, 0, _MAX_DETAIL)
    roughness = np.clip(roughness, 0, 1)
    cells = _Cells(
        dimensions, metric, np.clip(randomness, 0, 1), np.clip(smoothness / 2, 0, 0.5).astype(np.float32), exponent
    )
    if feature == "N_SPHERE_RADIUS":
        return _sphere_radius(cells, points)
    if feature == "DISTANCE_TO_EDGE":
        return _fractal_edge(cells, points, detail, roughness, lacunarity, normalize)
    octave = _fractal(cells, points, feature, detail, roughness, lacunarity, normalize)
    if output == "Distance":
        return octave.distance
    if output == "Color":
        return octave.color
    position = np.divide(octave.position, scale[:, None], out=np.zeros_like(octave.position), where=scale[:, None] != 0)
    if output == "W":
        return position[:, -1]
    padded = np.zeros((len(position), 3), np.float32)
    if dimensions > 1:
        padded[:, : min(dimensions, 3)] = position[:, :3]
    return padded


def _split(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    floors = np.floor(points)
    return floors.astype(np.int32), floors, points - floors


def _nearest(cells: _Cells, points: np.ndarray, second: bool) -> _Octave:
    """The feature point nearest to each point, or the one after it."""
    cell, floors, local = _split(points)
    best = [np.full(len(points), np.inf, np.float32) for _ in range(2)]
    place = [np.zeros_like(points) for _ in range(2)]
    offsets = [np.zeros_like(cell) for _ in range(2)]
    for offset in cells.neighbours(1):
        position = cells.point(cell, offset)
        distance = cells.distance(position - local)
        nearer = distance < best[0]
        between = ~nearer & (distance < best[1])
        for target, source in ((best, distance), (place, position), (offsets, np.broadcast_to(offset, cell.shape))):
            wide = source.ndim > 1
            first, other = (nearer[:, None], between[:, None]) if wide else (nearer, between)
            target[1] = np.where(first, target[0], np.where(other, source, target[1]))
            target[0] = np.where(first, source, target[0])
    rank = int(second)
    return _Octave(best[rank], cells.color(cell + offsets[rank]), place[rank] + floors)


def _smooth_nearest(cells: _Cells, points: np.ndarray) -> _Octave:
    cell, floors, local = _split(points)
    smoothness = cells.smoothness
    octave = None
    for offset in cells.neighbours(2):
        position = cells.point(cell, offset)
        distance = cells.distance(position - local)
        color = cells.color(cell + offset)
        if octave is None:
            octave = _Octave(distance, color, position)
            continue
        h = np.clip(0.5 + 0.5 * (octave.distance - distance) / smoothness, 0, 1)
        h = h * h * (3 - 2 * h)
        correction = smoothness * h * (1 - h)
        octave.distance = octave.distance + (distance - octave.distance) * h - correction
        h, correction = h[:, None], (correction / (1 + 3 * smoothness))[:, None]
        octave.color = octave.color + (color - octave.color) * h - correction
        octave.position = octave.position + (position - octave.position) * h - correction
    return replace(octave, position=octave.position + floors)


def _edge_distance(cells: _Cells, points: np.ndarray) -> np.ndarray:
    cell, _, local = _split(points)
    vectors = [cells.point(cell, offset) - local for offset in cells.neighbours(1)]
    if cells.dimensions == 1:
        return _edge_distance_1d(cells, cell, local)
    lengths = np.stack([(vector * vector).sum(1) for vector in vectors])
    closest = np.stack(vectors)[lengths.argmin(0), np.arange(len(points))]
    nearest = np.full(len(points), np.inf, np.float32)
    for vector in vectors:
        across = vector - closest
        square = (across * across).sum(1)
        distance = ((closest + vector) / 2 * across).sum(1) / np.sqrt(np.maximum(square, 1e-20))
        nearest = np.where(square > 0.0001, np.minimum(nearest, distance), nearest)
    return nearest


def _edge_distance_1d(cells: _Cells, cell: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Half way between the point of the cell and those beside it."""
    left, middle, right = (cells.point(cell, offset)[:, 0] for offset in cells.neighbours(1))
    local = local[:, 0]
    return np.minimum(np.abs((middle + left) / 2 - local), np.abs((middle + right) / 2 - local))


def _sphere_radius(cells: _Cells, points: np.ndarray) -> np.ndarray:
    """Half the distance from the nearest feature point to its own nearest neighbour."""
    cell, _, local = _split(points)
    euclidean = replace(cells, metric="EUCLIDEAN")
    best = np.full(len(points), np.inf, np.float32)
    closest, closest_offset = np.zeros_like(points), np.zeros_like(cell)
    for offset in cells.neighbours(1):
        position = cells.point(cell, offset)
        distance = euclidean.distance(position - local)
        nearer = distance < best
        best = np.where(nearer, distance, best)
        closest = np.where(nearer[:, None], position, closest)
        closest_offset = np.where(nearer[:, None], offset, closest_offset)
    best = np.full(len(points), np.inf, np.float32)
    for offset in cells.neighbours(1):
        if offset.any():
            position = cells.point(cell + closest_offset, offset) + closest_offset
            best = np.minimum(best, euclidean.distance(position - closest))
    return best / 2


def _fractal(
    cells: _Cells,
    points: np.ndarray,
    feature: str,
    detail: np.ndarray,
    roughness: np.ndarray,
    lacunarity: np.ndarray,
    normalize: bool,
) -> _Octave:
    def octave_at(points: np.ndarray) -> _Octave:
        if feature == "SMOOTH_F1" and cells.smoothness.any():
            return _smooth_nearest(cells, points)
        return _nearest(cells, points, second=feature == "F2")

    corner = 0.5 + 0.5 * cells.randomness
    largest = cells.distance(np.repeat(corner[:, None], cells.dimensions, 1)) * (2 if feature == "F2" else 1)
    if not detail.any() or not roughness.any():
        result = octave_at(points)
        if normalize:
            result.distance = result.distance / largest
        return result
    amplitude, scale = np.ones_like(roughness), np.ones_like(lacunarity)
    count, highest = len(points), np.float32(0)
    result = _Octave(np.float32(0), np.zeros((count, 3), np.float32), np.zeros_like(points))
    for index in range(int(np.ceil(detail.max())) + 1):
        octave = octave_at(points * scale[:, None])
        share = _share(detail, index)
        wide = (share * amplitude)[:, None]
        result.distance = result.distance + share * octave.distance * amplitude
        result.color = result.color + octave.color * wide
        result.position = result.position + (octave.position / scale[:, None] - result.position) * wide
        highest = highest + share * amplitude
        scale, amplitude = scale * lacunarity, amplitude * roughness
    if normalize:
        result.distance, result.color = result.distance / (highest * largest), result.color / highest[:, None]
    return result


def _share(detail: np.ndarray, octave: int) -> np.ndarray:
    """Of an octave: whole numbers of them, and a part of the last."""
    return np.clip(detail - np.float32(octave - 1), 0, 1)


def _fractal_edge(
    cells: _Cells,
    points: np.ndarray,
    detail: np.ndarray,
    roughness: np.ndarray,
    lacunarity: np.ndarray,
    normalize: bool,
) -> np.ndarray:
    largest = 0.5 + 0.5 * cells.randomness
    if not detail.any() or not roughness.any():
        distance = _edge_distance(cells, points)
        return distance / largest if normalize else distance
    amplitude, scale = np.ones_like(roughness), np.ones_like(lacunarity)
    distance, highest = np.float32(8), largest
    for index in range(int(np.ceil(detail.max())) + 1):
        octave = _edge_distance(cells, points * scale[:, None]) / scale
        bound = highest + (largest / scale - highest) * amplitude
        nearer = distance + (np.minimum(distance, octave) - distance) * amplitude
        share = _share(detail, index)
        distance, highest = distance + (nearer - distance) * share, highest + (bound - highest) * share
        scale, amplitude = scale * lacunarity, amplitude * roughness
    return distance / highest if normalize else distance
