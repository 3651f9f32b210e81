# SPDX-License-Identifier: Apache-2.0
"""``svgf extension``: the zip that Blender installs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def extension(
    source: Annotated[Path, typer.Argument(help="A wheel of svgf, or a checkout to build one of.")] = Path("."),
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the zip.")] = Path("dist"),
) -> None:
    """Make the extension for Blender's versions that run the wheel's Python. A file of the same name is replaced."""
    from ..extension import build_extension

    path = build_extension(source, output)
    typer.echo(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
