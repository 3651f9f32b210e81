# SPDX-License-Identifier: Apache-2.0
"""How the objects of a scene are read from the records of a scene file, field by field. Writing needs no schema."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields
from enum import Enum, IntFlag
from typing import Any, Protocol

import numpy as np

from .light_paths import LightPaths
from .scene import (
    Aperture,
    Camera,
    Extension,
    Instances,
    Interpolation,
    Light,
    LightKind,
    Material,
    MaterialKind,
    Mesh,
    Projection,
    RayVisibility,
    RenderDefaults,
    Scene,
    Texture,
    TextureMap,
    World,
)
from .scene_validation import shown

# Objects that frames share: a frame names them by table and row.
TABLES: dict[str, type] = {
    "meshes": Mesh,
    "instances": Instances,
    "materials": Material,
    "textures": Texture,
    "lights": Light,
    "cameras": Camera,
}
TABLE_OF = {kind: table for table, kind in TABLES.items()}


class Malformed(Exception):
    """A field of a file that does not hold what it should."""

    def __init__(self, field: str, problem: str) -> None:
        super().__init__(f"{field} {problem}.")


class Referred(Protocol):
    """What records refer to. ``field`` says where, for Malformed."""

    def array(self, field: str, digest: Any) -> np.ndarray: ...

    def object(self, kind: type, field: str, row: Any) -> Any: ...


def decode(kind: type, referred: Referred, field: str, record: Any) -> Any:
    """The object of a dataclass from its record. Raises Malformed."""
    if not isinstance(record, dict):
        raise Malformed(field, "is not a record")
    decoders = SCHEMA[kind]
    odd = sorted((record.keys() ^ decoders.keys()) - (_OPTIONAL[kind] - record.keys()))
    if odd:
        raise Malformed(f"{field}.{odd[0]}", "is missing" if odd[0] in decoders else "is not a known field")
    return kind(
        **{
            name: decode_field(referred, f"{field}.{name}", record[name])
            for name, decode_field in decoders.items()
            if name in record
        }
    )


# From what a field of a record holds to what the dataclass holds.
_Decoder = Callable[[Referred, str, Any], Any]


def _plain(*kinds: type) -> _Decoder:
    def decode(referred: Referred, field: str, value: Any) -> Any:
        if type(value) not in kinds:
            raise Malformed(field, f"is {shown(value)}, not of type {kinds[0].__name__}")
        try:
            return kinds[0](value)
        except OverflowError:
            raise Malformed(field, "is not a finite number") from None

    return decode


def _tuple_of(decode_item: _Decoder) -> _Decoder:
    def decode(referred: Referred, field: str, values: Any) -> Any:
        if not isinstance(values, list):
            raise Malformed(field, f"is {shown(values)}, not a list")
        return tuple(decode_item(referred, f"{field}[{index}]", value) for index, value in enumerate(values))

    return decode


def _optional(decode_value: _Decoder) -> _Decoder:
    return lambda referred, field, value: None if value is None else decode_value(referred, field, value)


def _member(kind: type[Enum]) -> _Decoder:
    names = {member.name: member for member in kind}

    def decode(referred: Referred, field: str, value: Any) -> Enum:
        if not isinstance(value, str) or value not in names:
            raise Malformed(field, f"is {shown(value)}, not one of {', '.join(names)}")
        return names[value]

    return decode


def _flags(kind: type[IntFlag]) -> _Decoder:
    def decode(referred: Referred, field: str, value: Any) -> IntFlag:
        if type(value) is not int or not 0 <= value <= sum(kind):
            raise Malformed(field, f"is {shown(value)}, not a set of flags")
        return kind(value)

    return decode


def _row_of(kind: type) -> _Decoder:
    return lambda referred, field, row: referred.object(kind, field, row)


def _record_of(kind: type) -> _Decoder:
    return lambda referred, field, record: decode(kind, referred, field, record)


def _dict_of(decode_value: _Decoder) -> _Decoder:
    def decode(referred: Referred, field: str, values: Any) -> Any:
        if not isinstance(values, dict):
            raise Malformed(field, f"is {shown(values)}, not a record")
        return {name: decode_value(referred, f"{field}[{name}]", value) for name, value in values.items()}

    return decode


def _array(referred: Referred, field: str, digest: Any) -> np.ndarray:
    return referred.array(field, digest)


_text, _flag, _integer, _number = _plain(str), _plain(bool), _plain(int), _plain(float, int)
_numbers = _tuple_of(_number)

# A test holds this to the dataclasses.
SCHEMA: dict[type, dict[str, _Decoder]] = {
    Mesh: {
        "name": _text,
        "positions": _array,
        "triangles": _array,
        "normals": _array,
        "material_slots": _array,
        "uvs": _optional(_array),
        "previous_positions": _optional(_array),
        "tangents": _optional(_array),
        "tangent_layer": _integer,
    },
    Instances: {
        **dict.fromkeys((field.name for field in fields(Instances)), _array),
        **dict.fromkeys(("visibility", "terminator_offset"), _optional(_array)),
    },
    Material: {
        "name": _text,
        "kind": _member(MaterialKind),
        "base_color": _numbers,
        "metallic": _number,
        "roughness": _number,
        "ior": _number,
        "transmission": _number,
        "specular_ior_level": _number,
        "specular_tint": _numbers,
        "anisotropic": _number,
        "anisotropic_rotation": _number,
        "tangent_uv_layer": _integer,
        "coat_weight": _number,
        "coat_roughness": _number,
        "coat_ior": _number,
        "coat_tint": _numbers,
        "coat_normal_mapped": _flag,
        "sheen_weight": _number,
        "sheen_roughness": _number,
        "sheen_tint": _numbers,
        "emission": _numbers,
        "alpha": _number,
        "diffuse_roughness": _number,
        "subsurface_weight": _number,
        "normal_strength": _number,
        "multiscatter": _flag,
        "maps": _dict_of(_record_of(TextureMap)),
        "first": _integer,
        "second": _integer,
        "factor": _number,
        "factor_fresnel_ior": _number,
        "factor_facing_blend": _number,
    },
    TextureMap: {"texture": _integer, "channel": _integer, "uv_layer": _integer, "uv_transform": _numbers},
    Texture: {
        "name": _text,
        "pixels": _array,
        "srgb": _flag,
        "interpolation": _member(Interpolation),
        "extension": _member(Extension),
        "associated_alpha": _flag,
    },
    Light: {
        "name": _text,
        "kind": _member(LightKind),
        "power": _numbers,
        "light_to_world": _array,
        "size": _numbers,
        "spot_angle": _number,
        "spot_blend": _number,
        "soft_falloff": _flag,
        "spread": _number,
        "visibility": _flags(RayVisibility),
    },
    World: {
        "radiance": _numbers,
        "environment": _integer,
        "world_to_environment": _numbers,
        "visibility": _flags(RayVisibility),
        "backdrop_radiance": _optional(_numbers),
        "backdrop_environment": _integer,
    },
    Camera: {
        "camera_to_world": _array,
        "window": _numbers,
        "clip": _numbers,
        "projection": _member(Projection),
        "aperture": _record_of(Aperture),
    },
    Aperture: {
        "radius": _number,
        "focus_distance": _number,
        "blades": _integer,
        "rotation": _number,
        "ratio": _number,
    },
    LightPaths: {
        "diffuse_bounces": _integer,
        "glossy_bounces": _integer,
        "transmission_bounces": _integer,
        "transparent_bounces": _integer,
        "reflective_caustics": _flag,
        "refractive_caustics": _flag,
        "clamp_direct": _number,
        "clamp_indirect": _number,
        "filter_glossy": _number,
    },
    RenderDefaults: {
        "width": _integer,
        "height": _integer,
        "frames_per_second": _number,
        "bounces": _integer,
        "exposure": _number,
        "light_paths": _record_of(LightPaths),
        "transparent_film": _flag,
    },
    Scene: {
        "meshes": _tuple_of(_row_of(Mesh)),
        "instances": _row_of(Instances),
        "materials": _tuple_of(_row_of(Material)),
        "camera": _row_of(Camera),
        "previous_camera": _row_of(Camera),
        "textures": _tuple_of(_row_of(Texture)),
        "lights": _tuple_of(_row_of(Light)),
        "world": _record_of(World),
        "frame": _integer,
        "cut": _flag,
        "name": _text,
        "defaults": _record_of(RenderDefaults),
        "warnings": _tuple_of(_text),
    },
}

# What a file may leave out.
_OPTIONAL = {
    kind: {f.name for f in fields(kind) if f.default is not MISSING or f.default_factory is not MISSING}
    for kind in SCHEMA
}
