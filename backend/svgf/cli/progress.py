# SPDX-License-Identifier: Apache-2.0
"""What a command shows while it works, on standard error."""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from ..frame import Frame
    from ..renderer import Renderer
    from ..scene import Scene
    from ..settings import Settings

_Result = TypeVar("_Result")


class Bar:
    """One progress bar that counts ``total`` steps and parts of them."""

    def __init__(self, progress: Progress, title: str, total: int | None) -> None:
        self._progress = progress
        self._task = progress.add_task(title, total=total)
        self._done = 0

    def part(self, share: float) -> None:
        """The current step is done to this share, in [0, 1]."""
        self._progress.update(self._task, completed=self._done + share)

    def step(self) -> None:
        self._done += 1
        self._progress.update(self._task, completed=self._done)

    def report(self, done: int, total: int) -> None:
        """Where the work counts its steps itself."""
        self._done = done
        self._progress.update(self._task, completed=done, total=total)

    def message(self, text: str) -> None:
        """A line that stays."""
        self._progress.console.print(text, highlight=False, markup=False, soft_wrap=True)


@contextmanager
def progress_bar(title: str, total: int | None) -> Iterator[Bar]:
    """A bar on standard error while the block runs; nothing where standard error is not a terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        yield Bar(progress, title, total)


def render_frame(renderer: Renderer, scene: Scene, progress: Callable[[float], None] | None = None) -> Frame:
    """``Renderer.render``, stopped by Ctrl-C."""
    return run_interruptibly(lambda: renderer.render(scene, progress=progress), renderer.interrupt)


def render_variants(renderer: Renderer, scene: Scene, variants: Sequence[Settings]) -> list[Frame]:
    """``Renderer.render_variants``, stopped by Ctrl-C."""
    return run_interruptibly(lambda: renderer.render_variants(scene, variants), renderer.interrupt)


def run_interruptibly(work: Callable[[], _Result], interrupt: Callable[[], None]) -> _Result:
    """Runs on a thread of its own, so that Ctrl-C is heard while native code runs; ``interrupt`` then stops it."""
    outcome: list[_Result] = []
    failure: list[BaseException] = []
    finished = threading.Event()

    def run() -> None:
        try:
            outcome.append(work())
        except BaseException as error:
            failure.append(error)
        finished.set()

    # The event is waited for, not the thread: before Python 3.13 a Thread.join that Ctrl-C interrupts takes the thread
    # for dead. The wait has a timeout because Windows delivers no Ctrl-C to one without.
    threading.Thread(target=run, name="svgf").start()
    try:
        while not finished.wait(0.2):
            pass
    except KeyboardInterrupt:
        # Again and again, as an interrupt that comes before the first stage has started is forgotten.
        interrupt()
        while not finished.wait(0.05):
            interrupt()
        raise
    if failure:
        raise failure[0]
    return outcome[0]


@contextmanager
def silence(*descriptors: int) -> Iterator[None]:
    """Drops what libraries print on their own, while the block runs: Python's output and these file descriptors.

    Blender reports on standard output what it reads, OpenEXR on both what is damaged; results stay alone on standard
    output, and an error is one sentence.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    saved = [(number, os.dup(number)) for number in descriptors]
    try:
        with redirect_stdout(io.StringIO()):
            for number, _ in saved:
                os.dup2(nowhere, number)
            yield
    finally:
        for number, copy in saved:
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
