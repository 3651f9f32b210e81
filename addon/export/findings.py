# SPDX-License-Identifier: GPL-3.0-or-later
"""What an export finds that svgf does not simulate: a sentence for each thing, naming the data-blocks that have it."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

_NAMES_SHOWN = 3


@dataclass(frozen=True)
class Finding:
    """id_type: Blender's, of the data-blocks with these names. text: what is not simulated and what is done instead."""

    id_type: str
    names: tuple[str, ...]
    text: str

    @property
    def sentence(self) -> str:
        """Such as ``Material "Wall", "Floor": normal maps are not supported yet; ...``."""
        kind = self.id_type.replace("_", " ").capitalize()
        return f"{kind} {_enumerate(self.names)}: {self.text}"


class Findings:
    """Collects findings in the order in which they are met, and says each of them once."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, str], dict[str, None]] = {}

    def add(self, datablock: bpy.types.ID, text: str) -> None:
        """text: what is not simulated and what is done instead, ending in a full stop."""
        self._names.setdefault((datablock.id_type, text), {})[datablock.name] = None

    def found(self) -> tuple[Finding, ...]:
        return tuple(Finding(id_type, tuple(names), text) for (id_type, text), names in self._names.items())

    def extend(self, other: Findings) -> None:
        """Adds all that another one has collected."""
        for key, names in other._names.items():
            self._names.setdefault(key, {}).update(names)

    def sentences(self) -> tuple[str, ...]:
        return tuple(finding.sentence for finding in self.found())


def _enumerate(names: tuple[str, ...]) -> str:
    shown = ", ".join(f'"{name}"' for name in names[:_NAMES_SHOWN])
    return shown if len(names) <= _NAMES_SHOWN else f"{shown} and {len(names) - _NAMES_SHOWN} more"
