# SPDX-License-Identifier: GPL-3.0-or-later
"""The inputs of one material: constants, images as they are, or textures baked of what nodes compute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np
from svgf.scene import Texture, TextureMap

from . import baking
from .evaluation import arithmetic, color
from .evaluation.expression import Expression, apply, constant
from .evaluation.images import sample_alpha, sample_color
from .node_values import ValueReader, component
from .nodes import Place, describe, trace
from .textures import TextureCache
from .uv_maps import MaterialUse, UvLayers

# Squares of UVs along a side: a texture that covers more of them is too coarse to be read up close.
_MANY_SQUARES = 8


class TextureTable:
    """Textures, numbered in the order in which they are met."""

    def __init__(self) -> None:
        self.textures: list[Texture] = []
        self._indices: dict[int, int] = {}

    def index(self, texture: Texture) -> int:
        if id(texture) not in self._indices:
            self._indices[id(texture)] = len(self.textures)
            self.textures.append(texture)
        return self._indices[id(texture)]


@dataclass(frozen=True)
class Context:
    """What the inputs of one material are read with. table: the textures of this material."""

    cache: TextureCache
    table: TextureTable
    layers: UvLayers
    use: MaterialUse


class InputReader:
    """Reads the inputs of one material."""

    def __init__(self, context: Context, values: ValueReader, name: str, find: Callable[[str], None]) -> None:
        self._context = context
        self._values = values
        self._name = name
        self._find = find
        self.tangent_layers: set[int] = set()  # UV layers that a mesh needs tangents of

    def layer(self, uv_map: str) -> int:
        """Of tangents."""
        layer = self._context.layers.index(uv_map)
        self.tangent_layers.add(layer)
        return layer

    def value(self, place: Place) -> Expression:
        return self._values.read(place)

    def number(self, place: Place, low: float = 0.0, high: float = 1.0) -> tuple[float, TextureMap | None]:
        return self.number_of(self._values.read(place), place, low, high)

    def color(self, place: Place, high: float = 1.0) -> tuple[tuple[float, float, float], TextureMap | None]:
        return self.color_of(self._values.read(place), place, high)

    def number_of(
        self, value: Expression, place: Place, low: float = 0.0, high: float = 1.0
    ) -> tuple[float, TextureMap | None]:
        """low, high: what the input is clamped to."""
        own = float(np.clip(place.socket.default_value, low, high))
        if value.value is not None:
            return float(np.clip(value.number(), low, high)), None
        reader, channel = _channel(value)
        if reader is not None:
            texture_map = self._direct(reader, channel)
            if texture_map is not None:
                return own, texture_map
        clamped = apply(arithmetic.clamp, value, constant(low), constant(high), kind="MINMAX")
        return own, self._baked(clamped, place, is_color=False)

    def color_of(
        self, value: Expression, place: Place, high: float = 1.0
    ) -> tuple[tuple[float, float, float], TextureMap | None]:
        own = tuple(float(part) for part in np.clip(place.socket.default_value[:3], 0.0, high))
        if value.value is not None:
            return tuple(float(part) for part in np.clip(value.vector(), 0.0, high)), None
        if value.function is sample_color:
            texture_map = self._direct(value, 0)
            if texture_map is not None:
                return own, texture_map
        clamped = apply(arithmetic.clamp, value, constant((0.0,) * 3), constant((high,) * 3), kind="MINMAX")
        return own, self._baked(clamped, place, is_color=True)

    def normal(self, place: Place | None, displacement: baking.Bump | None) -> tuple[float, TextureMap | None]:
        """The strength and the map of a Normal input.

        displacement: what bends the normals of the whole material.
        """
        normal = None if place is None else self._normal(place)
        if displacement is not None:
            normal = baking.Bump(
                displacement.height, displacement.strength, displacement.distance, displacement.sign, normal
            )
        if normal is None:
            return 1.0, None
        if isinstance(normal, baking.NormalMap) and normal.strength.value is not None:
            if normal.color.function is sample_color:
                texture_map = self._direct(normal.color, 0)
                if texture_map is not None:
                    self.tangent_layers.add(texture_map.uv_layer)
                    return max(normal.strength.number(), 0.0), texture_map
        parts = list(baking.parts_of(normal))
        if not any(part.coordinates for part in parts) and isinstance(normal, baking.Bump):
            return 1.0, None  # a flat height
        uv_map = self._uv_map(parts, place)
        if uv_map is None:
            return 1.0, None
        layer = self._context.layers.index(uv_map)
        if isinstance(normal, baking.NormalMap):  # bumps are baked for the triangles' own
            self.tangent_layers.add(layer)
        domain = baking.domain_of(parts, self._context.use.bounds(layer), uv_map)
        metres = self._context.use.metres(layer)
        texture = baking.bake_normal(f"{self._name} Normal", normal, domain, metres)
        return 1.0, self._map(texture, 0, domain.uv_map, domain.transform)

    def bump(self, node: Place, names: tuple[str, str | None, str], sign: float) -> baking.Bump:
        """Of a node with inputs for a height, a strength (or none: 1) and a distance."""
        height, strength, distance = (constant(1.0) if n is None else self._values.read(node.input(n)) for n in names)
        return baking.Bump(height, strength, distance, sign, None)

    def _normal(self, place: Place) -> baking.Normal | None:
        driver = trace(place)
        if not driver.is_output:
            return None
        node = driver.node
        if node.type == "BUMP":
            bump = self.bump(driver, ("Height", "Strength", "Distance"), -1.0 if node.invert else 1.0)
            below = self._normal(driver.input("Normal"))
            return baking.Bump(bump.height, bump.strength, bump.distance, bump.sign, below)
        if node.type == "NORMAL_MAP" and node.space == "TANGENT":
            value = self._values.read(driver.input("Color"))
            if getattr(node, "convention", "OPENGL") == "DIRECTX":
                value = apply(_flip_green, value)
            self._find_other_tangents(node, value)
            return baking.NormalMap(value, self._values.read(driver.input("Strength")))
        what = f"{node.space.lower().replace('_', ' ')} space of " if node.type == "NORMAL_MAP" else ""
        self._find(
            f'{what}{describe(node)} on "{place.socket.name}" is not supported yet; the normals of the mesh are used.'
        )
        return None

    def _find_other_tangents(self, node: bpy.types.Node, value: Expression) -> None:
        """Names a Normal Map node whose tangents are not those of the UV map that its image lies on."""
        index = self._context.layers.index
        others = [name for name in baking.uv_maps_of([value]) if index(name) != index(node.uv_map)]
        if others:
            self._find(
                f'{describe(node)} takes its tangents of another UV map than that of its image, which is not supported '
                "yet; they are those of the image's."
            )

    def _direct(self, reader: Expression, channel: int) -> TextureMap | None:
        """The image itself, where its coordinates are UVs through an affine transform."""
        place = baking.affine_of(reader.inputs[0])
        if place is None:
            return None
        texture = self._context.cache.texture(reader.settings["image"])
        return self._map(texture, channel, *place)

    def _baked(self, value: Expression, place: Place, is_color: bool) -> TextureMap | None:
        uv_map = self._uv_map([value], place)
        if uv_map is None:
            return None
        layer = self._context.layers.index(uv_map)
        bounds = self._context.use.bounds(layer)
        domain = baking.domain_of([value], bounds, uv_map)
        if domain.is_limited(bounds) and np.ptp(bounds, axis=0).max() > _MANY_SQUARES:
            self._find(
                f'"{place.socket.name}" is computed for many squares of the UV map; its texture is coarse up close.'
            )
        texture = baking.bake(f"{self._name} {place.socket.name}", value, domain, is_color)
        return self._map(texture, 0, domain.uv_map, domain.transform)

    def _uv_map(self, parts: list[Expression], place: Place) -> str | None:
        """The only UV map that they depend on."""
        names = baking.uv_maps_of(parts) or [""]
        if len({self._context.layers.index(name) for name in names}) == 1:
            return names[0]
        listed = ", ".join(f'"{name}"' if name else "the active one" for name in names)
        self._find(
            f'"{place.socket.name}" depends on several UV maps ({listed}), which is not supported yet; the value of '
            "the socket is used instead."
        )
        return None

    def _map(self, texture: Texture, channel: int, uv_map: str, transform: baking.Affine) -> TextureMap:
        without = self._context.use.without_uvs()
        if without:
            names = ", ".join(f'"{name}"' for name in without[:3]) + (" and others" if len(without) > 3 else "")
            self._find(f"mesh {names} has no UV map; textures are read at (0, 0) there, as in Cycles.")
        if not self._context.layers.holds(uv_map):
            self._find(f'UV map "{uv_map}" is one too many for one scene; the active one is used instead.')
        layer = self._context.layers.index(uv_map)
        return TextureMap(self._context.table.index(texture), channel, layer, transform)


def _channel(value: Expression) -> tuple[Expression | None, int]:
    """The image lookup that a number is a channel of."""
    if value.function is sample_alpha:
        return value, 3
    if not value.inputs or value.inputs[0].function is not sample_color:
        return None, 0
    reader = value.inputs[0]
    if value.function is component:
        return reader, value.settings["index"]
    return (reader, 0) if value.function is color.luminance and reader.settings["image"].is_gray else (None, 0)


def _flip_green(value: np.ndarray) -> np.ndarray:
    return value * np.float32([1, -1, 1]) + np.float32([0, 1, 0])
