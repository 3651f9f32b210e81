# SPDX-License-Identifier: Apache-2.0
"""What holds for the package as a whole: layers, licences, and an import that costs nothing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = [
    path
    for folder in ("addon", "backend", "blender_scenes", "tests")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in {".py", ".h", ".cpp", ".cu", ".cmake"}
]


def test_bpy_is_imported_by_the_blender_side_only():
    pattern = re.compile(r"^\s*(import|from)\s+(bpy|mathutils)\b", re.MULTILINE)
    importing = {
        path.relative_to(ROOT).parts[0] for path in SOURCES if pattern.search(path.read_text(encoding="utf-8"))
    }
    assert importing <= {"addon", "blender_scenes", "tests"}


def test_native_code_knows_neither_python_nor_blender():
    pattern = re.compile(r"nanobind|Python\.h|\bbpy\b|Blender/")
    for path in (ROOT / "backend" / "native").rglob("*"):
        if path.suffix in {".h", ".cpp", ".cu"} and not path.name.startswith("bindings"):
            assert not pattern.search(path.read_text(encoding="utf-8")), path


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_each_file_names_its_licence(path):
    licence = "GPL-3.0-or-later" if path.is_relative_to(ROOT / "addon") else "Apache-2.0"
    if path.is_relative_to(ROOT / "tests" / "blender"):
        licence = "(GPL-3.0-or-later|Apache-2.0)"
    head = "\n".join(path.read_text(encoding="utf-8").splitlines()[:3])
    assert re.search(f"SPDX-License-Identifier: {licence}$", head, re.MULTILINE)


def test_every_reference_tag_is_resolved():
    known = set(re.findall(r"\*\*\[(\w+)\]\*\*", (ROOT / "backend" / "REFERENCES.md").read_text(encoding="utf-8")))
    used = {
        tag
        for path in SOURCES
        for tag in re.findall(r"\[([A-Z][a-z]+\d\d)(?:,[^\]]*)?\]", path.read_text(encoding="utf-8"))
    }
    assert used <= known, f"not in backend/REFERENCES.md: {sorted(used - known)}"


def test_import_loads_no_native_module():
    program = "import sys, svgf; print(*sorted(m for m in sys.modules if m.startswith(('svgf', 'numpy', 'cupy'))))"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert loaded == ["svgf"]


def test_every_public_name_exists():
    import svgf

    for name in svgf.__all__:
        assert getattr(svgf, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        svgf.nothing  # noqa: B018


def test_cpu_builds_give_the_same_bits():
    """The AVX2 build, which has a traversal of its own, agrees with the baseline build to the bit."""
    import numpy as np

    cpu = pytest.importorskip("svgf._native.cpu", reason="the native modules are not built")
    if not (cpu.has_avx2_build and cpu.processor_has_avx2()):
        pytest.skip("this processor has no AVX2")
    import svgf._native.cpu_avx2 as cpu_avx2
    from svgf import scene_file
    from svgf.devices import Device
    from svgf.renderer import Renderer
    from svgf.settings import Settings

    from .scenes import box_scene, device_scenes
    from .tracing import trace

    tested = device_scenes()
    for path in sorted((Path(__file__).parents[1] / "blender_scenes").glob("*.svgf")):
        tested[path.stem] = scene_file.load(path, 1)
    devices = [Device("cpu", name, module) for name, module in (("baseline", cpu), ("AVX2", cpu_avx2))]
    for name, scene in tested.items():
        first, second = (trace(device, scene, 48, 27) for device in devices)
        for image in first:
            np.testing.assert_array_equal(first[image], second[image], err_msg=f"{name}, {image}")
    settings = Settings(width=48, height=27, bounces=3)
    first, second = (Renderer(settings, device).render(box_scene()) for device in devices)
    np.testing.assert_array_equal(first.color, second.color)


@pytest.mark.skipif(sys.platform != "linux", reason="ldd is Linux's")
def test_native_modules_need_the_system_only():
    """cudart in particular is linked statically: the driver is all that a GPU asks for."""
    from svgf import _native

    modules = list(Path(_native.__path__[0]).glob("*.so"))
    if not modules:
        pytest.skip("the native modules are not built")
    system = {"linux-vdso", "ld-linux-x86-64", "ld-linux-aarch64", "libc", "libm", "libstdc++", "libgcc_s"}
    system |= {"libpthread", "libdl", "librt"}  # parts of libc where it is older
    for module in modules:
        listing = subprocess.run(["ldd", module], capture_output=True, text=True, check=True).stdout
        needed = {Path(line.split()[0]).name.partition(".so")[0] for line in listing.splitlines()}
        assert needed <= system, module
