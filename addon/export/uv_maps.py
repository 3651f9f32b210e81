# SPDX-License-Identifier: GPL-3.0-or-later
"""UV maps: which of them materials ask for by name, and how meshes use them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import bpy
import numpy as np
from svgf.scene import Mesh
from svgf.scene_validation import MOST_UV_LAYERS

# A mesh without UVs has them all at the origin.
_NOWHERE = np.zeros((2, 2))


class UvLayers:
    """The layers that all meshes of a scene are exported with, by the name of their UV map; "" is the active one.

    names: the first is ""; those beyond what a scene can hold are left out. known: all UV maps that some mesh has.
    """

    def __init__(
        self,
        names: Sequence[str] = ("",),
        aliases: frozenset[str] = frozenset(),
        known: frozenset[str] = frozenset(),
    ) -> None:
        """aliases: names that stand for the active map."""
        self.names = tuple(names)[:MOST_UV_LAYERS]
        self.known = known
        self._aliases = aliases

    def __eq__(self, other: object) -> bool:
        return isinstance(other, UvLayers) and vars(self) == vars(other)

    def index(self, uv_map: str) -> int:
        """Of a UV map that a material names; the active one's where it was left out."""
        return self.names.index(uv_map) if uv_map in self.names else 0

    def holds(self, uv_map: str) -> bool:
        return uv_map in self.names or uv_map in self._aliases


def find_uv_layers(materials: Iterable[bpy.types.Material], meshes: Iterable[bpy.types.Mesh]) -> UvLayers:
    """A map that is the active one of every mesh needs no layer of its own; one that no mesh has is (0, 0)."""
    named = [pair for material in materials if material.node_tree for pair in _names(material.node_tree, set())]
    if not named:
        return UvLayers()
    maps = [{layer.name: layer.active_render for layer in mesh.uv_layers} for mesh in meshes if len(mesh.uv_layers)]
    known = {name for names in maps for name in names}
    # An attribute that is no UV map of any mesh is something else.
    wanted = {name for name, is_attribute in named if name in known or not is_attribute}
    aliases = {name for name in wanted & known if all(names.get(name, False) for names in maps)}
    return UvLayers(("", *sorted(wanted - aliases)), frozenset(aliases), frozenset(known))


def _names(tree: bpy.types.NodeTree, seen: set[str]) -> Iterator[tuple[str, bool]]:
    """Of UV maps that nodes ask for, and whether as an attribute, which may be another; groups included."""
    if tree.name_full in seen:
        return
    seen.add(tree.name_full)
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            yield from _names(node.node_tree, seen)
        for attribute in ("uv_map", "attribute_name"):
            if name := getattr(node, attribute, ""):
                yield name, attribute == "attribute_name"


class UvUse:
    """What the meshes of one frame do with the UV maps of a material."""

    # Of a slot of a mesh and a layer: bounds, and how long U and V are. They change as rarely as meshes do.
    _facts: WeakKeyDictionary[Mesh, dict] = WeakKeyDictionary()

    def __init__(
        self,
        meshes: Sequence[Mesh],
        rows: Iterable[tuple[int, int]],
        table: Sequence[int],
        scales: Sequence[float],
    ) -> None:
        """rows: mesh and material_start of each placement. scales: of their transforms."""
        self._meshes = meshes
        self._slots: dict[int, dict[tuple[int, int], float]] = {}
        seen = set()
        for (mesh, start), scale in zip(rows, scales, strict=True):
            if (mesh, start) in seen:
                continue
            seen.add((mesh, start))
            for slot in range(int(meshes[mesh].material_slots.max()) + 1):
                self._slots.setdefault(table[start + slot], {}).setdefault((mesh, slot), scale)

    def bounds(self, material: int, layer: int) -> np.ndarray:
        """float64 [2, 2], smallest and largest UVs."""
        facts = [self._fact(mesh, slot, layer)[0] for mesh, slot in self._slots.get(material, ())]
        if not facts:
            return _NOWHERE
        return np.stack([np.min([fact[0] for fact in facts], 0), np.max([fact[1] for fact in facts], 0)])

    def metres(self, material: int, layer: int) -> tuple[float, float]:
        """Mean lengths of a unit of U and of V on the surface."""
        lengths, weights = [], []
        for (mesh, slot), scale in self._slots.get(material, {}).items():
            _, length, area = self._fact(mesh, slot, layer)
            lengths.append(length * scale)
            weights.append(area * scale * scale)
        if not lengths or not sum(weights):
            return 1.0, 1.0
        return tuple(float(f"{length:.4g}") for length in np.average(lengths, axis=0, weights=weights))

    def meshes_of(self, material: int) -> set[int]:
        """Indices."""
        return {mesh for mesh, _ in self._slots.get(material, ())}

    def without_uvs(self, material: int) -> list[str]:
        """Names of meshes."""
        meshes = (self._meshes[mesh] for mesh, _ in self._slots.get(material, ()))
        return sorted({mesh.name for mesh in meshes if mesh.uvs is None})

    def _fact(self, mesh_index: int, slot: int, layer: int) -> tuple[np.ndarray, np.ndarray, float]:
        mesh = self._meshes[mesh_index]
        facts = self._facts.setdefault(mesh, {})
        if (slot, layer) not in facts:
            facts[slot, layer] = _measure(mesh, slot, layer)
        return facts[slot, layer]


class MaterialUse:
    """What one material asked of the UvUse of its frame, to know later whether the answers are still the same."""

    def __init__(self, use: UvUse, index: int) -> None:
        self.index = index
        self._use = use
        self._answers: dict[tuple, object] = {}

    def bounds(self, layer: int) -> np.ndarray:
        return self._ask(UvUse.bounds, layer)

    def metres(self, layer: int) -> tuple[float, float]:
        return self._ask(UvUse.metres, layer)

    def without_uvs(self) -> list[str]:
        return self._ask(UvUse.without_uvs)

    def answers_like(self, other: MaterialUse) -> bool:
        """Whether it would answer what another one was asked in the same way."""
        return all(
            np.array_equal(self._ask(question, *arguments), answer)
            for (question, *arguments), answer in other._answers.items()
        )

    def _ask(self, question: Callable, *arguments: int) -> Any:
        answer = self._answers[question, *arguments] = question(self._use, self.index, *arguments)
        return answer


def _measure(mesh: Mesh, slot: int, layer: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Bounds [2, 2], lengths of U and V [2], and area of the triangles of a slot, in object space."""
    chosen = mesh.material_slots == slot
    if mesh.uvs is None or not chosen.any():
        return _NOWHERE, np.ones(2), 0.0
    uvs = mesh.uvs if mesh.uvs.ndim == 3 else mesh.uvs[layer]
    uvs = uvs[chosen].astype(np.float64)
    corners = mesh.positions[mesh.triangles[chosen]].astype(np.float64)
    bounds = np.stack([uvs.min((0, 1)), uvs.max((0, 1))])
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (u1, v1), (u2, v2) = (uvs[:, 1] - uvs[:, 0]).T, (uvs[:, 2] - uvs[:, 0]).T
    determinant = u1 * v2 - u2 * v1
    area = np.linalg.norm(np.cross(along, across), axis=1) / 2
    solid = (np.abs(determinant) > 1e-12) & (area > 0)
    if not solid.any():
        return bounds, np.ones(2), 0.0
    inverse = np.where(solid, 1 / np.where(solid, determinant, 1), 0)[:, None]
    by_u = (along * v2[:, None] - across * v1[:, None]) * inverse
    by_v = (across * u1[:, None] - along * u2[:, None]) * inverse
    lengths = [np.average(np.linalg.norm(by, axis=1)[solid], weights=area[solid]) for by in (by_u, by_v)]
    return bounds, np.array(lengths), float(area[solid].sum())
