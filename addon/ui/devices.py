# SPDX-License-Identifier: GPL-3.0-or-later
"""Why the GPU does not render. Found in the background, once: a driver takes longer to answer than a panel may."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import bpy
from svgf.devices import available_devices

from ..installation import write
from .panels import EnginePanel

_reason: Future[str] | None = None


def find_reason() -> Future[str]:
    """Of the "cuda" device, as svgf.available_devices gives it: empty where it can be used."""
    global _reason
    if _reason is None:
        thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="svgf-devices")
        _reason = thread.submit(lambda: next(info.reason for info in available_devices() if info.name == "cuda"))
        thread.shutdown(wait=False)
    return _reason


class SVGF_PT_no_gpu(EnginePanel, bpy.types.Panel):
    bl_label = "No GPU"
    bl_parent_id = "SVGF_PT_sampling"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context) or context.scene.svgf.device not in {"auto", "cuda"}:
            return False
        reason = find_reason()
        return reason.done() and bool(reason.result())

    def draw(self, context: bpy.types.Context) -> None:
        instead = "" if context.scene.svgf.device == "cuda" else " The CPU renders."
        write(self.layout, find_reason().result() + instead, "INFO")


def register() -> None:
    bpy.utils.register_class(SVGF_PT_no_gpu)


def unregister() -> None:
    bpy.utils.unregister_class(SVGF_PT_no_gpu)
