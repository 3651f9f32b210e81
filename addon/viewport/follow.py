# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion and history between the scenes that a viewport happens to render.

An export knows what moved since the export before. A viewport skips exports while a frame takes its time, and turns its
camera without one, so here the previous state becomes that of the scene that was rendered last.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from svgf.scene import Instances, Mesh, Scene


def follow(scene: Scene, last: Scene | None) -> Scene:
    """The scene as the frame after `last`, which this function made too; None: nothing moves.

    Frames are numbered from 1 on in the order of rendering, as the renderer wants them to keep its history. Meshes that
    did not change are the objects of `last`.
    """
    if last is None:
        return replace(scene.at_rest(), frame=1)
    rows = _rows_in(scene.instances.object_id, last.instances.object_id)
    return replace(
        scene,
        frame=last.frame + 1,
        cut=False,
        previous_camera=last.camera,
        meshes=_follow_meshes(scene, last, rows),
        instances=_follow_instances(scene.instances, last.instances, rows),
    )


def restart_reason(scene: Scene, last: Scene | None) -> str:
    """Why history cannot go on from one exported scene to another, or an empty string where it can.

    An edit of what lights the scene is shown at once. While an animation plays, the light may change as well, but a
    steady picture is worth more there.
    """
    if last is None:
        return ""
    if scene.frame != last.frame:
        follows = 0 < scene.frame - last.frame <= scene.defaults.frames_per_second
        return "" if follows else f"frame {scene.frame} does not follow frame {last.frame}"
    if scene.world != last.world:
        return "the world changed"
    if scene.lights is not last.lights:
        return "the lights changed"
    if scene.materials is not last.materials or scene.textures is not last.textures:
        return "the materials changed"
    if scene.defaults.bounces != last.defaults.bounces:
        return "the number of bounces changed"
    if scene.defaults.light_paths != last.defaults.light_paths:
        return "the light paths changed"
    if scene.defaults.transparent_film != last.defaults.transparent_film:
        return "the film changed"
    return ""


def _rows_in(object_id: np.ndarray, last_object_id: np.ndarray) -> np.ndarray:
    """int [N]: where each object was in the last scene, -1 for what is new."""
    if not len(last_object_id):
        return np.full(len(object_id), -1)
    order = np.argsort(last_object_id)
    places = np.searchsorted(last_object_id, object_id, sorter=order)
    rows = order[np.minimum(places, len(order) - 1)]
    return np.where(last_object_id[rows] == object_id, rows, -1)


def _follow_instances(instances: Instances, last: Instances, rows: np.ndarray) -> Instances:
    previous = instances.object_to_world
    known = rows >= 0
    if not np.array_equal(previous[known], last.object_to_world[rows[known]]):
        previous = previous.copy()
        previous[known] = last.object_to_world[rows[known]]
    return replace(instances, previous_object_to_world=previous)


def _follow_meshes(scene: Scene, last: Scene, rows: np.ndarray) -> tuple[Mesh, ...]:
    # The exporter keeps the arrays of a mesh that did not change, if not the mesh itself.
    unchanged = {id(mesh.positions): mesh for mesh in last.meshes}
    owners = dict(zip(scene.instances.mesh.tolist(), rows.tolist(), strict=True))
    meshes = []
    for index, mesh in enumerate(scene.meshes):
        before = unchanged.get(id(mesh.positions))
        if before is not None and before.tangents is mesh.tangents:
            meshes.append(before if before.previous_positions is None else replace(before, previous_positions=None))
            continue
        row = owners.get(index, -1)
        source = last.meshes[last.instances.mesh[row]] if row >= 0 else None
        previous = source.positions if source is not None and _deformed(mesh, source) else None
        meshes.append(mesh if mesh.previous_positions is previous else replace(mesh, previous_positions=previous))
    return tuple(meshes)


def _deformed(mesh: Mesh, source: Mesh) -> bool:
    """Whether the same vertices are elsewhere now."""
    return (
        mesh.positions.shape == source.positions.shape
        and np.array_equal(mesh.triangles, source.triangles)
        and not np.array_equal(mesh.positions, source.positions)
    )
