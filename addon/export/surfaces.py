# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes as the records of a scene's materials: one for each closure, mixed as the nodes mix them.

What has no counterpart is named, with what is used instead. Sockets that have no effect (the roughness of a coat of
weight 0) are not looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from svgf.scene import DEEPEST_MIX, Material, MaterialKind, TextureMap

from . import baking
from .evaluation.expression import apply
from .material_inputs import InputReader
from .nodes import Place, constant, describe, trace

_BLACK = (0.0, 0.0, 0.0)
_WHITE = (1.0, 1.0, 1.0)
BLACK = Material(kind=MaterialKind.DIFFUSE, base_color=_BLACK)

# Numbers of the Principled BSDF by field, and what they are clamped to.
_PRINCIPLED = {
    "metallic": ("Metallic", 0.0, 1.0),
    "roughness": ("Roughness", 0.0, 1.0),
    "ior": ("IOR", 1e-5, 1000.0),
    "transmission": ("Transmission Weight", 0.0, 1.0),
    "specular_ior_level": ("Specular IOR Level", 0.0, np.inf),
    "alpha": ("Alpha", 0.0, 1.0),
    "diffuse_roughness": ("Diffuse Roughness", 0.0, 1.0),
}
_COAT = {"coat_roughness": ("Coat Roughness", 0.0, 1.0), "coat_ior": ("Coat IOR", 1.0, 1000.0)}
_SHEEN = {"sheen_roughness": ("Sheen Roughness", 0.0, 1.0)}
# Sockets that are left out where they are not 0, and what an artist calls them.
_LEFT_OUT = {"Thin Film Thickness": "thin film", "Thin Wall": "thin wall"}


@dataclass(frozen=True)
class Surface:
    """A record, and for MIX and ADD those that it is made of."""

    material: Material
    parts: tuple[Surface, ...] = ()

    @property
    def depth(self) -> int:
        return 1 + max(part.depth for part in self.parts) if self.parts else 0

    @property
    def lets_light_through(self) -> bool:
        """Straight, as transparent surfaces do."""
        own = self.material
        is_transparent = own.kind is MaterialKind.TRANSPARENT or own.alpha < 1 or "alpha" in own.maps
        return is_transparent or any(part.lets_light_through for part in self.parts)

    @property
    def has_bumps(self) -> bool:
        """Whether an image turns normals."""
        return "normal" in self.material.maps or any(part.has_bumps for part in self.parts)


@dataclass
class _Fields:
    """Inputs of a record while they are read."""

    values: dict[str, object] = field(default_factory=dict)
    maps: dict[str, TextureMap] = field(default_factory=dict)

    def add(self, name: str, value: object, texture_map: TextureMap | None) -> None:
        self.values[name] = value
        if texture_map is not None:
            self.maps[name] = texture_map

    def may_have(self, name: str) -> bool:
        return name in self.maps or bool(self.values.get(name))

    def material(self, kind: MaterialKind, **others: object) -> Material:
        return Material(kind=kind, maps=self.maps, **self.values, **others)


class SurfaceReader:
    """Reads the shaders of one material."""

    def __init__(
        self,
        inputs: InputReader,
        find: Callable[[str], None],
        displacement: baking.Bump | None,
    ) -> None:
        """displacement: what bends the normals of the whole material."""
        self._inputs = inputs
        self._find = find
        self._displacement = displacement
        self._above: list[tuple] = []
        self._readers: dict[str, Callable[[Place], Surface]] = {
            "BSDF_PRINCIPLED": self._principled,
            "BSDF_DIFFUSE": self._diffuse,
            "BSDF_GLOSSY": self._glossy,
            "BSDF_METALLIC": self._metallic,
            "BSDF_GLASS": self._glass,
            "BSDF_REFRACTION": self._refraction,
            "BSDF_TRANSLUCENT": self._translucent,
            "BSDF_TRANSPARENT": self._transparent,
            "SUBSURFACE_SCATTERING": self._subsurface,
            "EMISSION": self._emission,
            "ADD_SHADER": self._add,
            "MIX_SHADER": self._mix,
        }

    def read(self, start: Place) -> Surface:
        """What arrives at a shader socket. Nothing is black, as in Cycles."""
        place = trace(start)
        if not place.is_output:
            return Surface(BLACK)
        reader = self._readers.get(place.node.type)
        if reader is None:
            self._find(f"{describe(place.node)} is not supported yet; a default Principled BSDF is used instead.")
            return Surface(Material())
        if place.key in self._above:
            self._find(f"{describe(place.node)} is part of a circle of nodes; it is black there.")
            return Surface(BLACK)
        self._above.append(place.key)
        surface = reader(place)
        self._above.pop()
        return surface

    # Closures

    def _principled(self, node: Place) -> Surface:
        fields = _Fields()
        self._colors(fields, node, base_color="Base Color", specular_tint="Specular Tint")
        self._numbers(fields, node, _PRINCIPLED)
        self._anisotropy(fields, node, "Anisotropic", "Anisotropic Rotation", 0.0)
        self._numbers(fields, node, {"coat_weight": ("Coat Weight", 0.0, 1.0)})
        if fields.may_have("coat_weight"):
            self._numbers(fields, node, _COAT)
            self._colors(fields, node, coat_tint="Coat Tint")
            self._coat_normal(fields, node)
        self._numbers(fields, node, {"sheen_weight": ("Sheen Weight", 0.0, 1.0)})
        if fields.may_have("sheen_weight"):
            self._numbers(fields, node, _SHEEN)
            self._colors(fields, node, sheen_tint="Sheen Tint")
        subsurface, texture_map = self._inputs.number(node.input("Subsurface Weight"))
        if subsurface or texture_map:
            self._find("subsurface scattering is not supported yet; diffuse reflection is used instead.")
        self._emit(fields, node, "Emission Color", "Emission Strength")
        self._normal(fields, node)
        self._find_left_out(node)
        multiscatter = node.node.distribution == "MULTI_GGX"
        material = fields.material(MaterialKind.PRINCIPLED, subsurface_weight=subsurface, multiscatter=multiscatter)
        return Surface(material)

    def _diffuse(self, node: Place) -> Surface:
        fields = _Fields()
        self._colors(fields, node, base_color="Color")
        self._numbers(fields, node, {"diffuse_roughness": ("Roughness", 0.0, 1.0)})
        self._normal(fields, node)
        return Surface(fields.material(MaterialKind.DIFFUSE))

    def _subsurface(self, node: Place) -> Surface:
        self._find("subsurface scattering is not supported yet; diffuse reflection is used instead.")
        fields = _Fields()
        self._colors(fields, node, base_color="Color")
        self._normal(fields, node)
        return Surface(fields.material(MaterialKind.DIFFUSE))

    def _glossy(self, node: Place) -> Surface:
        return Surface(self._microfacets(node, MaterialKind.GLOSSY))

    def _glass(self, node: Place) -> Surface:
        self._find_left_out(node)
        return Surface(self._microfacets(node, MaterialKind.GLASS))

    def _refraction(self, node: Place) -> Surface:
        return Surface(self._microfacets(node, MaterialKind.REFRACTION))

    def _microfacets(self, node: Place, kind: MaterialKind) -> Material:
        fields = _Fields()
        self._colors(fields, node, base_color="Color")
        self._numbers(fields, node, {"roughness": ("Roughness", 0.0, 1.0)})
        if kind is MaterialKind.GLOSSY:
            self._anisotropy(fields, node, "Anisotropy", "Rotation", -1.0)
        else:
            self._numbers(fields, node, {"ior": ("IOR", 1e-5, 1000.0)})
        self._normal(fields, node)
        distribution = node.node.distribution
        if distribution not in {"GGX", "MULTI_GGX"} and fields.may_have("roughness"):
            name = distribution.replace("_", "-").title()
            self._find(f"the {name} distribution of {describe(node.node)} is not supported yet; GGX is used instead.")
        return fields.material(kind, multiscatter=distribution == "MULTI_GGX")

    def _metallic(self, node: Place) -> Surface:
        """A metallic Principled BSDF, whose specular tint is the colour at grazing angles."""
        fields = _Fields()
        if node.node.fresnel_type == "F82":
            self._colors(fields, node, base_color="Base Color", specular_tint="Edge Tint")
        else:
            index, extinction = (np.array(self._constant(node.input(n))) for n in ("IOR", "Extinction"))
            facing, edge = conductor_colors(index, extinction)
            fields.values.update(base_color=facing, specular_tint=edge)
        self._numbers(fields, node, {"roughness": ("Roughness", 0.0, 1.0)})
        self._anisotropy(fields, node, "Anisotropy", "Rotation", 0.0)
        self._normal(fields, node)
        self._find_left_out(node)
        multiscatter = node.node.distribution == "MULTI_GGX"
        return Surface(fields.material(MaterialKind.PRINCIPLED, metallic=1.0, multiscatter=multiscatter))

    def _translucent(self, node: Place) -> Surface:
        fields = _Fields()
        self._colors(fields, node, base_color="Color")
        self._normal(fields, node)
        return Surface(fields.material(MaterialKind.TRANSLUCENT))

    def _transparent(self, node: Place) -> Surface:
        fields = _Fields()
        self._colors(fields, node, base_color="Color")
        return Surface(fields.material(MaterialKind.TRANSPARENT))

    def _emission(self, node: Place) -> Surface:
        fields = _Fields({"base_color": _BLACK})
        self._emit(fields, node, "Color", "Strength")
        return Surface(fields.material(MaterialKind.DIFFUSE))

    # Mixes

    def _add(self, node: Place) -> Surface:
        first, second = self.read(node.input(0)), self.read(node.input(1))
        merged = _merged(first, second) or _merged(second, first)
        return merged or self._checked(Surface(Material(kind=MaterialKind.ADD), (first, second)))

    def _mix(self, node: Place) -> Surface:
        fields = _Fields()
        start = node.input(0)
        factor = trace(start)
        kind = factor.node.type if factor.is_output else ""
        if kind in {"FRESNEL", "LAYER_WEIGHT"} and trace(factor.input("Normal")).is_output:
            self._find(f'a normal of its own of {describe(factor.node)} is not supported yet; it has the surface\'s.')
        if kind == "FRESNEL":
            ior = self._constant(factor.input("IOR"))
            fields.values["factor_fresnel_ior"] = max(float(ior), 1e-5)
        elif kind == "LAYER_WEIGHT":
            blend = float(np.clip(self._constant(factor.input("Blend")), 0.0, 1.0))
            if factor.socket.identifier == "Fresnel":
                fields.values["factor_fresnel_ior"] = 1.0 / max(1.0 - blend, 1e-5)
            else:
                fields.values["factor_facing_blend"] = blend
        else:
            value, texture_map = self._inputs.number(start)
            if texture_map is None and value in (0.0, 1.0):
                return self.read(node.input(2 if value else 1))
            fields.add("factor", value, texture_map)
        parts = self.read(node.input(1)), self.read(node.input(2))
        return self._checked(Surface(fields.material(MaterialKind.MIX), parts))

    def _checked(self, surface: Surface) -> Surface:
        if surface.depth <= DEEPEST_MIX:
            return surface
        self._find(
            f"more than {DEEPEST_MIX} levels of mixed shaders are not supported; the first of the outer is used."
        )
        return surface.parts[0]

    # Inputs

    def _colors(self, fields: _Fields, node: Place, **sockets: str) -> None:
        for name, socket in sockets.items():
            fields.add(name, *self._inputs.color(node.input(socket)))

    def _numbers(self, fields: _Fields, node: Place, sockets: dict[str, tuple[str, float, float]]) -> None:
        for name, (socket, low, high) in sockets.items():
            place = node.input(socket)
            if place is not None:
                fields.add(name, *self._inputs.number(place, low, high))

    def _anisotropy(self, fields: _Fields, node: Place, amount: str, rotation: str, low: float) -> None:
        fields.add("anisotropic", *self._inputs.number(node.input(amount), low, 1.0))
        if not fields.may_have("anisotropic"):
            return
        value, texture_map = self._inputs.number(node.input(rotation), -np.inf, np.inf)
        fields.add("anisotropic_rotation", value % 1.0, texture_map)
        driver = trace(node.input("Tangent"))
        if not driver.is_output:
            return
        if driver.node.type == "TANGENT" and driver.node.direction_type == "UV_MAP":
            fields.values["tangent_uv_layer"] = self._inputs.layer(driver.node.uv_map)
        elif driver.node.type != "TANGENT" or driver.node.axis != "Z":
            self._find(f"tangents of {describe(driver.node)} are not supported yet; they circle around the Z axis.")

    def _emit(self, fields: _Fields, node: Place, color_name: str, strength_name: str) -> None:
        """A map multiplies the constant, so that a constant strength needs no texture of its own."""
        place = node.input(color_name)
        strength = self._inputs.value(node.input(strength_name))
        if strength.value is None:
            value = apply(_scaled, self._inputs.value(place), strength)
            radiance, texture_map = self._inputs.color_of(value, place, np.inf)
            fields.add("emission", radiance if texture_map is None else _WHITE, texture_map)
            return
        factor = max(strength.number(), 0.0)
        if not factor:
            return
        radiance, texture_map = self._inputs.color(place, np.inf)
        radiance = _WHITE if texture_map else radiance
        fields.add("emission", tuple(factor * part for part in radiance), texture_map)

    def _normal(self, fields: _Fields, node: Place) -> None:
        strength, texture_map = self._inputs.normal(node.input("Normal"), self._displacement)
        if texture_map is not None:
            fields.maps["normal"] = texture_map
            fields.values["normal_strength"] = strength

    def _coat_normal(self, fields: _Fields, node: Place) -> None:
        """Without a link the coat is smooth, but for what displaces the whole surface."""
        coat, base = trace(node.input("Coat Normal")), trace(node.input("Normal"))
        if coat.is_output and (not base.is_output or coat.key != base.key):
            self._find("a normal map of the coat's own is not supported yet; it has that of the surface below.")
        fields.values["coat_normal_mapped"] = coat.is_output or (self._displacement is not None and not base.is_output)

    def _constant(self, place: Place):
        """A constant of a node that no texture can drive."""
        value = self._inputs.value(place)
        if value.value is None:
            driver = trace(place).node
            self._find(
                f'{describe(driver)} on "{place.socket.name}" is not supported yet; the value of the socket is used '
                "instead."
            )
            return place.socket.default_value
        return value.number() if value.value.ndim == 1 else value.vector()

    def _find_left_out(self, node: Place) -> None:
        for name, feature in _LEFT_OUT.items():
            place = node.input(name)
            # A driven weight counts as one: nobody links a socket to leave it at 0.
            if place is not None and constant(place.socket) != 0:
                self._find(f"{feature} is not supported yet; it is left out.")


def conductor_colors(index: np.ndarray, extinction: np.ndarray) -> tuple[tuple, tuple]:
    """Colours [3] of a metal facing the view, and at about 82 degrees relative to Schlick's curve [Kutz21]."""
    cosine = 1 / 7
    facing = _conductor_reflectance(index, extinction, 1.0)
    schlick = facing + (1 - facing) * (1 - cosine) ** 5
    edge = np.clip(_conductor_reflectance(index, extinction, cosine) / schlick, 0, 1)
    return tuple(map(float, np.clip(facing, 0, 1))), tuple(map(float, edge))


def _conductor_reflectance(index: np.ndarray, extinction: np.ndarray, cosine: float) -> np.ndarray:
    """Unpolarised, for complex indices of refraction [3]."""
    complex_index = index + 1j * extinction
    inside = np.sqrt(1 - (1 - cosine**2) / complex_index**2)
    across = (cosine - complex_index * inside) / (cosine + complex_index * inside)
    along = (complex_index * cosine - inside) / (complex_index * cosine + inside)
    return (np.abs(across) ** 2 + np.abs(along) ** 2) / 2


def _scaled(value: np.ndarray, strength: np.ndarray) -> np.ndarray:
    return value * np.maximum(strength, 0)[:, None]


def _merged(surface: Surface, light: Surface) -> Surface | None:
    """A surface that emits what a second one does, where that one only emits and nothing lies above the emission."""
    base, lamp = surface.material, light.material
    emits = lamp.kind is MaterialKind.DIFFUSE and lamp.base_color == _BLACK and set(lamp.maps) <= {"emission"}
    if not emits or base.kind not in (MaterialKind.PRINCIPLED, MaterialKind.DIFFUSE):
        return None
    if base.alpha < 1 or any(base.may_have(name) for name in ("coat_weight", "sheen_weight")):
        return None
    if {"alpha", "emission"} & set(base.maps) or (lamp.maps and base.emission != _BLACK):
        return None
    emission = tuple(a + b for a, b in zip(base.emission, lamp.emission, strict=True))
    return Surface(replace(base, emission=emission, maps={**base.maps, **lamp.maps}))
