# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading shader node trees: what drives a socket, through groups, reroutes and muted nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy

# Since when the node tree always decides, and asking `use_nodes` is deprecated.
_ALWAYS_NODES = {"MATERIAL": (5, 0, 0), "WORLD": (5, 0, 0), "LIGHT": (5, 2, 0)}
# Steps from a socket to what drives it. Only trees that Blender calls invalid need more.
_MAX_STEPS = 1000


@dataclass(frozen=True)
class Place:
    """A socket and the group nodes, outermost first, that were entered on the way to its tree.

    The node of an output that ``trace`` gives computes something; an input holds its own value.
    """

    socket: bpy.types.NodeSocket
    groups: tuple[bpy.types.Node, ...] = ()

    @property
    def node(self) -> bpy.types.Node:
        return self.socket.node

    @property
    def is_output(self) -> bool:
        return self.socket.is_output

    @property
    def key(self) -> tuple:
        """Equal for the same socket in the same instance of its group."""
        return self.socket.as_pointer(), *(group.as_pointer() for group in self.groups)

    def input(self, name: str | int) -> Place | None:
        """An input of this node by identifier, name or number; None where this version of Blender has none."""
        return find_input(self.node, name, self.groups)


def has_nodes(datablock: bpy.types.Material | bpy.types.World | bpy.types.Light) -> bool:
    """Whether the node tree decides how a data-block looks."""
    always = bpy.app.version >= _ALWAYS_NODES[datablock.id_type]
    return datablock.node_tree is not None and (always or datablock.use_nodes)


def find_input(node: bpy.types.Node, name: str | int, groups: tuple[bpy.types.Node, ...] = ()) -> Place | None:
    if isinstance(name, int):
        return Place(node.inputs[name], groups)
    socket = next((s for s in node.inputs if s.identifier == name), None) or node.inputs.get(name)
    return None if socket is None else Place(socket, groups)


def trace(start: Place) -> Place:
    """What decides the value of an input: an output that computes it, or an input whose own value it is.

    That is the first one itself where nothing stands at the end: behind a reroute or a muted node without a link, in a
    group without an output, in a circle of nodes.
    """
    place = start
    for _ in range(_MAX_STEPS):
        step = _through(place) if place.is_output else _across_link(place)
        if step is place:
            return place
        if step is None:
            return start
        place = step
    return start


def source(socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """The output socket that drives an input; None where its own value counts or nothing does."""
    place = trace(Place(socket))
    return place.socket if place.is_output else None


def constant(socket: bpy.types.NodeSocket) -> Any | None:
    """The value of an input: a float, or a tuple of floats. None where a node other than a constant drives it."""
    place = trace(Place(socket))
    if not place.is_output:
        return _plain(place.socket.default_value)
    if place.node.type == "RGB" and socket.type == "RGBA":
        return _plain(place.socket.default_value)
    if place.node.type == "VALUE":
        value = float(place.socket.default_value)
        return (value,) * 3 if socket.type in {"RGBA", "VECTOR"} else value
    return None


def describe(node: bpy.types.Node) -> str:
    """Such as ``node "Mix.001" (Mix Color)``."""
    return f'node "{node.name}" ({node.bl_label})'


def _across_link(place: Place) -> Place | None:
    """The output that an input is linked to. Links that are muted, in a circle or at hidden sockets carry nothing."""
    for link in place.socket.links:
        if link.is_valid and not link.is_muted and link.from_socket.enabled and link.to_socket.enabled:
            return Place(link.from_socket, place.groups)
    return None if place.node.mute or place.node.bl_idname == "NodeReroute" else place


def _through(place: Place) -> Place | None:
    """From an output to the input that it repeats; the place itself where its node computes something."""
    node, groups = place.node, place.groups
    if node.bl_idname == "NodeReroute":
        return Place(node.inputs[0], groups)
    if node.bl_idname == "NodeGroupInput":
        return find_input(groups[-1], place.socket.identifier, groups[:-1]) if groups else None
    if node.mute:
        links = (link for link in node.internal_links if link.to_socket == place.socket)
        return next((Place(link.from_socket, groups) for link in links), None)
    if node.type == "GROUP":
        # A group inside of itself, which only a broken file has, has no end.
        inside = None if node.node_tree is None or node in groups else _group_output(node.node_tree)
        return inside and find_input(inside, place.socket.identifier, (*groups, node))
    return place


def _group_output(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    outputs = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), outputs[0] if outputs else None)


def _plain(value: Any) -> Any:
    """Blender's array as a tuple (RGB of a colour), its number as a float."""
    return tuple(float(part) for part in value)[:3] if hasattr(value, "__len__") else float(value)
