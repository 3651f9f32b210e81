# SPDX-License-Identifier: GPL-3.0-or-later
"""The world's colour."""

from __future__ import annotations

import bpy
import numpy as np
from svgf.scene import World

from .findings import Findings
from .nodes import constant, describe, has_nodes, source
from .textures import TextureCache


def export_world(world: bpy.types.World | None, textures: TextureCache, findings: Findings) -> World:
    """No world, or one without a surface, is black."""
    if world is None:
        return World()
    _find_unsupported(world, findings)
    if not has_nodes(world):
        return _world(world.color)
    output = world.node_tree.get_output_node("CYCLES")
    surface = output and source(output.inputs["Surface"])
    if surface is None:
        return World()
    node = surface.node
    if node.type != "BACKGROUND" or node.mute:
        findings.add(world, f"{describe(node)} is not supported yet; the world is black instead.")
        return World()
    color, strength = constant(node.inputs["Color"]), constant(node.inputs["Strength"])
    if strength is None:
        driver = source(node.inputs["Strength"]).node
        strength = node.inputs["Strength"].default_value
        findings.add(world, f"{describe(driver)} is not supported yet; strength {strength:g} is used instead.")
    if color is None:
        color = _driven_color(world, node.inputs["Color"], textures, findings)
    return _world(np.array(color) * strength)


def _world(radiance) -> World:
    return World(tuple(np.maximum(np.array(radiance, np.float64), 0).tolist()))


def _driven_color(
    world: bpy.types.World, socket: bpy.types.NodeSocket, textures: TextureCache, findings: Findings
) -> np.ndarray:
    """What comes nearest to a colour that differs with the direction: an environment image's mean."""
    node = source(socket).node
    if node.type == "TEX_ENVIRONMENT" and node.image is not None and not node.mute:
        mean = textures.mean_radiance(node.image)
        if mean is not None:
            findings.add(
                world,
                f'the environment image "{node.image.name}" is not supported yet; its mean colour is used instead.',
            )
            return mean
        findings.add(world, f'the environment image "{node.image.name}" cannot be read; the world is black instead.')
        return np.zeros(3)
    findings.add(world, f"{describe(node)} is not supported yet; the colour of its socket is used instead.")
    return np.array(socket.default_value)[:3]


def _find_unsupported(world: bpy.types.World, findings: Findings) -> None:
    output = has_nodes(world) and world.node_tree.get_output_node("CYCLES")
    if output and source(output.inputs["Volume"]) is not None:
        findings.add(world, "volumes are not supported yet; the air is clear.")
    visibility = getattr(world, "cycles_visibility", None)
    if visibility is not None and not all(
        getattr(visibility, ray, True) for ray in ("camera", "diffuse", "glossy", "transmission")
    ):
        findings.add(world, "ray visibility of the world is not supported yet; every ray sees it.")
