# SPDX-License-Identifier: Apache-2.0
"""Scene files, ``.svgf``: frames of a scene that render anywhere, without Blender, bit for bit the same.

A file is a zip archive:

- ``arrays/DIGEST.npy``: every array once, in numpy's format 1.0, C order, little endian. DIGEST is the BLAKE2b-128 of
  the entry, so frames share the arrays that are equal.
- ``manifest.json``: ``{"format": "svgf scene", "version": 2, "tables": {...}, "frames": [...]}``. A table lists the
  distinct objects of one kind as records of their fields, arrays given by digest; a frame names its objects by row.

Files of older versions are read: fields that they lack take their defaults. Version 1 had one texture in a material,
of its base colour.

Equal scenes give equal bytes: there is no date, user or machine in a file. Nothing in it is ever executed (no pickle),
and everything is checked, before it is written and after it is read: files are edited, cut off and sent by strangers.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import math
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import MISSING, fields, is_dataclass, replace
from enum import Enum, IntFlag
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from .errors import InputError
from .frame_range import format_frames
from .io.files import file_error, replacing
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
from .scene_validation import SceneValidator, shown

FORMAT = "svgf scene"
VERSION = 2

_MANIFEST = "manifest.json"
_TABLES: dict[str, type] = {
    "meshes": Mesh,
    "instances": Instances,
    "materials": Material,
    "textures": Texture,
    "lights": Light,
    "cameras": Camera,
}
_TABLE_OF = {kind: table for table, kind in _TABLES.items()}
_DTYPES = {"|u1": np.uint8, "<i4": np.int32, "<f4": np.float32, "<f8": np.float64}
_NPY_MAGIC = b"\x93NUMPY\x01\x00"
# Limits on what a file may ask for. DEFLATE expands up to 1032 times; whole scenes compress far less than 200 times.
_LARGEST_MANIFEST = 256 << 20
_LARGEST_ENTRY_EXPANSION = 1032
_LARGEST_EXPANSION = 200
_FREE_EXPANSION = 4 << 30
_EXPORT_AGAIN = "Export it again: svgf export FILE.blend -o FILE.svgf"
# What zipfile and zlib raise for damaged archives, over all supported versions of Python.
_ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, KeyError, NotImplementedError, OverflowError, RuntimeError,
    ValueError, OSError,
)  # fmt: skip


def save(path: str | os.PathLike[str], scenes: Scene | Iterable[Scene]) -> None:
    """Writes the frames of an animation, or one scene, whole or not at all.

    scenes are taken one by one and not kept, so that a generator of any length will do. Raises InputError where a scene
    is not valid, two have the same frame number, there is none, or the file cannot be written.
    """
    frames = (scenes,) if isinstance(scenes, Scene) else scenes
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        writer = _Writer(archive, os.fspath(path))
        for scene in frames:
            writer.add(scene)
        writer.finish()


def load(path: str | os.PathLike[str], frame: int | None = None) -> Scene:
    """One frame of a file, the first unless said. Raises InputError as SceneFile does."""
    with SceneFile(path) as file:
        return file.scene(file.frames[0] if frame is None else frame)


class SceneFile:
    """An .svgf file, read frame by frame; a context manager, and iterable over its scenes in the file's order.

    Objects that are equal in two frames are one object (``is``) as long as the first of the two scenes is alive, or was
    the last one read. Arrays are read-only.
    Raises InputError, naming the file and the field, for a file that is missing, damaged, not valid or too new.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._validator = SceneValidator(str(self.path))
        self._objects: WeakValueDictionary[tuple[str, int], Any] = WeakValueDictionary()
        self._arrays: WeakValueDictionary[str, np.ndarray] = WeakValueDictionary()
        self._last: Scene | None = None
        self._archive = self._open()
        self._entries = frozenset(self._archive.namelist())
        try:
            self._tables, self._frames = self._read_manifest()
        except BaseException:
            self.close()
            raise

    @property
    def frames(self) -> tuple[int, ...]:
        """The numbers of the frames, in the file's order."""
        return tuple(self._frames)

    def scene(self, frame: int) -> Scene:
        """Reads one frame. Raises InputError for a frame that the file does not hold, or whose data is not valid."""
        if frame not in self._frames:
            raise InputError(f"{self.path} has no frame {frame}.", f"It holds {format_frames(self._frames)}.")
        field, record = self._frames[frame]
        try:
            scene = Scene(**self._decode(Scene, field, record))
        except _Malformed as malformed:
            raise InputError(f"{self.path}: {malformed}", _EXPORT_AGAIN) from None
        warnings = self._validator.check(scene)
        # A dict keeps the order and drops what the file says already.
        scene = replace(scene, warnings=tuple(dict.fromkeys(scene.warnings + warnings)))
        self._last = scene
        return scene

    def close(self) -> None:
        self._archive.close()

    def __iter__(self) -> Iterator[Scene]:
        return map(self.scene, self._frames)

    def __len__(self) -> int:
        return len(self._frames)

    def __enter__(self) -> SceneFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> zipfile.ZipFile:
        try:
            with open(self.path, "rb") as file:
                size = os.fstat(file.fileno()).st_size
                is_zip = file.read(2) == b"PK"
        except OSError as error:
            raise file_error("read", self.path, error) from error
        if not is_zip:
            raise InputError(f"{self.path} is not an svgf scene file.", _EXPORT_AGAIN)
        try:
            archive = zipfile.ZipFile(self.path)
        except _ZIP_ERRORS as error:
            raise self._damaged(str(error) or "its directory cannot be read") from error
        problem = _find_bomb(archive.infolist(), size)
        if problem:
            archive.close()
            raise InputError(f"{self.path}: {problem}.", "Do not open it unless you trust where it comes from.")
        return archive

    def _read_manifest(self) -> tuple[dict[str, list[Any]], dict[int, tuple[str, Any]]]:
        if _MANIFEST not in self._entries:
            raise InputError(f"{self.path} is not an svgf scene file: it has no {_MANIFEST}.", _EXPORT_AGAIN)
        if self._archive.getinfo(_MANIFEST).file_size > _LARGEST_MANIFEST:
            raise self._damaged(f"{_MANIFEST} is larger than {_LARGEST_MANIFEST >> 20} MiB")
        try:
            manifest = json.loads(self._read(_MANIFEST), parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            raise self._damaged(f"{_MANIFEST} is not valid JSON ({error})") from error
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise InputError(
                f"{self.path} is not an svgf scene file: its {_MANIFEST} is of another format.", _EXPORT_AGAIN
            )
        version = manifest.get("version")
        if type(version) is int and version > VERSION:
            raise InputError(
                f"{self.path} has format version {version}; this svgf reads up to {VERSION}.",
                "Update it: pip install --upgrade svgf",
            )
        if type(version) is not int or version < 1:
            raise self._damaged(f"version is {version!r}")

        tables = manifest.get("tables")
        if not isinstance(tables, dict) or not all(isinstance(tables.get(name), list) for name in _TABLES):
            raise self._damaged("tables is incomplete")
        if version < 2:
            for record in tables["materials"]:
                _upgrade_material(record)
        records = manifest.get("frames")
        if not isinstance(records, list) or not records:
            raise self._damaged("frames is empty")
        frames: dict[int, tuple[str, Any]] = {}
        for row, record in enumerate(records):
            number = record.get("frame") if isinstance(record, dict) else None
            if type(number) is not int or number in frames:
                raise self._damaged(f"frames[{row}].frame is not a number of its own")
            frames[number] = (f"frames[{row}]", record)
        return tables, frames

    def _decode(self, kind: type, field: str, record: Any) -> dict[str, Any]:
        """The fields of a dataclass from its record."""
        if not isinstance(record, dict):
            raise _Malformed(field, "is not a record")
        decoders = _SCHEMA[kind]
        odd = sorted((record.keys() ^ decoders.keys()) - (_OPTIONAL[kind] - record.keys()))
        if odd:
            raise _Malformed(f"{field}.{odd[0]}", "is missing" if odd[0] in decoders else "is not a known field")
        return {
            name: decode(self, f"{field}.{name}", record[name]) for name, decode in decoders.items() if name in record
        }

    def _object(self, table: str, field: str, row: Any) -> Any:
        records = self._tables[table]
        if type(row) is not int or not 0 <= row < len(records):
            raise _Malformed(field, f"names {table}[{shown(row)}], but there are {len(records)}")
        found = self._objects.get((table, row))
        if found is None:
            kind = _TABLES[table]
            found = kind(**self._decode(kind, f"{table}[{row}]", records[row]))
            self._objects[table, row] = found
        return found

    def _array(self, field: str, digest: Any) -> np.ndarray:
        if not isinstance(digest, str) or not re.fullmatch(r"[0-9a-f]{32}", digest):
            raise _Malformed(field, "is not the digest of an array")
        array = self._arrays.get(digest)
        if array is None:
            entry = f"arrays/{digest}.npy"
            if entry not in self._entries:
                raise _Malformed(field, f"needs {entry}, which is missing")
            array = _parse_npy(field, self._read(entry))
            self._arrays[digest] = array
        return array

    def _read(self, entry: str) -> bytes:
        try:
            return self._archive.read(entry)
        except MemoryError as error:
            size = self._archive.getinfo(entry).file_size
            raise InputError(
                f"{self.path}: no memory for {entry}, which needs {size >> 20} MiB.", "Close other programs."
            ) from error
        except _ZIP_ERRORS as error:
            raise self._damaged(f"{entry} cannot be read ({error})") from error

    def _damaged(self, why: str) -> InputError:
        return InputError(f"{self.path} is truncated or damaged: {why.rstrip('.')}.", _EXPORT_AGAIN)


class _Malformed(Exception):
    def __init__(self, field: str, problem: str) -> None:
        super().__init__(f"{field} {problem}.")


def _find_bomb(entries: list[zipfile.ZipInfo], size: int) -> str:
    """What about the declared sizes of an archive's entries is out of proportion, or an empty string."""
    for entry in entries:
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            return f"{entry.filename} is compressed in a way that svgf does not read"
        if entry.file_size > _LARGEST_ENTRY_EXPANSION * entry.compress_size + 64:
            return f"{entry.filename} claims to hold more than it can"
    if sum(entry.compress_size for entry in entries) > size:
        return "its entries overlap"
    if sum(entry.file_size for entry in entries) > max(_FREE_EXPANSION, _LARGEST_EXPANSION * size):
        return f"it would expand more than {_LARGEST_EXPANSION} times"
    return ""


def _parse_npy(field: str, data: bytes) -> np.ndarray:
    """Strict where numpy.load is lenient: four plain dtypes, C order, and exactly as many bytes as the shape needs."""
    length = int.from_bytes(data[8:10], "little")
    try:
        if data[:8] != _NPY_MAGIC:
            raise ValueError
        header = ast.literal_eval(data[10 : 10 + length].decode("ascii").strip())
        dtype, shape = np.dtype(_DTYPES[header["descr"]]), header["shape"]
        if header["fortran_order"] is not False or not all(type(side) is int and side >= 0 for side in shape):
            raise ValueError
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError):
        raise _Malformed(field, "is not an array that svgf reads") from None
    if len(shape) > 4 or math.prod(shape) * dtype.itemsize != len(data) - 10 - length:
        raise _Malformed(field, f"is declared as {dtype} {list(shape)[:8]}, which is not what its entry holds")
    return np.frombuffer(data, dtype, offset=10 + length).reshape(shape)


_Decoder = Callable[[SceneFile, str, Any], Any]


def _plain(*kinds: type) -> _Decoder:
    def decode(file: SceneFile, field: str, value: Any) -> Any:
        if type(value) not in kinds:
            raise _Malformed(field, f"is {shown(value)}, not of type {kinds[0].__name__}")
        try:
            return kinds[0](value)
        except OverflowError:
            raise _Malformed(field, "is not a finite number") from None

    return decode


def _tuple_of(decode_item: _Decoder) -> _Decoder:
    def decode(file: SceneFile, field: str, values: Any) -> Any:
        if not isinstance(values, list):
            raise _Malformed(field, f"is {shown(values)}, not a list")
        return tuple(decode_item(file, f"{field}[{index}]", value) for index, value in enumerate(values))

    return decode


def _optional(decode_value: _Decoder) -> _Decoder:
    return lambda file, field, value: None if value is None else decode_value(file, field, value)


def _member(kind: type[Enum]) -> _Decoder:
    names = {member.name: member for member in kind}

    def decode(file: SceneFile, field: str, value: Any) -> Enum:
        if not isinstance(value, str) or value not in names:
            raise _Malformed(field, f"is {shown(value)}, not one of {', '.join(names)}")
        return names[value]

    return decode


def _flags(kind: type[IntFlag]) -> _Decoder:
    def decode(file: SceneFile, field: str, value: Any) -> IntFlag:
        if type(value) is not int or not 0 <= value <= sum(kind):
            raise _Malformed(field, f"is {shown(value)}, not a set of flags")
        return kind(value)

    return decode


def _row_of(kind: type) -> _Decoder:
    return lambda file, field, row: file._object(_TABLE_OF[kind], field, row)


def _record_of(kind: type) -> _Decoder:
    return lambda file, field, record: kind(**file._decode(kind, field, record))


def _dict_of(decode_value: _Decoder) -> _Decoder:
    def decode(file: SceneFile, field: str, values: Any) -> Any:
        if not isinstance(values, dict):
            raise _Malformed(field, f"is {shown(values)}, not a record")
        return {name: decode_value(file, f"{field}[{name}]", value) for name, value in values.items()}

    return decode


def _upgrade_material(record: Any) -> None:
    """From version 1, in place. What is odd is left for the decoder to find."""
    texture = record.pop("base_color_texture", -1) if isinstance(record, dict) else -1
    if texture != -1:
        record["maps"] = {"base_color": {"texture": texture}}


_text, _flag, _integer, _number = _plain(str), _plain(bool), _plain(int), _plain(float, int)
_numbers = _tuple_of(_number)
_array: _Decoder = SceneFile._array

# How each field of each record is read; a test holds this to the dataclasses. Writing needs no schema.
_SCHEMA: dict[type, dict[str, _Decoder]] = {
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
        "visibility": _optional(_array),
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
    for kind in _SCHEMA
}


class _Writer:
    """Collects the manifest while arrays go to the archive as they come."""

    def __init__(self, archive: zipfile.ZipFile, source: str) -> None:
        self._archive = archive
        self._validator = SceneValidator(source)
        self._source = source
        self._rows: dict[str, dict[str, int]] = {name: {} for name in _TABLES}
        self._frames: dict[int, dict[str, Any]] = {}
        self._entries: set[str] = set()
        # Digests of the arrays of this and the last frame by identity; holding the arrays keeps their ids theirs.
        self._digests: dict[int, tuple[np.ndarray, str]] = {}
        self._last_digests: dict[int, tuple[np.ndarray, str]] = {}

    def add(self, scene: Scene) -> None:
        warnings = self._validator.check(scene)
        if scene.frame in self._frames:
            raise InputError(
                f"{self._source}: frame {scene.frame} comes twice.", "Give every scene its own frame number."
            )
        self._last_digests, self._digests = self._digests, {}
        warned = replace(scene, warnings=tuple(dict.fromkeys(scene.warnings + warnings)))
        self._frames[scene.frame] = self._record(warned)

    def finish(self) -> None:
        if not self._frames:
            raise InputError(f"{self._source}: there is no frame to save.", "Choose frames that the scene has.")
        manifest = {
            "format": FORMAT,
            "version": VERSION,
            "tables": {name: [json.loads(record) for record in rows] for name, rows in self._rows.items()},
            "frames": list(self._frames.values()),
        }
        self._write(_MANIFEST, _json(manifest).encode("ascii"))
        if problem := _find_bomb(self._archive.infolist(), self._archive.fp.tell()):
            raise InputError(f"{self._source} could not be read again: {problem}.", "Save fewer frames in one file.")

    def _record(self, value: Any) -> dict[str, Any]:
        return {field.name: self._encode(getattr(value, field.name)) for field in fields(value)}

    def _encode(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return self._add_array(value)
        if isinstance(value, tuple):
            return [self._encode(item) for item in value]
        if isinstance(value, dict):
            return {name: self._encode(value[name]) for name in sorted(value)}
        if isinstance(value, IntFlag):
            return int(value)
        if isinstance(value, Enum):
            return value.name
        if is_dataclass(value):
            table = _TABLE_OF.get(type(value))
            record = self._record(value)
            if table is None:
                return record
            return self._rows[table].setdefault(_json(record), len(self._rows[table]))
        # numpy's scalars are numbers to the validator, but not to JSON.
        return value.item() if isinstance(value, np.generic) else value

    def _add_array(self, array: np.ndarray) -> str:
        known = self._digests.get(id(array)) or self._last_digests.get(id(array))
        if known is None:
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)
            data = buffer.getvalue()
            digest = hashlib.blake2b(data, digest_size=16).hexdigest()
            if digest not in self._entries:
                self._entries.add(digest)
                self._write(f"arrays/{digest}.npy", data)
            known = (array, digest)
        self._digests[id(array)] = known
        return known[1]

    def _write(self, name: str, data: bytes) -> None:
        entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
        entry.create_system = 3
        entry.external_attr = 0o644 << 16
        self._archive.writestr(entry, data, zipfile.ZIP_DEFLATED, 6)


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number")
