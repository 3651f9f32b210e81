# SPDX-License-Identifier: GPL-3.0-or-later
"""What a change in Blender costs until it is in a scene: milliseconds, and how much was exported for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import bpy
import numpy as np
from svgf.scene import Camera

from .changes import Changes, find_changes
from .exporter import Exporter

_GRID_SIDE = 708  # faces; twice its square is a million triangles
_INSTANCES = 1000
_COUNTED = ("walks", "meshes", "instances", "materials", "lights")
_VIEW = Camera(np.eye(3, 4), (-1.0, 1.0, -1.0, 1.0))


@dataclass(frozen=True)
class ExportTime:
    """change: what was done. milliseconds: best of some tries. processor_milliseconds: of all cores together, which a
    busy machine does not stretch. The rest is what ExportCounters counted for it.
    """

    change: str
    milliseconds: float
    processor_milliseconds: float
    walks: int
    meshes: int
    instances: int
    materials: int
    lights: int


def measure(tries: int = 5) -> list[ExportTime]:
    """Builds scenes of its own, which replace what Blender has open."""
    return [*_measure_mesh(tries), *_measure_instances(tries)]


def _measure_mesh(tries: int) -> Iterator[ExportTime]:
    _start()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=_GRID_SIDE, y_subdivisions=_GRID_SIDE)
    bpy.ops.object.shade_smooth()
    grid = bpy.context.object

    def lift(number: int) -> None:
        grid.data.vertices[0].co.z = number
        grid.data.update()

    triangles = sum(len(polygon.vertices) - 2 for polygon in grid.data.polygons)
    exporter, row = _first(f"a mesh of {triangles:,} triangles is new", tries)
    yield row
    yield _best("a vertex of it is moved", exporter, lift, tries)


def _measure_instances(tries: int) -> Iterator[ExportTime]:
    _start()
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    material = bpy.data.materials.new("Paint")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    cube.data.materials.append(material)
    color = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs["Base Color"]
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    instances = [bpy.data.objects.new(f"Cube {index}", cube.data) for index in range(1, _INSTANCES)]
    for index, item in enumerate([lamp, *instances]):
        item.location.x = index
        bpy.context.scene.collection.objects.link(item)

    def move_all(number: int) -> None:
        for item in (cube, *instances):
            item.location.z = number

    def paint(number: int) -> None:
        color.default_value = (number / 10, 0, 0, 1)

    exporter, row = _first(f"{_INSTANCES:,} instances of a cube and a lamp are new", tries)
    yield row
    yield _best("one of them is moved", exporter, lambda number: setattr(cube.location, "y", number), tries)
    yield _best("all of them are moved", exporter, move_all, tries)
    yield _best("their colour is changed", exporter, paint, tries)
    yield _best("the lamp is dimmed", exporter, lambda number: setattr(lamp.data, "energy", number), tries)


def changes_of(edit: Callable[[], object]) -> Changes | None:
    """What find_changes says of an edit, as a viewport would hear of it."""
    found: list[Changes | None] = []

    def listen(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        found.append(find_changes(depsgraph.updates))

    bpy.context.view_layer.update()
    evaluations = bpy.app.handlers.depsgraph_update_post, bpy.app.handlers.frame_change_post
    for handlers in evaluations:
        handlers.append(listen)
    try:
        edit()
        bpy.context.view_layer.update()
    finally:
        for handlers in evaluations:
            handlers.remove(listen)
    return found[0] if found else None


def _start() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)


def _first(change: str, tries: int) -> tuple[Exporter, ExportTime]:
    """The first export of a scene, and the exporter that made the last one."""
    exporters = [Exporter() for _ in range(tries)]
    rows = [_export(change, exporter, None) for exporter in exporters]
    return exporters[-1], min(rows, key=lambda row: row.milliseconds)


def _best(change: str, exporter: Exporter, edit: Callable[[int], object], tries: int) -> ExportTime:
    """edit: is called with numbers from 1 on."""
    rows = []
    for number in range(1, tries + 1):
        changes = changes_of(lambda number=number: edit(number))
        rows.append(_export(change, exporter, changes))
    return min(rows, key=lambda row: row.milliseconds)


def _export(change: str, exporter: Exporter, changes: Changes | None) -> ExportTime:
    before, depsgraph = asdict(exporter.counters), bpy.context.evaluated_depsgraph_get()
    start, processor_start = time.perf_counter(), time.process_time()
    exporter.export_view(depsgraph, _VIEW, changes)
    elapsed, processor = time.perf_counter() - start, time.process_time() - processor_start
    after = asdict(exporter.counters)
    return ExportTime(change, elapsed * 1e3, processor * 1e3, **{name: after[name] - before[name] for name in _COUNTED})
