# SPDX-License-Identifier: Apache-2.0
"""Everything that svgf raises on purpose: one sentence that names the thing, and a hint that says what to do."""

from __future__ import annotations


class Error(Exception):
    """message: what is wrong, naming the thing. hint: the remedy, a sentence of its own."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(f"{message} {hint}".strip())
        self.message = message
        self.hint = hint


class InputError(Error):
    """A file, an argument or an array cannot be used as it is."""


class DeviceError(Error):
    """A device cannot be opened, or failed. stage: the stage that ran, empty outside of one."""

    def __init__(self, message: str, hint: str = "", stage: str = "") -> None:
        super().__init__(message, hint)
        self.stage = stage


class OutOfMemory(DeviceError):
    """The device has no room for a buffer."""


class Interrupted(Error):
    """``Device.interrupt`` stopped a stage."""
