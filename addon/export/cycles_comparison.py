# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles, set up to render what svgf is compared with."""

from __future__ import annotations

from collections.abc import Callable

import bpy


def prepare_cycles(size: tuple[int, int], bounces: int | None) -> Callable[[], object]:
    """Sets up the scene that Blender has open; returns what renders its current frame."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    render.use_border = render.use_motion_blur = render.use_compositing = render.use_sequencer = False
    render.use_persistent_data = True
    cycles.device = "CPU"
    cycles.samples = 1
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    if bounces is not None:
        cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = bounces
    return bpy.ops.render.render
