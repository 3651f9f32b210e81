# SPDX-License-Identifier: Apache-2.0
"""Blender as a module, empty before each test. bpy is one global: nothing of a test may outlive it."""

from __future__ import annotations

import pytest

bpy = pytest.importorskip("bpy", reason="bpy is not installed: pip install svgf[blender]")


@pytest.fixture(autouse=True)
def empty_blender():
    """No objects, default settings, a camera at (0, -10, 0) that looks along +Y."""
    import blend

    bpy.ops.wm.read_factory_settings(use_empty=True)
    blend.add_camera((0, -10, 0))


@pytest.fixture
def registered():
    """The add-on, registered for one test."""
    import svgf_blender

    svgf_blender.register()
    yield svgf_blender
    svgf_blender.unregister()
