# SPDX-License-Identifier: Apache-2.0
"""The passes of Cycles that the denoiser reads: their names in Blender's files, and where to enable them in Blender."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Pass:
    """name: since Blender 5.0. older: up to 4.5, where it differs. channels: suffixes that it must have, in order.
    place: in Blender's View Layer properties, below Passes."""

    name: str
    channels: str
    place: str
    older: str = ""


# The lobes whose light Cycles writes as Color x (Direct + Indirect).
LOBES = ("Diffuse", "Glossy", "Transmission")

_OLDER_LOBES = {"Diffuse": "Diff", "Glossy": "Gloss", "Transmission": "Trans"}
_OLDER_PARTS = {"Direct": "Dir", "Indirect": "Ind", "Color": "Col"}

PASSES = {
    entry.name: entry
    for entry in (
        Pass("Combined", "RGB", "Data > Combined"),
        Pass("Depth", "Z", "Data > Z"),
        Pass("Normal", "XYZ", "Data > Normal"),
        # Cycles draws motion blur or writes vectors, not both.
        Pass("Vector", "XY", "Data > Vector (and switch Motion Blur off)"),
        Pass("Object Index", "X", "Data > Object Index", older="IndexOB"),
        Pass("Denoising Albedo", "RGB", "Data > Denoising Data"),
        Pass("Denoising Normal", "XYZ", "Data > Denoising Data"),
        Pass("Emission", "RGB", "Light > Emission", older="Emit"),
        Pass("Environment", "RGB", "Light > Environment", older="Env"),
        *(
            Pass(f"{lobe} {part}", "RGB", f"Light > {lobe} > {part}", older=_OLDER_LOBES[lobe] + _OLDER_PARTS[part])
            for lobe in LOBES
            for part in _OLDER_PARTS
        ),
    )
}
LIGHT_PASSES = tuple(f"{lobe} {part}" for lobe in LOBES for part in _OLDER_PARTS)

_TODAYS_NAMES = {entry.older: entry.name for entry in PASSES.values() if entry.older}


def todays_name(name: str) -> str:
    """What Blender 5 calls a pass; names that it never changed, and those of others, stay."""
    return _TODAYS_NAMES.get(name, name)
