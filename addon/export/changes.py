# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender says has changed, as the least that has to be exported again."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import bpy

_NOTHING: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Changes:
    """geometry: full names of objects whose meshes may differ. images: full names of images whose pixels may.

    materials: full names of those whose nodes may differ; None: any.
    moves_only: objects have moved, and that is all. Otherwise lamps and the world, which are few, are read again.
    """

    geometry: frozenset[str] = _NOTHING
    images: frozenset[str] = _NOTHING
    materials: frozenset[str] | None = _NOTHING
    moves_only: bool = False


def find_changes(updates: Iterable[bpy.types.DepsgraphUpdate]) -> Changes | None:
    """The changes of one evaluation, None where there is nothing to export.

    A camera is no part of an exported view, whose own camera comes from its matrices. A scene without flags may mean
    that an object was selected as well as hidden.
    """
    geometry, images, materials, exports, moves_only = set(), set(), set(), False, True
    trees, owned = set(), set()
    for update in updates:
        changed = update.id
        if isinstance(changed, bpy.types.Camera) or getattr(changed, "type", "") == "CAMERA":
            continue
        exports = True
        moves_only &= isinstance(changed, bpy.types.Object) and _has_only_moved(update)
        if isinstance(changed, bpy.types.Material):
            materials.add(changed.name_full)
            owned.add(changed.original.node_tree)
        elif isinstance(changed, bpy.types.NodeTree):
            trees.add(changed.original)
        elif isinstance(changed, bpy.types.Image):
            images.add(changed.name_full)
        elif isinstance(changed, bpy.types.Object) and update.is_updated_geometry:
            geometry.add(changed.name_full)
    if not exports:
        return None
    # A tree comes without its material where a colour ramp was edited; a group may be used by any.
    known = frozenset(materials) if trees <= owned else None
    return Changes(frozenset(geometry), frozenset(images), known, moves_only)


def _has_only_moved(update: bpy.types.DepsgraphUpdate) -> bool:
    return update.is_updated_transform and not (update.is_updated_geometry or update.is_updated_shading)
