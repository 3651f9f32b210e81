# SPDX-License-Identifier: Apache-2.0
"""Wheels of svgf, as an extension is made of them."""

from __future__ import annotations

import re
from pathlib import Path
from zipfile import ZipFile

ROOT = Path(__file__).parents[1]


def pack_wheel(folder: Path, tag: str = "cp312-abi3-linux_x86_64", native: bytes = b"native") -> Path:
    """A wheel of this checkout, with `native` where compiled code would be."""
    contents = {"svgf/_native/cpu.abi3.so": native}
    for package, source in (("svgf", ROOT / "backend" / "svgf"), ("svgf_blender", ROOT / "addon")):
        for path in source.rglob("*"):
            if path.suffix in {".py", ".toml"} or path.name == "LICENSE":
                contents[f"{package}/{path.relative_to(source).as_posix()}"] = path.read_bytes()
    info = "svgf-0.1.0.dist-info"
    contents[f"{info}/METADATA"] = b"Metadata-Version: 2.1\nName: svgf\nVersion: 0.1.0\n"
    contents[f"{info}/WHEEL"] = f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {tag}\n".encode()
    return _write(folder / f"svgf-0.1.0-{tag}.whl", contents, info)


def with_version(wheel: Path, version: str, folder: Path) -> Path:
    """The same wheel, made to say that it is another version."""
    with ZipFile(wheel) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    old = wheel.name.split("-")[1]
    info = f"svgf-{version}.dist-info"
    contents = {name.replace(f"svgf-{old}.dist-info", info): data for name, data in contents.items()}
    for name, pattern in {
        f"{info}/METADATA": r"(?m)^Version: ()[\d.]+$",
        "svgf/__init__.py": r'(?m)^__version__ = "()[\d.]+"$',
        "svgf_blender/blender_manifest.toml": r'(?m)^version = "()[\d.]+"$',
    }.items():
        text = contents[name].decode()
        match = re.search(pattern, text)
        contents[name] = (text[: match.start(1)] + version + text[match.start(1) :].removeprefix(old)).encode()
    return _write(folder / wheel.name.replace(f"-{old}-", f"-{version}-"), contents, info)


def _write(path: Path, contents: dict[str, bytes], info: str) -> Path:
    record = f"{info}/RECORD"
    contents[record] = "".join(f"{name},,\n" for name in sorted({*contents, record})).encode()
    with ZipFile(path, "w") as archive:
        for name, data in contents.items():
            archive.writestr(name, data)
    return path
