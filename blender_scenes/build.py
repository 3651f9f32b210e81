# SPDX-License-Identifier: Apache-2.0
"""Builds the scenes of this folder as .blend files, and the small .svgf forms that the demo and the tests use.

    python blender_scenes/build.py [NAME ...] [-o DIR] [--export]
    blender -b -P blender_scenes/build.py -- [NAME ...] [-o DIR] [--export]

Names: cornell, atrium, toys; all of them by default. Needs bpy (`pip install svgf[blender]`) or Blender 4.5 and later.
Each scene is animated over frames 1 to 48; an exported file holds frames 1 to 16 at 960 x 540. The scenes are ours,
made of nothing but numbers: each module holds one, and a fixed seed makes every build the same.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

# Blender runs a script without its folder on the path.
sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy

SCENES = ("cornell", "atrium", "toys")
EXPORTED_FRAMES = range(1, 17)


def build(name: str, folder: Path) -> Path:
    """Builds one scene in Blender's open file and saves it as a .blend."""
    importlib.import_module(name).build()
    path = folder.resolve() / f"{name}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, check_existing=False)
    path.with_suffix(".blend1").unlink(missing_ok=True)  # Blender's backup of an earlier build
    return path


def export(path: Path) -> Path:
    """Writes the .svgf form of a .blend beside it; what svgf would not simulate is printed."""
    import svgf
    from svgf_blender.export import export_file

    target = path.with_suffix(".svgf")
    svgf.save(target, export_file(path, EXPORTED_FRAMES))
    with svgf.SceneFile(target) as file:
        for warning in file.scene(file.frames[0]).warnings:
            print(f"{path.name}: {warning}", file=sys.stderr)
    return target


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="build.py", description="Build svgf's demo scenes.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(SCENES)}; all by default")
    parser.add_argument("-o", "--output", type=Path, default=Path(), metavar="DIR", help="where the files go (here)")
    parser.add_argument("--export", action="store_true", help="write the small .svgf forms too")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in SCENES]
    if unknown:
        parser.error(f"there is no scene {unknown[0]}; the scenes are {', '.join(SCENES)}")
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.names or SCENES:
        path = build(name, options.output)
        print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")
        if options.export:
            path = export(path)
            print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:])
