# SPDX-License-Identifier: Apache-2.0
"""svgf's command line called in this process, and a small sequence to call it with."""

from __future__ import annotations

import re

import numpy as np
from typer.testing import CliRunner, Result

from svgf.cli import app
from svgf.scene import Camera, Instances, Light, LightKind, Material, Mesh, RenderDefaults, Scene, World

SMALL = ("--size", "16x9", "--device", "reference", "--bounces", "1")


def make_scene(frame: int = 1) -> Scene:
    """A lit floor with a glossy triangle on it that moves to the right."""
    corners = np.array([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], np.float32)
    floor = Mesh(
        "Floor",
        corners,
        np.array([(0, 1, 2), (0, 2, 3)], np.int32),
        np.zeros((2, 3, 3), np.float32),
        np.zeros(2, np.int32),
    )
    shard = Mesh(
        "Shard",
        np.array([(-0.5, 0, 0.1), (0.5, 0, 0.1), (0, 0.5, 0.6)], np.float32),
        np.array([(0, 1, 2)], np.int32),
        np.zeros((1, 3, 3), np.float32),
        np.zeros(1, np.int32),
    )
    now, before = np.stack([np.eye(3, 4)] * 2), np.stack([np.eye(3, 4)] * 2)
    now[1, 0, 3], before[1, 0, 3] = 0.1 * frame, 0.1 * (frame - 1)
    numbers = np.arange(2, dtype=np.int32)
    above = np.array([(1.0, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 3)])
    camera = Camera(above, (-0.6, 0.6, -0.3375, 0.3375))
    return Scene(
        meshes=(floor, shard),
        instances=Instances(numbers, now, before, numbers + 1, numbers, numbers),
        materials=(Material("Matte", specular_ior_level=0.0), Material("Glossy", roughness=0.3, metallic=1.0)),
        camera=camera,
        previous_camera=camera,
        lights=(Light("Lamp", LightKind.POINT, (100.0, 90.0, 80.0), above + [0, 0, 0, 1.0], (0.2, 0.0)),),
        world=World((0.1, 0.1, 0.2)),
        frame=frame,
        name="shard",
        defaults=RenderDefaults(32, 18, bounces=2),
        warnings=("Volumes are not simulated.",),
    )


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def assert_refused(result: Result, message: str) -> None:
    """Exit code 2, nothing on standard output, and one line on standard error that holds the message."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    lines = [line for line in result.stderr.splitlines() if not line.startswith("Warning: ")]
    assert len(lines) == 1 and lines[0].startswith("Error: "), result.stderr
    assert re.search(message, lines[0]), lines[0]


def assert_done(result: Result) -> str:
    assert result.exit_code == 0, result.output
    return result.stdout
