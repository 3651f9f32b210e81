# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading shader node trees: what drives a socket, and whether that is a constant."""

from __future__ import annotations

from typing import Any

import bpy

# Since when the node tree always decides, and asking `use_nodes` is deprecated.
_ALWAYS_NODES = {"MATERIAL": (5, 0, 0), "WORLD": (5, 0, 0), "LIGHT": (5, 2, 0)}


def has_nodes(datablock: bpy.types.Material | bpy.types.World | bpy.types.Light) -> bool:
    """Whether the node tree decides how a data-block looks."""
    always = bpy.app.version >= _ALWAYS_NODES[datablock.id_type]
    return datablock.node_tree is not None and (always or datablock.use_nodes)


def source(socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """The output socket that drives an input, seen through reroutes; None where nothing does."""
    while socket.is_linked:
        link = socket.links[0]
        # Links into muted or invalid places carry nothing, and neither does a reroute with nothing behind it.
        if link.is_muted or not link.is_valid:
            return None
        if link.from_node.bl_idname != "NodeReroute":
            return link.from_socket
        socket = link.from_node.inputs[0]
    return None


def constant(socket: bpy.types.NodeSocket) -> Any | None:
    """The value of an input: a float, or a tuple of floats. None where a node other than a constant drives it."""
    driver = source(socket)
    if driver is None:
        return _plain(socket.default_value)
    if driver.node.mute:
        return None
    if driver.node.type == "RGB" and socket.type == "RGBA":
        return _plain(driver.default_value)
    if driver.node.type == "VALUE":
        value = float(driver.default_value)
        return (value,) * 3 if socket.type in {"RGBA", "VECTOR"} else value
    return None


def describe(node: bpy.types.Node) -> str:
    """Such as ``node "Mix.001" (Mix Color)``."""
    return f'node "{node.name}" ({node.bl_label})'


def _plain(value: Any) -> Any:
    """Blender's array as a tuple (RGB of a colour), its number as a float."""
    return tuple(float(part) for part in value)[:3] if hasattr(value, "__len__") else float(value)
