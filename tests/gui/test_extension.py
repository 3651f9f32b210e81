# SPDX-License-Identifier: Apache-2.0
"""The life of the extension in a Blender that is installed: nothing is left when it is gone.

    SVGF_BLENDER=PATH SVGF_WHEEL=FILE pytest tests/gui/test_extension.py

SVGF_BLENDER: the executable, `blender` in the PATH by default. SVGF_WHEEL: a wheel of svgf for its Python.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from svgf.extension import build_extension

from ..wheels import with_version

BLENDER = os.environ.get("SVGF_BLENDER") or shutil.which("blender")
WHEEL = os.environ.get("SVGF_WHEEL")
NEWER = "99.0.0"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not BLENDER, reason="there is no Blender: set SVGF_BLENDER"),
    pytest.mark.skipif(not WHEEL, reason="there is no wheel to install: set SVGF_WHEEL"),
]

RENDER = """
import importlib

import bpy
import numpy as np

scene = bpy.context.scene
scene.render.engine = "SVGF"
scene.svgf.device, scene.render.resolution_percentage, scene.render.filepath = "cpu", 5, FRAME

def render():
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(FRAME + ".exr", check_existing=False)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)

settings = scene.render.image_settings
settings.file_format, settings.color_depth = "OPEN_EXR", "32"
assert render()[..., :3].std() > 0.01
"""

UPDATE = """
native = importlib.import_module("svgf._native.cpu")
assert bpy.ops.extensions.package_install_files(filepath=NEWER_ZIP, repo="user_default") == {"FINISHED"}
installation = importlib.import_module("bl_ext.user_default.svgf.installation")
assert "Restart Blender" in installation._problem, installation._problem
assert installation.SVGF_PT_unavailable.is_registered and scene.render.engine == "SVGF"
try:
    bpy.ops.render.render()
except RuntimeError as error:
    assert "was installed while" in str(error)
else:
    raise AssertionError("an svgf of two versions rendered")
"""

DISABLE = """
import addon_utils
for _ in range(3):
    addon_utils.disable("bl_ext.user_default.svgf")
    assert not hasattr(bpy.types.Scene, "svgf")
    addon_utils.enable("bl_ext.user_default.svgf")
    assert render().any()
addon_utils.disable("bl_ext.user_default.svgf", default_set=True)
bpy.ops.wm.save_userpref()
"""


class Profile:
    """A folder of its own for Blender's settings and extensions."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()

    def run(self, *arguments: str | Path) -> str:
        """Blender without a window. Raises AssertionError with its output where it fails."""
        result = subprocess.run(
            [BLENDER, "--background", *map(str, arguments)],
            env={**os.environ, "BLENDER_USER_RESOURCES": str(self.folder)},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert result.returncode == 0 or "passed" in result.stdout, result.stdout + result.stderr
        return result.stdout

    def extension(self, *arguments: str | Path) -> str:
        return self.run("--command", "extension", *arguments)

    def script(self, text: str) -> None:
        """Blender's own exit code is no help: it also tells of a render that was refused."""
        path = self.folder.with_name("script.py")
        path.write_text(f"FRAME = {str(self.folder.with_name('frame'))!r}\n{text}\nprint('passed')\n")
        assert "passed" in self.run("--python-exit-code", "1", "--python", path)

    def traces(self) -> set[str]:
        """Files that speak of svgf."""
        return {
            path.relative_to(self.folder).as_posix()
            for path in self.folder.rglob("*")
            if "svgf" in path.relative_to(self.folder).as_posix() or (path.is_file() and b"svgf" in path.read_bytes())
        }


def test_life_of_an_extension(tmp_path):
    zips = [build_extension(wheel, tmp_path) for wheel in (Path(WHEEL), with_version(Path(WHEEL), NEWER, tmp_path))]
    profile = Profile(tmp_path / "profile")
    profile.extension("validate", zips[0])
    profile.extension("install-file", "-r", "user_default", "--enable", zips[0])
    assert profile.traces()

    profile.script(RENDER + UPDATE.replace("NEWER_ZIP", repr(str(zips[1]))))
    profile.script(RENDER + f"assert importlib.import_module('svgf').__version__ == '{NEWER}'\n")

    profile.script(RENDER + DISABLE)
    profile.script("import bpy\nassert not hasattr(bpy.types.Scene, 'svgf')\n")
    profile.extension("remove", "svgf")
    assert not profile.traces()
