# SPDX-License-Identifier: Apache-2.0
"""Writing a file whole or not at all, and saying in one sentence why a file cannot be used."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError

# errno -> what is wrong, the remedy.
_REASONS = {
    errno.ENOSPC: ("the disk is full.", "Free some space or choose another place."),
    errno.EDQUOT: ("the disk quota is used up.", "Free some space or choose another place."),
    errno.EFBIG: ("the file would be larger than the system allows.", "Raise the limit or choose another place."),
    errno.EACCES: ("permission denied.", "Choose another place or change its permissions."),
    errno.EPERM: ("permission denied.", "Choose another place or change its permissions."),
    errno.EROFS: ("the file system is read-only.", "Choose another place."),
    errno.ENOENT: ("there is no such file or folder.", "Check the path."),
    errno.ENOTDIR: ("a part of the path is a file, not a folder.", "Check the path."),
    errno.EEXIST: ("a file of that name is in the way.", "Choose another name."),
    errno.EISDIR: ("it is a folder.", "Name a file."),
    errno.ENAMETOOLONG: ("the name is too long.", "Choose a shorter one."),
}


def file_error(action: str, path: str | os.PathLike[str], error: OSError) -> InputError:
    """The sentence for an operating system's error; action: what failed, as in "write"."""
    reason, hint = _REASONS.get(error.errno or 0, (f"{error.strerror or error}.", "Check the path and the disk."))
    return InputError(f"Cannot {action} {os.fspath(path)}: {reason}", hint)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A file to write that takes the place of ``path`` when the block ends well.

    Until then it has a hidden name beside ``path``, and when the block raises (Ctrl-C included) it is removed, so that
    no reader ever sees half a file and an older one survives a failure. Raises InputError, naming ``path``.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "")
        try:
            with open(partial, "wb") as file:
                yield file
            os.replace(partial, path)
        except BaseException:
            with suppress(OSError):
                partial.unlink()
            raise
    except OSError as error:
        raise file_error("write", path, error) from error


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Creates a folder and its parents where they are missing. Raises InputError, naming ``path``."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise file_error("create the folder", path, error) from error
    return Path(path)
