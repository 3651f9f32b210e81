# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials: Blender's shader nodes as the inputs of one Principled BSDF, exactly where that is possible.

Everything else is named, with what is used instead. Sockets that have no effect (the roughness of a coat of weight 0)
are not looked at.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import bpy
from svgf.scene import Material, Texture, TextureMap

from .findings import Findings
from .nodes import constant, describe, has_nodes, source
from .textures import TextureCache

_MAGENTA = (1.0, 0.0, 1.0)
_BLACK = (0.0, 0.0, 0.0)
# Weight sockets of Principled BSDF layers that are left out, and what an artist calls them.
_LAYERS = {
    "Subsurface Weight": "subsurface scattering",
    "Coat Weight": "coat",
    "Sheen Weight": "sheen",
    "Thin Film Thickness": "thin film",
    "Diffuse Roughness": "diffuse roughness",
    "Anisotropic": "anisotropy",
    "Thin Wall": "thin wall",
}
_LAMBERT = Material(roughness=1.0, specular_ior_level=0.0)


@dataclass(frozen=True)
class _Surface:
    """A material before its texture has a number."""

    material: Material
    texture: Texture | None = None


class MaterialTable:
    """The materials and textures of one frame, numbered in the order in which they are met."""

    def __init__(self, textures: TextureCache, findings: Findings) -> None:
        self.materials: list[Material] = []
        self.textures: list[Texture] = []
        self._cache = textures
        self._findings = findings
        self._indices: dict[str | None, int] = {}

    def index(self, material: bpy.types.Material | None) -> int:
        """The number of a material; None is an empty slot, which Cycles renders as a default Principled BSDF."""
        key = material and material.name_full
        if key not in self._indices:
            if material is None:
                surface = _Surface(Material())
            else:
                surface = _Reader(material, self._cache, self._findings).surface()
            self._indices[key] = len(self.materials)
            texture = self._texture_index(surface.texture)
            maps = {} if texture < 0 else {"base_color": TextureMap(texture)}
            self.materials.append(replace(surface.material, maps=maps))
        return self._indices[key]

    def _texture_index(self, texture: Texture | None) -> int:
        if texture is None:
            return -1
        for index, other in enumerate(self.textures):
            if other is texture:
                return index
        self.textures.append(texture)
        return len(self.textures) - 1


class _Reader:
    """Reads one material."""

    def __init__(self, material: bpy.types.Material, textures: TextureCache, findings: Findings) -> None:
        self._material = material
        self._textures = textures
        self._findings = findings
        self._node_readers = {
            "BSDF_PRINCIPLED": self._principled,
            "BSDF_DIFFUSE": self._diffuse,
            "BSDF_GLOSSY": self._glossy,
            "BSDF_METALLIC": self._metallic,
            "BSDF_GLASS": self._glass,
            "BSDF_TRANSPARENT": self._transparent,
            "EMISSION": self._emission,
            "ADD_SHADER": self._add,
            "MIX_SHADER": self._mix,
        }

    def surface(self) -> _Surface:
        material = self._material
        if not has_nodes(material):
            return self._named(_Surface(replace(_LAMBERT, base_color=_unit_color(material.diffuse_color[:3]))))
        output = material.node_tree.get_output_node("CYCLES")
        if output is None:
            return self._named(_Surface(replace(_LAMBERT, base_color=_BLACK)))
        if source(output.inputs["Volume"]) is not None:
            self._find("volumes are not supported yet; the inside is empty.")
        if source(output.inputs["Displacement"]) is not None:
            self._find("displacement is not supported yet; the surface stays as it is.")
        return self._named(self._shader(output.inputs["Surface"]))

    def _named(self, surface: _Surface) -> _Surface:
        return replace(surface, material=replace(surface.material, name=self._material.name))

    def _find(self, text: str) -> None:
        self._findings.add(self._material, text)

    # Shaders

    def _shader(self, socket: bpy.types.NodeSocket) -> _Surface:
        """What arrives at a shader socket. Nothing is black, as in Cycles."""
        driver = source(socket)
        if driver is None:
            return _Surface(replace(_LAMBERT, base_color=_BLACK))
        node = driver.node
        reader = self._node_readers.get(node.type)
        if reader is None or node.mute:
            self._find(f"{describe(node)} is not supported yet; a default Principled BSDF is used instead.")
            return _Surface(Material())
        return reader(node)

    def _principled(self, node: bpy.types.Node) -> _Surface:
        base_color, texture = self._color(node.inputs["Base Color"])
        strength = self._number(node.inputs["Emission Strength"])
        emission = _BLACK
        if strength > 0:
            emission = tuple(max(c, 0.0) * strength for c in self._constant(node.inputs["Emission Color"]))
        metallic = _unit(self._number(node.inputs["Metallic"]))
        self._find_principled(node, metallic)
        ior = self._number(node.inputs["IOR"])
        level = self._number(node.inputs["Specular IOR Level"])
        if ior < 1:
            self._find(f"an IOR of {ior:g} is not supported yet; 1 is used instead.")
        if level > 1:
            self._find(f"a Specular IOR Level of {level:g} is not supported yet; 1 is used instead.")
        return _Surface(
            Material(
                base_color=base_color,
                metallic=metallic,
                roughness=_unit(self._number(node.inputs["Roughness"])),
                ior=max(ior, 1.0),
                transmission=_unit(self._number(node.inputs["Transmission Weight"])),
                specular_ior_level=_unit(level),
                specular_tint=_unit_color(self._constant(node.inputs["Specular Tint"])),
                emission=emission,
            ),
            texture,
        )

    def _find_principled(self, node: bpy.types.Node, metallic: float) -> None:
        for name, feature in _LAYERS.items():
            socket = node.inputs.get(name)
            # A driven weight counts as one: nobody links a socket to leave it at 0.
            if socket is not None and (socket.default_value if source(socket) is None else True):
                self._find(f"{feature} is not supported yet; it is left out.")
        alpha = node.inputs["Alpha"]
        if constant(alpha) is None or constant(alpha) < 1:
            self._find("alpha is not supported yet; the surface is opaque.")
        self._find_normal(node)

    def _diffuse(self, node: bpy.types.Node) -> _Surface:
        base_color, texture = self._color(node.inputs["Color"])
        if constant(node.inputs["Roughness"]) != 0:
            self._find("diffuse roughness is not supported yet; it is left out.")
        self._find_normal(node)
        return _Surface(replace(_LAMBERT, base_color=base_color), texture)

    def _glossy(self, node: bpy.types.Node) -> _Surface:
        """A metal turns white at grazing angles where Glossy keeps its colour: exact for white alone."""
        base_color, texture = self._color(node.inputs["Color"])
        if texture is not None or base_color != (1.0, 1.0, 1.0):
            self._find(
                f"the colour of {describe(node)} at grazing angles is not supported yet; a metal is used instead."
            )
        if constant(node.inputs["Anisotropy"]) != 0:
            self._find("anisotropy is not supported yet; it is left out.")
        self._find_normal(node)
        roughness = _unit(self._number(node.inputs["Roughness"]))
        return _Surface(Material(base_color=base_color, metallic=1.0, roughness=roughness), texture)

    def _metallic(self, node: bpy.types.Node) -> _Surface:
        base_color, texture = self._color(node.inputs["Base Color"])
        self._find(
            f"the edge tint of {describe(node)} is not supported yet; a metallic Principled BSDF is used instead."
        )
        self._find_normal(node)
        roughness = _unit(self._number(node.inputs["Roughness"]))
        return _Surface(Material(base_color=base_color, metallic=1.0, roughness=roughness), texture)

    def _glass(self, node: bpy.types.Node) -> _Surface:
        """Principled glass takes the root of its base colour at each interface, and reflects white."""
        color = self._constant(node.inputs["Color"])
        if color != (1.0, 1.0, 1.0):
            self._find(f"the colour of reflections in {describe(node)} is not supported yet; they are white.")
        self._find_normal(node)
        return _Surface(
            Material(
                base_color=_unit_color(c * c for c in color),
                roughness=_unit(self._number(node.inputs["Roughness"])),
                ior=max(self._number(node.inputs["IOR"]), 1.0),
                transmission=1.0,
            )
        )

    def _transparent(self, node: bpy.types.Node) -> _Surface:
        """Glass of IOR 1 lets rays pass straight, but not the shadow rays to lamps."""
        color = self._constant(node.inputs["Color"])
        self._find(
            f"{describe(node)} is not supported yet; clear glass of IOR 1, which casts shadows, is used instead."
        )
        return _Surface(
            Material(base_color=_unit_color(c * c for c in color), roughness=0.0, ior=1.0, transmission=1.0)
        )

    def _emission(self, node: bpy.types.Node) -> _Surface:
        strength = max(self._number(node.inputs["Strength"]), 0.0)
        emission = tuple(max(c, 0.0) * strength for c in self._constant(node.inputs["Color"]))
        return _Surface(replace(_LAMBERT, base_color=_BLACK, emission=emission))

    def _add(self, node: bpy.types.Node) -> _Surface:
        """Exact where one of the two only emits."""
        first, second = (self._shader(socket) for socket in node.inputs[:2])
        if _only_emits(first):
            first, second = second, first
        if not _only_emits(second):
            self._find(f"{describe(node)} of two surfaces is not supported yet; the first one is used instead.")
        emission = tuple(a + b for a, b in zip(first.material.emission, second.material.emission, strict=True))
        return replace(first, material=replace(first.material, emission=emission))

    def _mix(self, node: bpy.types.Node) -> _Surface:
        """Exact where the factor is 0 or 1."""
        factor = self._number(node.inputs[0])
        if 0 < factor < 1:
            self._find(f"{describe(node)} is not supported yet; the shader with the larger share is used instead.")
        return self._shader(node.inputs[2 if factor > 0.5 else 1])

    # Sockets

    def _color(self, socket: bpy.types.NodeSocket) -> tuple[tuple[float, float, float], Texture | None]:
        """A constant colour, or the texture of an Image Texture that is linked directly."""
        driver = source(socket)
        if driver is None or driver.node.type != "TEX_IMAGE" or driver.identifier != "Color" or driver.node.mute:
            return _unit_color(self._constant(socket)), None
        texture = self._textures.get(driver.node, self._material, self._findings)
        return _unit_color(socket.default_value[:3]) if texture else _MAGENTA, texture

    def _number(self, socket: bpy.types.NodeSocket) -> float:
        return float(self._constant(socket))

    def _constant(self, socket: bpy.types.NodeSocket) -> Any:
        """The value of a socket; where a node drives it, that node is named and the socket's own value used."""
        value = constant(socket)
        if value is None:
            node = source(socket).node
            self._find(
                f'{describe(node)} on "{socket.name}" is not supported yet; the value of the socket is used instead.'
            )
            value = socket.default_value
            value = tuple(value)[:3] if hasattr(value, "__len__") else value
        return value

    def _find_normal(self, node: bpy.types.Node) -> None:
        driver = source(node.inputs["Normal"])
        if driver is None:
            return
        if driver.node.type == "NORMAL_MAP":
            self._find("normal maps are not supported yet; the normals of the mesh are used instead.")
        elif driver.node.type == "BUMP":
            self._find("bump maps are not supported yet; the normals of the mesh are used instead.")
        else:
            self._find(f'{describe(driver.node)} on "Normal" is not supported yet; the normals of the mesh are used.')


def _unit(value: float) -> float:
    return min(max(value, 0.0), 1.0)


def _unit_color(color) -> tuple[float, float, float]:
    return tuple(_unit(float(channel)) for channel in color)


def _only_emits(surface: _Surface) -> bool:
    material = surface.material
    return surface.texture is None and replace(material, emission=_BLACK) == replace(_LAMBERT, base_color=_BLACK)
