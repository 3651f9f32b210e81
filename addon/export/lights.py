# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps. Blender's many factors on a lamp's strength are folded into its power, as measured against Cycles."""

from __future__ import annotations

import bpy
import numpy as np
from svgf.scene import Light, LightKind, RayVisibility

from .findings import Findings
from .nodes import constant, describe, has_nodes, source
from .transforms import lengths, rigid
from .unsupported import find_in_lamp
from .visibility import ray_visibility

_KINDS = {"POINT": LightKind.POINT, "SUN": LightKind.SUN, "SPOT": LightKind.SPOT}
_AREA_KINDS = {
    "SQUARE": LightKind.RECTANGLE,
    "RECTANGLE": LightKind.RECTANGLE,
    "DISK": LightKind.ELLIPSE,
    "ELLIPSE": LightKind.ELLIPSE,
}


def export_light(lamp: bpy.types.Object, matrix: np.ndarray, findings: Findings) -> Light | None:
    """lamp: evaluated object. matrix: float64 [4, 4] light to world. None for what only guides Cycles (portals)."""
    light = lamp.data
    if light.type == "AREA" and getattr(getattr(light, "cycles", None), "is_portal", False):
        findings.add(lamp, "a portal only guides Cycles' sampling; it is not needed and left out.")
        return None
    kind = _AREA_KINDS[light.shape] if light.type == "AREA" else _KINDS[light.type]
    size = _size(light, lengths(matrix))
    find_in_lamp(lamp, findings)
    power = np.array(light.color, np.float64) * light.energy * 2.0**light.exposure
    if light.use_temperature:
        power *= light.temperature_color
    if not light.normalize:
        power *= _unnormalized_factor(kind, size)
    power *= _node_emission(light, findings)
    if power.min() < 0:
        findings.add(light, "negative light is not supported; it is black instead.")
    return Light(
        name=lamp.name,
        kind=kind,
        power=tuple(np.maximum(power, 0).tolist()),
        light_to_world=rigid(matrix),
        size=size,
        spot_angle=light.spot_size if light.type == "SPOT" else Light.spot_angle,
        spot_blend=light.spot_blend if light.type == "SPOT" else Light.spot_blend,
        soft_falloff=light.type in {"POINT", "SPOT"} and light.use_soft_falloff,
        spread=light.spread if light.type == "AREA" else Light.spread,
        visibility=ray_visibility(lamp) | RayVisibility.SHADOW,
    )


def _size(light: bpy.types.Light, scale: np.ndarray) -> tuple[float, float]:
    """Only area lamps grow with their object."""
    if light.type == "AREA":
        height = light.size_y if light.shape in {"RECTANGLE", "ELLIPSE"} else light.size
        return light.size * float(scale[0]), height * float(scale[1])
    return (light.angle if light.type == "SUN" else light.shadow_soft_size), 0.0


def _unnormalized_factor(kind: LightKind, size: tuple[float, float]) -> float:
    """With `normalize` off the strength fixes the radiance instead: strength / pi, for a sun the strength itself."""
    if kind in (LightKind.POINT, LightKind.SPOT):
        return 4 * np.pi * size[0] ** 2 if size[0] > 0 else 4.0
    if kind is LightKind.SUN:
        return np.pi * np.sin(size[0] / 2) ** 2 if size[0] > 0 else 1.0
    return size[0] * size[1] * (np.pi / 4 if kind is LightKind.ELLIPSE else 1.0)


def _node_emission(light: bpy.types.Light, findings: Findings) -> np.ndarray:
    """[3] factor of the lamp's node tree: a constant Emission, which multiplies the lamp's own colour and power."""
    if not has_nodes(light):
        return np.ones(3)
    output = light.node_tree.get_output_node("CYCLES")
    surface = output and source(output.inputs["Surface"])
    if surface is None:
        return np.zeros(3)
    node = surface.node
    if node.type == "EMISSION" and not node.mute:
        color, strength = constant(node.inputs["Color"]), constant(node.inputs["Strength"])
        if color is not None and strength is not None:
            return np.array(color) * strength
        culprit = next(s.node for s in map(source, (node.inputs["Color"], node.inputs["Strength"])) if s is not None)
    else:
        culprit = node
    findings.add(light, f"{describe(culprit)} is not supported yet; the lamp's own colour and power are used instead.")
    return np.ones(3)
