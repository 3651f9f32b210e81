# SPDX-License-Identifier: Apache-2.0
"""Scenes for measurements, made by numpy: rooms of any number of triangles, and Mitsuba's Cornell box."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..scene import Camera, Instances, Material, Mesh, RenderDefaults, Scene

_BALLS = 24
_ROOM = np.array([5.0, 4.0, 2.5])  # half its size, metres
DIFFUSE = {"specular_ior_level": 0.0, "ior": 1.0}


def room(resolution: int, frame: int | None = None, size: tuple[int, int] = (1920, 1080)) -> Scene:
    """A closed room with bumpy walls and 24 bumpy balls in it, so that every ray hits and rays pass close by much that
    they miss. The camera stands in a corner. One mesh of 60 * resolution**2 triangles: 18 makes 19,440, 128 makes
    983,040.

    frame: the bumps of the balls move from frame to frame, with the same triangles; None: they stand still.
    """
    part = _grid_triangles(resolution, resolution)
    starts = np.arange(6 + _BALLS) * (resolution + 1) ** 2
    mesh = _mesh("room", _room_positions(resolution, frame or 0), np.concatenate([part + start for start in starts]))
    if frame is not None:
        before = _room_positions(resolution, frame - 1).astype(np.float32)
        mesh = dataclasses.replace(mesh, previous_positions=before)
    right = 0.8
    top = right * size[1] / size[0]
    camera = Camera(_look_at(-_ROOM + (0.6, 0.6, 1.2), (0.5, 0.5, -0.3)), (-right, right, -top, top))
    lamp = _quad((0.0, 0.0, _ROOM[2] - 0.35), (0.0, 1.5, 0.0), (1.5, 0.0, 0.0))
    light = _mesh("lamp", lamp, np.array([(0, 1, 2), (0, 2, 3)]))
    materials = (
        Material("walls", base_color=(0.7, 0.7, 0.7), **DIFFUSE),
        Material("lamp", base_color=(0.0, 0.0, 0.0), emission=(8.0, 8.0, 8.0), **DIFFUSE),
    )
    return _scene("room", (mesh, light), materials, camera, size, frame or 1)


def _room_positions(resolution: int, frame: int) -> np.ndarray:
    parts = [_wall(axis, side, resolution) for axis in range(3) for side in (-1.0, 1.0)]
    rng = np.random.default_rng(7)
    for index in range(_BALLS):
        centre = rng.uniform(-1.0, 1.0, 3) * (_ROOM - 0.9)
        radius = rng.uniform(0.3, 0.6)
        # The camera's corner stays free.
        centre[:2] = np.where(centre[:2] < -_ROOM[:2] + 2.0, -centre[:2], centre[:2])
        parts.append(centre + radius * _ball(resolution, index + 0.1 * frame))
    return np.concatenate(parts)


def _wall(axis: int, side: float, resolution: int) -> np.ndarray:
    u, v = _grid(resolution, resolution)
    # No bumps along the edges, where walls meet.
    bump = np.sin(np.pi * u) * np.sin(np.pi * v)
    depth = 0.12 * bump * np.sin(23.0 * u + 5.0 * axis) * np.sin(19.0 * v + 3.0 * side)
    points = np.empty((u.size, 3))
    points[:, axis] = side * _ROOM[axis] - side * np.abs(depth.ravel())
    others = [k for k in range(3) if k != axis]
    for k, coordinate in zip(others, (u, v)):
        points[:, k] = (2.0 * coordinate.ravel() - 1.0) * _ROOM[k]
    return points


def _ball(resolution: int, phase: float) -> np.ndarray:
    u, v = _grid(resolution, resolution)
    longitude, latitude = 2.0 * np.pi * u.ravel(), np.pi * v.ravel()
    bumps = np.sin(9.0 * longitude + phase) * np.sin(11.0 * latitude + phase)
    radius = 1.0 + 0.15 * np.sin(latitude) * bumps
    ring = radius * np.sin(latitude)
    return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), radius * np.cos(latitude)], axis=1)


def _grid(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))


def _grid_triangles(columns: int, rows: int) -> np.ndarray:
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, above = corner + 1, corner + columns + 1
    return np.concatenate([np.stack([corner, right, above], axis=1), np.stack([right, above + 1, above], axis=1)])


def cornell_box(size: tuple[int, int] = (1920, 1080), bounces: int = 4) -> Scene:
    """The box that Mitsuba 3 calls cornell_box: 36 triangles, all diffuse, lit by a quad. Its max_depth d is d - 2
    bounces."""
    white, green, red = (0.885809, 0.698859, 0.666422), (0.105421, 0.37798, 0.076425), (0.570068, 0.0430135, 0.0443706)
    materials = (
        Material("white", base_color=white, **DIFFUSE),
        Material("green", base_color=green, **DIFFUSE),
        Material("red", base_color=red, **DIFFUSE),
        Material("light", base_color=white, emission=(18.387, 13.9873, 6.75357), **DIFFUSE),
    )
    x, y, z = np.eye(3)
    quads = [
        (_quad(-y, x, -z), 0),  # floor
        (_quad(y, x, z), 0),  # ceiling
        (_quad(-z, x, y), 0),  # back
        (_quad(x, y, z), 1),
        (_quad(-x, z, y), 2),
        (_quad((0.0, 0.99, 0.01), 0.23 * x, 0.19 * z), 3),
    ]
    for centre, angle, half in (
        ((0.335, -0.7, 0.38), -17.0, (0.3, 0.3, 0.3)),
        ((-0.33, -0.4, -0.28), 18.25, (0.3, 0.61, 0.3)),
    ):
        cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        axes = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]) * np.array(half)[:, None]
        for k in range(3):
            for side in (-1.0, 1.0):
                a, b = axes[(k + 1) % 3], axes[(k + 2) % 3]
                quads.append((_quad(np.add(centre, side * axes[k]), a * side, b), 0))
    triangles = np.concatenate([np.array([(0, 1, 2), (0, 2, 3)]) + 4 * i for i in range(len(quads))])
    positions, slots = np.concatenate([quad for quad, _ in quads]), np.repeat([slot for _, slot in quads], 2)
    mesh = _mesh("box", positions, triangles, slots)
    right = np.tan(np.radians(39.3077) / 2.0)
    top = right * size[1] / size[0]
    to_world = np.concatenate([np.eye(3), [[0.0], [0.0], [4.0]]], axis=1)
    camera = Camera(to_world, (-right, right, -top, top), (0.001, 100.0))
    return _scene("cornell_box", (mesh,), materials, camera, size, 1, bounces)


def _quad(centre, u, v) -> np.ndarray:
    """The four corners of the parallelogram centre +- u +- v."""
    centre, u, v = (np.asarray(a, dtype=np.float64) for a in (centre, u, v))
    return np.stack([centre - u - v, centre + u - v, centre + u + v, centre - u + v])


def _look_at(eye, target) -> np.ndarray:
    backward = np.subtract(eye, target) / np.linalg.norm(np.subtract(eye, target))
    right = np.cross((0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward, np.asarray(eye, dtype=np.float64)], axis=1)


def _mesh(name: str, positions: np.ndarray, triangles: np.ndarray, slots=None) -> Mesh:
    return Mesh(
        name,
        positions.astype(np.float32),
        np.ascontiguousarray(triangles, dtype=np.int32),
        np.zeros((len(triangles), 3, 3), dtype=np.float32),
        np.asarray(np.zeros(len(triangles)) if slots is None else slots, dtype=np.int32),
    )


def _scene(
    name: str,
    meshes: tuple[Mesh, ...],
    materials: tuple[Material, ...],
    camera: Camera,
    size: tuple[int, int],
    frame: int,
    bounces: int = 4,
) -> Scene:
    """Each mesh once, where it is. One mesh has all materials, of several each has its own."""
    count = len(meshes)
    identity = np.tile(np.eye(4)[:3], (count, 1, 1))
    table = np.arange(len(materials), dtype=np.int32)
    instances = Instances(
        np.arange(count, dtype=np.int32),
        identity,
        identity,
        np.arange(1, count + 1, dtype=np.int32),
        np.arange(count, dtype=np.int32),
        table,
    )
    defaults = RenderDefaults(*size, bounces=bounces)
    return Scene(meshes, instances, materials, camera, camera, frame=frame, name=name, defaults=defaults)
