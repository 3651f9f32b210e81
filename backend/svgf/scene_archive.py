# SPDX-License-Identifier: Apache-2.0
"""The zip archive of a scene file (see scene_file.py): opened and read as something that a stranger has sent."""

from __future__ import annotations

import ast
import json
import math
import os
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError
from .io.files import file_error
from .scene_schema import TABLES, Malformed

FORMAT = "svgf scene"
VERSION = 2
MANIFEST = "manifest.json"
EXPORT_AGAIN = "Export it again: svgf export FILE.blend -o FILE.svgf"

_DTYPES = {"|u1": np.uint8, "<i4": np.int32, "<f4": np.float32, "<f8": np.float64}
_NPY_MAGIC = b"\x93NUMPY\x01\x00"
# Limits on what a file may ask for. DEFLATE expands up to 1032 times; whole scenes compress far less than 200 times.
_LARGEST_MANIFEST = 256 << 20
_LARGEST_ENTRY_EXPANSION = 1032
_LARGEST_EXPANSION = 200
_FREE_EXPANSION = 4 << 30
# What zipfile and zlib raise for damaged archives, over all supported versions of Python.
_ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, KeyError, NotImplementedError, OverflowError, RuntimeError,
    ValueError, OSError,
)  # fmt: skip


class SceneArchive:
    """An open archive. Raises InputError where it is missing, damaged, out of proportion or too new."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._zip = self._open()
        self._entries = frozenset(self._zip.namelist())

    def close(self) -> None:
        self._zip.close()

    def read_manifest(self) -> tuple[dict[str, list[Any]], dict[int, tuple[str, Any]]]:
        """The records of each table; by frame number, the name of its field and its record. Of the current version."""
        if MANIFEST not in self._entries:
            raise InputError(f"{self.path} is not an svgf scene file: it has no {MANIFEST}.", EXPORT_AGAIN)
        if self._zip.getinfo(MANIFEST).file_size > _LARGEST_MANIFEST:
            raise self._damaged(f"{MANIFEST} is larger than {_LARGEST_MANIFEST >> 20} MiB")
        try:
            manifest = json.loads(self._read(MANIFEST), parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            raise self._damaged(f"{MANIFEST} is not valid JSON ({error})") from error
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise InputError(
                f"{self.path} is not an svgf scene file: its {MANIFEST} is of another format.", EXPORT_AGAIN
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
        if not isinstance(tables, dict) or not all(isinstance(tables.get(name), list) for name in TABLES):
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

    def read_array(self, field: str, digest: Any) -> np.ndarray:
        """Read-only. Raises Malformed, naming the field that asks for it."""
        if not isinstance(digest, str) or not re.fullmatch(r"[0-9a-f]{32}", digest):
            raise Malformed(field, "is not the digest of an array")
        entry = array_entry(digest)
        if entry not in self._entries:
            raise Malformed(field, f"needs {entry}, which is missing")
        return _parse_npy(field, self._read(entry))

    def _open(self) -> zipfile.ZipFile:
        try:
            with open(self.path, "rb") as file:
                size = os.fstat(file.fileno()).st_size
                is_zip = file.read(2) == b"PK"
        except OSError as error:
            raise file_error("read", self.path, error) from error
        if not is_zip:
            raise InputError(f"{self.path} is not an svgf scene file.", EXPORT_AGAIN)
        try:
            archive = zipfile.ZipFile(self.path)
        except _ZIP_ERRORS as error:
            raise self._damaged(str(error) or "its directory cannot be read") from error
        problem = find_bomb(archive.infolist(), size)
        if problem:
            archive.close()
            raise InputError(f"{self.path}: {problem}.", "Do not open it unless you trust where it comes from.")
        return archive

    def _read(self, entry: str) -> bytes:
        try:
            return self._zip.read(entry)
        except MemoryError as error:
            size = self._zip.getinfo(entry).file_size
            raise InputError(
                f"{self.path}: no memory for {entry}, which needs {size >> 20} MiB.", "Close other programs."
            ) from error
        except _ZIP_ERRORS as error:
            raise self._damaged(f"{entry} cannot be read ({error})") from error

    def _damaged(self, why: str) -> InputError:
        return InputError(f"{self.path} is truncated or damaged: {why.rstrip('.')}.", EXPORT_AGAIN)


def array_entry(digest: str) -> str:
    """The name of an array's entry."""
    return f"arrays/{digest}.npy"


def find_bomb(entries: list[zipfile.ZipInfo], size: int) -> str:
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
        raise Malformed(field, "is not an array that svgf reads") from None
    if len(shape) > 4 or math.prod(shape) * dtype.itemsize != len(data) - 10 - length:
        raise Malformed(field, f"is declared as {dtype} {list(shape)[:8]}, which is not what its entry holds")
    return np.frombuffer(data, dtype, offset=10 + length).reshape(shape)


def _upgrade_material(record: Any) -> None:
    """From version 1, in place. What is odd is left for the decoder to find."""
    texture = record.pop("base_color_texture", -1) if isinstance(record, dict) else -1
    if texture != -1:
        record["maps"] = {"base_color": {"texture": texture}}


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number")
