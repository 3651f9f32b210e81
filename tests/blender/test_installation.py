# SPDX-License-Identifier: Apache-2.0
"""An svgf that cannot run: Blender starts all the same, and says why and what to do."""

from __future__ import annotations

import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
import svgf
import svgf_blender
from svgf import _native
from svgf_blender import installation


@pytest.fixture
def native_folder(monkeypatch, tmp_path) -> Path:
    """An empty folder in place of the one that holds the native modules."""
    for name in ("cpu", "cpu_avx2", "cuda"):
        monkeypatch.delitem(sys.modules, f"svgf._native.{name}", raising=False)
    monkeypatch.setattr(_native, "__path__", [str(tmp_path)])
    return tmp_path


def compile_module(folder: Path, source: str) -> None:
    """A shared library where Python looks for the native module."""
    (folder / "module.c").write_text(source)
    target = folder / f"cpu{EXTENSION_SUFFIXES[0]}"
    command = ["cc", "-shared", "-fPIC", "-o", str(target), str(folder / "module.c")]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("there is no C compiler")


def assert_blender_says(reason: str, remedy: str) -> None:
    """Registers, renders and shows the panel, all without svgf's own classes."""
    svgf_blender.register()
    try:
        assert not hasattr(bpy.types.Scene, "svgf")
        bpy.context.scene.render.engine = "SVGF"
        with pytest.raises(RuntimeError) as error:
            bpy.ops.render.render()
        lines = []
        column = SimpleNamespace(label=lambda text, icon: lines.append(text))
        installation.SVGF_PT_unavailable.draw(
            SimpleNamespace(layout=SimpleNamespace(column=lambda align: column)), bpy.context
        )
        for said in (str(error.value), "".join(lines)):
            for part in (reason, remedy):  # the panel breaks lines wherever they are full
                assert "".join(part.split()) in "".join(said.split()), said
        assert installation.SVGF_PT_unavailable.poll(SimpleNamespace(engine="SVGF"))
        assert not installation.SVGF_PT_unavailable.poll(SimpleNamespace(engine="CYCLES"))
    finally:
        svgf_blender.unregister()
    assert not installation.SVGF_PT_unavailable.is_registered


def test_all_is_well():
    pytest.importorskip("svgf._native.cpu", reason="the native modules are not built")
    assert installation.find_problem() == ""


def test_package_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "svgf", None)
    assert_blender_says("finds no package svgf", "install its zip for Blender")


def test_native_module_is_missing(native_folder):
    assert_blender_says(f"svgf._native.cpu is missing in {native_folder}", "install its zip for Blender")


def test_native_module_of_another_python(native_folder):
    name = "cpu.cpython-310-x86_64-linux-gnu.so"
    (native_folder / name).touch()
    assert_blender_says(f"is made for another Python than Python 3.{sys.version_info.minor}: {name}", "install its zip")


def test_native_module_of_a_newer_python(native_folder):
    compile_module(native_folder, "int PyOfTomorrow(void); int PyInit_cpu(void) { return PyOfTomorrow(); }")
    assert_blender_says("is made for a newer Python than Python 3", "install its zip")


def test_native_module_that_is_broken(native_folder):
    (native_folder / f"cpu{EXTENSION_SUFFIXES[0]}").write_bytes(b"half a file")
    assert_blender_says("svgf._native.cpu cannot be loaded", "install its zip")


def test_system_that_is_too_old(native_folder, monkeypatch):
    """The linker's own words for it."""
    reason = "/lib/x86_64-linux-gnu/libc.so.6: version `GLIBC_2.99' not found (required by cpu.abi3.so)"

    def fail(name, package=None):
        if name.endswith("_native.cpu"):
            raise ImportError(reason, name="svgf._native.cpu", path="cpu.abi3.so")
        return original(name, package)

    original = __import__("importlib").import_module
    monkeypatch.setattr("importlib.import_module", fail)
    assert_blender_says("needs GLIBC_2.99, which this system is too old to have", "install its zip")


def test_update_while_in_use(monkeypatch):
    monkeypatch.setattr(svgf, "__version__", "0.0.1")
    assert_blender_says("was installed while 0.0.1 was at work.", "Restart Blender.")


def test_blender_accepts_the_extension(tmp_path):
    """Its own validation, as on the extension platform."""
    from tests.wheels import pack_wheel

    from svgf.extension import build_extension

    program = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    if not program.is_file():
        pytest.skip("this bpy comes without Blender's extension tool")
    path = build_extension(pack_wheel(tmp_path), tmp_path)
    result = subprocess.run([sys.executable, program, "validate", path], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_add_on_needs_numpy_only():
    """Blender brings it; everything else would have to come in the zip."""
    program = (
        "import sys, bpy; before = set(sys.modules); import svgf_blender; svgf_blender.register();"
        "from svgf.renderer import Renderer; import svgf_blender.export.file;"
        "new = {name.partition('.')[0] for name in set(sys.modules) - before};"
        "print(*sorted(new - set(sys.stdlib_module_names)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    brought = set(result.stdout.splitlines()[-1].split())
    assert brought <= {"svgf", "svgf_blender", "numpy", "bpy", "_bpy", "mathutils", "gpu_extras"}


@pytest.mark.parametrize(
    ("chosen", "reason", "said"),
    [
        ("auto", "There is no NVIDIA driver. Install one.", "There is no NVIDIA driver. Install one. The CPU renders."),
        ("cuda", "There is no NVIDIA driver. Install one.", "There is no NVIDIA driver. Install one."),
        ("cpu", "There is no NVIDIA driver. Install one.", None),
        ("auto", "", None),
    ],
)
def test_no_driver(registered, monkeypatch, chosen, reason, said):
    """The CPU renders, and the panel says why the GPU does not."""
    from svgf_blender.ui import devices

    monkeypatch.setattr(devices, "_reason", None)
    monkeypatch.setattr(devices, "available_devices", lambda: [SimpleNamespace(name="cuda", reason=reason)])
    bpy.context.scene.svgf.device = chosen
    context = SimpleNamespace(engine="SVGF", scene=bpy.context.scene)
    devices.find_reason().result()
    assert devices.SVGF_PT_no_gpu.poll(context) == (said is not None)
    if said is not None:
        lines = []
        column = SimpleNamespace(label=lambda text, icon: lines.append(text))
        panel = SimpleNamespace(layout=SimpleNamespace(column=lambda align: column))
        devices.SVGF_PT_no_gpu.draw(panel, context)
        assert " ".join(lines) == said
