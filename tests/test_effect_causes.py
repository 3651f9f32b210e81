# SPDX-License-Identifier: Apache-2.0
"""Each effect of a scene has something that calls for it, which can be told by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import svgf
from svgf.effects import Effects, find_causes, find_effects
from svgf.scene import Light, LightKind

SCENES = sorted((Path(__file__).parents[1] / "blender_scenes").glob("*.svgf"))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_causes_are_the_effects(path):
    file = svgf.SceneFile(path)
    scene = next(iter(file))
    causes = find_causes(scene)
    assert set(causes) == set(find_effects(scene)) and all(causes.values())
    for effect in causes:
        assert len(set(causes[effect])) == len(causes[effect])


def test_culprits_are_named():
    scene = next(iter(svgf.SceneFile(SCENES[0]))).at_rest()
    lamp = Light("Spot", LightKind.SPOT, (1.0, 1.0, 1.0), np.eye(3, 4))
    dark = replace(lamp, name="Off", power=(0.0, 0.0, 0.0))
    scene = replace(scene, lights=(lamp, dark))
    assert find_causes(scene)[Effects.DELTA_LIGHTS] == ('lamp "Spot"',)
    moved = scene.instances.object_to_world.copy()
    moved[0, 0, 3] += 1
    scene = replace(scene, instances=replace(scene.instances, object_to_world=moved))
    assert find_causes(scene)[Effects.OBJECT_MOTION] == ("1 moving instance",)
