# SPDX-License-Identifier: Apache-2.0
"""The scenes of blender_scenes/: what their scripts build, and that the exported forms beside them are the same."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import svgf

FOLDER = Path(__file__).parents[1] / "blender_scenes"
LARGEST_FILE = 1_400_000  # bytes; they are part of the repository


class Expected(NamedTuple):
    triangles: int
    instances: int
    meshes: int
    textures: int
    lights: int
    camera_moves: bool
    moving_instances: int  # those with another matrix at the previous frame
    deforming_meshes: int


SCENES = {
    "cornell": Expected(5_508, 8, 8, 0, 0, False, 2, 0),
    "atrium": Expected(223_570, 880, 18, 8, 1, True, 0, 0),
    "toys": Expected(320_332, 1_018, 21, 4, 3, True, 2, 1),
}


def check(scene: svgf.Scene, expected: Expected) -> None:
    instances = scene.instances
    moving = np.any(instances.object_to_world != instances.previous_object_to_world, axis=(1, 2))
    found = Expected(
        triangles=sum(len(scene.meshes[mesh].triangles) for mesh in instances.mesh),
        instances=len(instances.mesh),
        meshes=len(scene.meshes),
        textures=len(scene.textures),
        lights=len(scene.lights),
        camera_moves=not np.array_equal(scene.camera.camera_to_world, scene.previous_camera.camera_to_world),
        moving_instances=int(moving.sum()),
        deforming_meshes=sum(mesh.previous_positions is not None for mesh in scene.meshes),
    )
    assert found == expected
    assert scene.warnings == ()
    assert (scene.defaults.width, scene.defaults.height, scene.defaults.bounces) == (960, 540, 6)


@pytest.mark.parametrize("name", SCENES)
def test_shipped_form(name):
    path = FOLDER / f"{name}.svgf"
    assert path.stat().st_size < LARGEST_FILE
    with svgf.SceneFile(path) as file:
        assert file.frames == tuple(range(1, 17))
        for frame in (1, 16):
            check(file.scene(frame), SCENES[name])


@pytest.fixture
def build(monkeypatch):
    """blender_scenes/build.py as a module."""
    pytest.importorskip("bpy", reason="needs Blender as a module: pip install svgf[blender]")
    pytest.importorskip("svgf_blender.export", reason="the exporter is not installed")
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setattr(sys, "path", list(sys.path))  # build.py adds to it, too
    return importlib.import_module("build")


@pytest.mark.parametrize("name", SCENES)
def test_build(name, build, tmp_path):
    """A build of today exports what is shipped, whichever Blender made it."""
    from svgf_blender.export import export_file

    path = build.build(name, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == [f"{name}.blend"]
    frames = (1, 48)
    built = dict(zip(frames, export_file(path, frames), strict=True))
    for scene in built.values():
        check(scene, SCENES[name])

    shipped = svgf.load(FOLDER / f"{name}.svgf", 1)
    for ours, theirs in zip(built[1].meshes, shipped.meshes, strict=True):
        assert ours.name == theirs.name
        np.testing.assert_array_equal(ours.triangles, theirs.triangles)
        np.testing.assert_allclose(ours.positions, theirs.positions, atol=1e-5)
    np.testing.assert_allclose(built[1].instances.object_to_world, shipped.instances.object_to_world, atol=1e-5)
    np.testing.assert_allclose(built[1].camera.camera_to_world, shipped.camera.camera_to_world, atol=1e-5)
    assert built[1].materials == shipped.materials
    for ours, theirs in zip(built[1].textures, shipped.textures, strict=True):
        # The last bit of a texel hangs on the machine's mathematics library.
        difference = np.abs(ours.pixels.astype(int) - theirs.pixels)
        assert np.mean(difference > 0) < 1e-3


def test_unknown_name(build, capsys):
    with pytest.raises(SystemExit) as exit_info:
        build.main(["castle"])
    assert exit_info.value.code == 2
    assert "there is no scene castle; the scenes are cornell, atrium, toys" in capsys.readouterr().err
