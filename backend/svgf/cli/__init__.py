# SPDX-License-Identifier: Apache-2.0
"""The command ``svgf``: one module a command.

Results go to standard output, progress and messages to standard error. Exit codes: 0 done, 2 the input cannot be used
(standard error says what is wrong and what to do), 130 stopped with Ctrl-C. Files are written whole or not at all.
"""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from ..errors import Error
from ..io.files import file_error
from . import bench, compare, demo, denoise, doctor, export, extension, render

__all__ = ["app", "main"]


class _Commands(TyperGroup):
    """Turns what can go wrong with the input into one sentence and an exit code, the same for every command."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except Error as error:
            message = str(error)
        except BrokenPipeError:  # the reader of the output went away; typer ends quietly
            raise
        except OSError as error:
            message = str(file_error("use", error.filename or "a file", error))
        except MemoryError:
            message = "There is not enough memory. Choose a smaller --size or a smaller scene."
        except KeyboardInterrupt:
            typer.echo("Stopped.", err=True)
            raise typer.Exit(130) from None
        typer.echo(f"Error: {message}", err=True)
        raise typer.Exit(2)


app = typer.Typer(
    name="svgf",
    cls=_Commands,
    help="Real-time path tracing for Blender: one sample per pixel, denoised over space and time.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command("demo")(demo.demo)
app.command("render")(render.render)
app.command("denoise")(denoise.denoise)
app.command("export")(export.export)
app.command("extension")(extension.extension)
app.command("compare")(compare.compare)
app.add_typer(bench.app, name="bench")
app.command("doctor")(doctor.doctor)


def _print_version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        typer.echo(f"svgf {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Show the version."),
) -> None:
    """Real-time path tracing for Blender: one sample per pixel, denoised over space and time."""


def main() -> None:
    app(prog_name="svgf")
