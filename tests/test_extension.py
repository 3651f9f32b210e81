# SPDX-License-Identifier: Apache-2.0
"""The zip that Blender installs, made from a wheel."""

from __future__ import annotations

import io
import tomllib
from zipfile import ZipFile

import pytest
from typer.testing import CliRunner

from svgf import __version__, extension
from svgf.cli import app
from svgf.errors import InputError
from svgf.extension import build_extension

from .wheels import ROOT, pack_wheel


@pytest.mark.parametrize(
    ("tag", "name", "first", "end", "platform"),
    [
        ("cp311-cp311-linux_x86_64", "blender4.5-linux_x64", "4.5.0", "5.1.0", "linux-x64"),
        ("cp312-abi3-manylinux_2_28_x86_64", "blender5.1-linux_x64", "5.1.0", None, "linux-x64"),
        ("cp312-abi3-manylinux2014_aarch64", "blender5.1-linux_arm64", "5.1.0", None, "linux-arm64"),
        ("cp312-abi3-win_amd64", "blender5.1-windows_x64", "5.1.0", None, "windows-x64"),
        ("cp312-abi3-win_arm64", "blender5.1-windows_arm64", "5.1.0", None, "windows-arm64"),
        ("cp311-cp311-macosx_11_0_arm64", "blender4.5-macos_arm64", "4.5.0", "5.1.0", "macos-arm64"),
    ],
)
def test_one_zip_for_each_python_line_and_platform(tmp_path, tag, name, first, end, platform):
    wheel = pack_wheel(tmp_path, tag)
    path = build_extension(wheel, tmp_path / "dist")
    assert path == tmp_path / "dist" / f"svgf-{__version__}-{name}.zip"
    with ZipFile(path) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert manifest["wheels"] == [f"./wheels/{wheel.name}"] and manifest["platforms"] == [platform]
    assert manifest["blender_version_min"] == first and manifest.get("blender_version_max") == end
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"] and manifest["permissions"].keys() == {"files"}
    assert manifest["version"] == __version__


def test_holds_the_add_on_once_and_its_licence(tmp_path):
    with ZipFile(build_extension(pack_wheel(tmp_path), tmp_path)) as archive:
        names = archive.namelist()
        (bundled,) = (name for name in names if name.endswith(".whl"))
        assert b"GNU GENERAL PUBLIC LICENSE" in archive.read("LICENSE")
        with ZipFile(io.BytesIO(archive.read(bundled))) as wheel:
            inside = wheel.namelist()
            record = wheel.read(f"svgf-{__version__}.dist-info/RECORD").decode()
    sources = {path.relative_to(ROOT / "addon").as_posix() for path in (ROOT / "addon").rglob("*.py")}
    assert sources <= set(names)
    assert not any(name.startswith("svgf_blender") for name in inside) and "svgf_blender" not in record
    assert {line.split(",")[0] for line in record.splitlines()} == set(inside)
    assert "svgf/_native/cpu.abi3.so" in inside


def test_same_wheel_same_bytes(tmp_path):
    wheel = pack_wheel(tmp_path)
    first, second = (build_extension(wheel, tmp_path / name).read_bytes() for name in "ab")
    assert first == second


def test_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(extension, "_LARGEST_BYTES", 1000)
    with pytest.raises(InputError, match="more than 0. Build the wheel for fewer GPU architectures"):
        build_extension(pack_wheel(tmp_path), tmp_path / "dist")
    assert not (tmp_path / "dist").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("svgf-0.1.0.tar.gz", "is no wheel of svgf"),
        ("numpy-2.0.0-cp311-cp311-linux_x86_64.whl", "is no wheel of svgf"),
        ("svgf-0.1.0-cp313-cp313-linux_x86_64.whl", "No Blender runs the Python"),
        ("svgf-0.1.0-cp311-cp311-linux_riscv64.whl", "Blender does not run on the platform"),
        ("svgf-0.1.0-cp311-cp311-linux_x86_64.whl", "Cannot read"),
    ],
)
def test_what_is_no_wheel_for_blender(tmp_path, name, message):
    (tmp_path / name).write_bytes(b"no zip")
    result = CliRunner().invoke(app, ["extension", str(tmp_path / name), "-o", str(tmp_path)])
    assert result.exit_code == 2 and message in result.stderr


def test_wheel_without_add_on_and_folder_that_is_no_checkout(tmp_path):
    wheel = tmp_path / "svgf-0.1.0-cp311-cp311-linux_x86_64.whl"
    with ZipFile(wheel, "w") as archive:
        archive.writestr("svgf/__init__.py", "")
    with pytest.raises(InputError, match="does not hold the add-on"):
        build_extension(wheel, tmp_path)
    with pytest.raises(InputError, match="is no checkout of svgf"):
        build_extension(tmp_path, tmp_path)
