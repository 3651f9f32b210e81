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

import os
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from .errors import InputError
from .frame_range import format_frames
from .io.files import replacing
from .scene import Scene
from .scene_archive import EXPORT_AGAIN, SceneArchive
from .scene_schema import TABLE_OF, Malformed, decode
from .scene_validation import SceneValidator, shown
from .scene_writer import SceneWriter


def save(path: str | os.PathLike[str], scenes: Scene | Iterable[Scene]) -> None:
    """Writes the frames of an animation, or one scene, whole or not at all.

    scenes are taken one by one and not kept, so that a generator of any length will do. Raises InputError where a scene
    is not valid, two have the same frame number, there is none, or the file cannot be written.
    """
    frames = (scenes,) if isinstance(scenes, Scene) else scenes
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        writer = SceneWriter(archive, os.fspath(path))
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
        self._last: Scene | None = None
        self._archive = SceneArchive(self.path)
        try:
            tables, self._frames = self._archive.read_manifest()
        except BaseException:
            self.close()
            raise
        self._objects = _SharedObjects(self._archive, tables)

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
            scene = decode(Scene, self._objects, field, record)
        except Malformed as malformed:
            raise InputError(f"{self.path}: {malformed}", EXPORT_AGAIN) from None
        warnings = self._validator.check(scene)
        # A dict keeps the order and drops what the file says already.
        scene = replace(scene, warnings=tuple(dict.fromkeys(scene.warnings + warnings)))
        self._last = scene
        return scene

    def close(self) -> None:
        """Scenes that were read stay whole; no other can be read."""
        self._archive.close()

    def __iter__(self) -> Iterator[Scene]:
        return map(self.scene, self._frames)

    def __len__(self) -> int:
        return len(self._frames)

    def __enter__(self) -> SceneFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _SharedObjects:
    """The arrays and objects of a file, each made once for as long as somebody holds it."""

    def __init__(self, archive: SceneArchive, tables: dict[str, list[Any]]) -> None:
        self._archive = archive
        self._tables = tables
        self._arrays: WeakValueDictionary[str, np.ndarray] = WeakValueDictionary()
        self._objects: WeakValueDictionary[tuple[str, int], Any] = WeakValueDictionary()

    def array(self, field: str, digest: Any) -> np.ndarray:
        array = self._arrays.get(digest) if isinstance(digest, str) else None
        if array is None:
            array = self._archive.read_array(field, digest)
            self._arrays[digest] = array
        return array

    def object(self, kind: type, field: str, row: Any) -> Any:
        table = TABLE_OF[kind]
        records = self._tables[table]
        if type(row) is not int or not 0 <= row < len(records):
            raise Malformed(field, f"names {table}[{shown(row)}], but there are {len(records)}")
        found = self._objects.get((table, row))
        if found is None:
            found = decode(kind, self, f"{table}[{row}]", records[row])
            self._objects[table, row] = found
        return found
