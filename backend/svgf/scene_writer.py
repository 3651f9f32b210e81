# SPDX-License-Identifier: Apache-2.0
"""Writing a scene file: see scene_file.py for the format."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import fields, is_dataclass, replace
from enum import Enum, IntFlag
from typing import Any

import numpy as np

from .errors import InputError
from .scene import Scene
from .scene_archive import FORMAT, MANIFEST, VERSION, array_entry, find_bomb
from .scene_schema import TABLE_OF, TABLES
from .scene_validation import SceneValidator


class SceneWriter:
    """Collects the manifest while arrays go to the archive as they come."""

    def __init__(self, archive: zipfile.ZipFile, source: str) -> None:
        self._archive = archive
        self._validator = SceneValidator(source)
        self._source = source
        self._rows: dict[str, dict[str, int]] = {name: {} for name in TABLES}
        self._frames: dict[int, dict[str, Any]] = {}
        self._entries: set[str] = set()
        # Digests of the arrays of this and the last frame by identity; holding the arrays keeps their ids theirs.
        self._digests: dict[int, tuple[np.ndarray, str]] = {}
        self._last_digests: dict[int, tuple[np.ndarray, str]] = {}

    def add(self, scene: Scene) -> None:
        """Raises InputError where the scene is not valid, or there is one with its frame number."""
        warnings = self._validator.check(scene)
        if scene.frame in self._frames:
            raise InputError(
                f"{self._source}: frame {scene.frame} comes twice.", "Give every scene its own frame number."
            )
        self._last_digests, self._digests = self._digests, {}
        warned = replace(scene, warnings=tuple(dict.fromkeys(scene.warnings + warnings)))
        self._frames[scene.frame] = self._record(warned)

    def finish(self) -> None:
        """Writes the manifest. Raises InputError where there is no frame, or the file could not be read again."""
        if not self._frames:
            raise InputError(f"{self._source}: there is no frame to save.", "Choose frames that the scene has.")
        manifest = {
            "format": FORMAT,
            "version": VERSION,
            "tables": {name: [json.loads(record) for record in rows] for name, rows in self._rows.items()},
            "frames": list(self._frames.values()),
        }
        self._write(MANIFEST, _json(manifest).encode("ascii"))
        if problem := find_bomb(self._archive.infolist(), self._archive.fp.tell()):
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
            table = TABLE_OF.get(type(value))
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
                self._write(array_entry(digest), data)
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
