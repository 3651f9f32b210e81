# SPDX-License-Identifier: Apache-2.0
"""The Blender extension: a zip that holds the add-on and, as a wheel, svgf itself.

A wheel of svgf carries the add-on as ``svgf_blender``; here it moves from the wheel to the zip's root, where Blender
looks for it. numpy, the only other package that the add-on needs, comes with Blender. Each wheel becomes a zip of its
own: Blender refuses one that holds wheels of several Python versions, and users download one platform's code only.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

from .errors import InputError
from .io.files import make_folder, replacing

_ADDON = "svgf_blender/"
_MANIFEST = "blender_manifest.toml"
_LARGEST_BYTES = 30_000_000
_SYSTEMS = {"linux": "linux", "manylinux": "linux", "win": "windows", "macosx": "macos"}
_MACHINES = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64", "arm64": "arm64"}


@dataclass(frozen=True)
class BlenderRange:
    """The versions of Blender that run one Python line: from ``first`` to before ``end``, where there is an end."""

    first: str
    end: str = ""


# By the ABI tag of the wheel. Blender 4.5 and 5.0 run Python 3.11, later ones 3.13 and up.
_BLENDERS = {"cp311": BlenderRange("4.5.0", "5.1.0"), "abi3": BlenderRange("5.1.0")}


def build_extension(source: Path, folder: Path) -> Path:
    """Writes the extension into ``folder`` and returns its path, such as svgf-0.1.0-blender5.1-linux_x64.zip.

    source: a wheel of svgf, or a checkout, of which pip then builds the wheel for the Python that runs.
    The same wheel gives the same bytes. Raises InputError for a wheel that cannot become an extension.
    """
    if not source.is_dir():
        return _convert(source, folder)
    with tempfile.TemporaryDirectory() as built:
        return _convert(_build_wheel(source, Path(built)), folder)


def _build_wheel(checkout: Path, folder: Path) -> Path:
    if not (checkout / "addon" / _MANIFEST).is_file():
        raise InputError(f"{checkout} is no checkout of svgf.", "Give its root folder, or a wheel.")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(folder), str(checkout)]
    if subprocess.run(command, stdout=sys.stderr, check=False).returncode:
        raise InputError(f"pip cannot build a wheel of {checkout}.", "See its messages above.")
    (wheel,) = folder.glob("*.whl")
    return wheel


def _convert(wheel: Path, folder: Path) -> Path:
    version, abi, platform = _parse_name(wheel)
    blender = _BLENDERS[abi]
    try:
        with ZipFile(wheel) as archive:
            contents = {name: archive.read(name) for name in sorted(archive.namelist()) if not name.endswith("/")}
    except (OSError, BadZipFile) as error:
        raise InputError(f"Cannot read {wheel}: {error}.", "Give a wheel of svgf.") from error
    addon = {name.removeprefix(_ADDON): data for name, data in contents.items() if name.startswith(_ADDON)}
    if _MANIFEST not in addon:
        raise InputError(f"{wheel} does not hold the add-on.", "Build it from a checkout of svgf.")
    bundled = f"wheels/{wheel.name}"
    manifest = addon[_MANIFEST].decode()
    addon[_MANIFEST] = _complete_manifest(manifest, blender, platform, bundled).encode()
    addon[bundled] = _zip(_without_addon(contents))
    result = _zip(addon)
    if len(result) > _LARGEST_BYTES:
        raise InputError(
            f"The extension has {len(result) / 1e6:.0f} MB, more than {_LARGEST_BYTES / 1e6:.0f}.",
            "Build the wheel for fewer GPU architectures (SVGF_CUDA_ARCHITECTURES).",
        )
    make_folder(folder)
    path = folder / f"svgf-{version}-blender{blender.first.removesuffix('.0')}-{platform.replace('-', '_')}.zip"
    with replacing(path) as file:
        file.write(result)
    return path


def _parse_name(wheel: Path) -> tuple[str, str, str]:
    """Version of svgf, ABI tag and Blender's name of the platform."""
    parts = wheel.name.removesuffix(".whl").split("-")
    if wheel.suffix != ".whl" or len(parts) != 5 or parts[0] != "svgf":
        raise InputError(f"{wheel} is no wheel of svgf.", "Give one, or a checkout.")
    _, version, _, abi, tag = parts
    if abi not in _BLENDERS:
        raise InputError(
            f"No Blender runs the Python that {wheel.name} is made for.",
            "Build it with Python 3.11 for Blender 4.5 and 5.0, with 3.12 or newer for later ones.",
        )
    system = re.match("[a-z]*", tag)[0]
    machine = next((name for name in _MACHINES if tag.endswith(f"_{name}")), None)
    if system not in _SYSTEMS or machine is None:
        raise InputError(f"Blender does not run on the platform of {wheel.name}.", "Build it on one where it does.")
    return version, abi, f"{_SYSTEMS[system]}-{_MACHINES[machine]}"


def _complete_manifest(text: str, blender: BlenderRange, platform: str, wheel: str) -> str:
    """The add-on's manifest, with what only this zip has."""
    lines = [f'blender_version_min = "{blender.first}"']
    if blender.end:
        lines.append(f'blender_version_max = "{blender.end}"')
    lines += [f'platforms = ["{platform}"]', f'wheels = ["./{wheel}"]']
    return re.sub("^blender_version_min = .*$", "\n".join(lines), text, count=1, flags=re.MULTILINE)


def _without_addon(contents: dict[str, bytes]) -> dict[str, bytes]:
    """The wheel's files but the add-on's, which its record no longer names."""
    kept = {name: data for name, data in contents.items() if not name.startswith(_ADDON)}
    record = next(name for name in kept if name.endswith(".dist-info/RECORD"))
    lines = kept[record].decode().splitlines(keepends=True)
    kept[record] = "".join(line for line in lines if not line.startswith(_ADDON)).encode()
    return kept


def _zip(contents: dict[str, bytes]) -> bytes:
    """Without times, so that equal contents give equal bytes."""
    buffer = io.BytesIO()
    with ZipFile(buffer, "w", ZIP_DEFLATED) as archive:
        for name, data in contents.items():
            info = ZipInfo(name)
            info.compress_type = ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, data)
    return buffer.getvalue()
