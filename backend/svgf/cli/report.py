# SPDX-License-Identifier: Apache-2.0
"""How a benchmark hands over its figures: tables, JSON, CSV, a plot."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from ..io.files import replacing

CsvOption = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures to a file, too.")]
PlotOption = Annotated[Path | None, typer.Option("--plot", metavar="FILE", help="Draw them as a PNG, too.")]

_WIDTH = 110  # also in a file or a narrow window: figures are not cut


def publish(
    title: str,
    rows: Sequence[Any],
    *tables: Table | str,
    as_json: bool = False,
    csv_file: Path | None = None,
    plot_file: Path | None = None,
    plot: Callable[[Sequence[Any], str], bytes] | None = None,
    **more: Any,
) -> None:
    """Writes the files that were asked for, then prints the title, the tables and sentences, or as JSON the title, the
    rows and ``more``.

    rows: instances of one dataclass. plot: makes a PNG of rows and title. Raises InputError where a file cannot be
    written.
    """
    write_files(title, rows, csv_file, plot_file, plot)
    if as_json:
        print_json(title, rows, **more)
    else:
        show(title, *tables)


def write_files(
    title: str,
    rows: Sequence[Any],
    csv_file: Path | None,
    plot_file: Path | None,
    plot: Callable[[Sequence[Any], str], bytes] | None,
) -> None:
    """As ``publish`` says."""
    if csv_file is not None:
        with replacing(csv_file) as file:
            file.write(_csv(rows).encode())
    if plot_file is not None and plot is not None:
        with replacing(plot_file) as file:
            file.write(plot(rows, title))


def print_json(title: str, rows: Sequence[Any], **more: Any) -> None:
    typer.echo(json.dumps({"title": title, "rows": [asdict(row) for row in rows], **more}, indent=1))


def show(*parts: Table | str) -> None:
    """Prints tables and sentences, at once."""
    console = Console(highlight=False, width=_WIDTH)
    for part in parts:
        console.print(part, markup=False, soft_wrap=isinstance(part, str))


def table(
    headings: Sequence[str],
    lines: Iterable[Sequence[str]],
    names: int = 1,
    section: Callable[[Sequence[str]], object] = lambda line: None,
) -> Table:
    """names: how many columns at the left are text. section: lines for which it differs are parted."""
    result = Table()
    for index, heading in enumerate(headings):
        result.add_column(heading, justify="left" if index < names else "right", no_wrap=True)
    last = None
    for line in lines:
        if last is not None and section(line) != section(last):
            result.add_section()
        result.add_row(*line)
        last = line
    return result


def _csv(rows: Sequence[Any]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(rows[0])], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return text.getvalue()
