# SPDX-License-Identifier: GPL-3.0-or-later
"""From a warning to what it is about."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..export.findings import Finding
from ..viewport.views import sessions_of

# The tab of the properties where data-blocks of a type are edited; others are edited as an object's data.
_TABS = {
    "OBJECT": "OBJECT",
    "MATERIAL": "MATERIAL",
    "IMAGE": "MATERIAL",
    "NODETREE": "MATERIAL",
    "WORLD": "WORLD",
    "SCENE": "RENDER",
    "PARTICLE": "PARTICLES",
    "COLLECTION": "COLLECTION",
}


class SVGF_OT_select_culprit(bpy.types.Operator):
    """Select the objects that a warning is about, and show the properties where it can be settled"""

    bl_idname = "svgf.select_culprit"
    bl_label = "Select What This Is About"
    bl_options = {"REGISTER", "UNDO"}

    finding: bpy.props.IntProperty(
        name="Warning", description="Place of the warning in the list", default=0, min=0, max=10**6, options={"HIDDEN"}
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        sessions = sessions_of(context.scene)
        if not sessions or self.finding >= len(sessions[-1].findings):
            self.report({"WARNING"}, "This warning is no longer there.")
            return {"CANCELLED"}
        finding = sessions[-1].findings[self.finding]
        tab = _TABS.get(finding.id_type, "DATA")
        objects = list(find_objects(finding, context.view_layer))
        if objects:
            select(objects, context.view_layer)
            if tab == "MATERIAL":
                _make_material_active(objects[0], finding)
        elif tab not in {"WORLD", "RENDER"}:
            self.report({"WARNING"}, "No object of this view layer uses it.")
        _show_tab(context, tab)
        return {"FINISHED"}


def find_objects(finding: Finding, view_layer: bpy.types.ViewLayer) -> Iterator[bpy.types.Object]:
    """The objects of a view layer that have one of a warning's data-blocks."""
    for obj in view_layer.objects:
        if any(name in finding.names for name in _names_in(obj, finding.id_type)):
            yield obj


def select(objects: list[bpy.types.Object], view_layer: bpy.types.ViewLayer) -> None:
    """These and no others, the first one active."""
    for obj in view_layer.objects:
        obj.select_set(obj in objects)
    view_layer.objects.active = objects[0]


def _names_in(obj: bpy.types.Object, id_type: str) -> Iterator[str]:
    """Names of the data-blocks of one type that an object has."""
    match id_type:
        case "OBJECT":
            yield obj.name
        case "MATERIAL" | "IMAGE" | "NODETREE":
            for slot in obj.material_slots:
                if slot.material is not None:
                    yield from _names_in_material(slot.material, id_type)
        case "PARTICLE":
            yield from (system.settings.name for system in obj.particle_systems)
        case "COLLECTION":
            yield from (collection.name for collection in obj.users_collection)
        case "WORLD" | "SCENE":
            pass
        case _:
            if obj.data is not None and obj.data.id_type == id_type:
                yield obj.data.name


def _names_in_material(material: bpy.types.Material, id_type: str) -> Iterator[str]:
    if id_type == "MATERIAL":
        yield material.name
    elif material.node_tree is not None:
        yield from _names_in_tree(material.node_tree, id_type, set())


def _names_in_tree(tree: bpy.types.NodeTree, id_type: str, seen: set[str]) -> Iterator[str]:
    """seen: groups that were looked into, because Blender's files may hold cycles of them."""
    for node in tree.nodes:
        datablock = getattr(node, "image", None) if id_type == "IMAGE" else getattr(node, "node_tree", None)
        if datablock is not None:
            yield datablock.name
        group = getattr(node, "node_tree", None)
        if group is not None and group.name not in seen:
            seen.add(group.name)
            yield from _names_in_tree(group, id_type, seen)


def _make_material_active(obj: bpy.types.Object, finding: Finding) -> None:
    for index, slot in enumerate(obj.material_slots):
        found = _names_in_material(slot.material, finding.id_type) if slot.material is not None else ()
        if any(name in finding.names for name in found):
            obj.active_material_index = index
            return


def _show_tab(context: bpy.types.Context, tab: str) -> None:
    space = context.space_data
    if space is not None and space.type == "PROPERTIES":
        try:
            space.context = tab
        except TypeError:  # not for this object
            pass


def register() -> None:
    bpy.utils.register_class(SVGF_OT_select_culprit)


def unregister() -> None:
    bpy.utils.unregister_class(SVGF_OT_select_culprit)
