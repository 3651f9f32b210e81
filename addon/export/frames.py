# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of an animation as a render engine sees them, each with its true previous frame."""

from __future__ import annotations

import bpy
from svgf.scene import Scene

from .exporter import Exporter, never


def export_frame(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    exporter: Exporter,
    size: tuple[int, int] | None = None,
) -> Scene:
    """The frame that the engine was asked to render.

    Where the exporter has not just seen the frame before, Blender evaluates that one first: a part of an animation, or
    a single frame, moves exactly as in the whole. Raises InputError without a camera or a mesh, Interrupted after Esc.
    """
    exporter.should_stop = engine.test_break
    try:
        return _export(engine, depsgraph, exporter, size)
    finally:
        exporter.should_stop = never


def _export(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    exporter: Exporter,
    size: tuple[int, int] | None,
) -> Scene:
    frame, subframe = depsgraph.scene.frame_current, depsgraph.scene.frame_subframe
    if exporter.frame != frame - 1:
        engine.frame_set(frame - 1, subframe)
        try:
            exporter.observe(depsgraph, size, engine.camera_override)
        finally:
            engine.frame_set(frame, subframe)
    return exporter.export(depsgraph, size, engine.camera_override)
