# SPDX-License-Identifier: Apache-2.0
"""What the denoiser is for: on our scenes, far less error than its input and far less flicker."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svgf.bench.accuracy import INPUT, converge, measure
from svgf.framing import reframe
from svgf.renderer import Renderer
from svgf.scene import Scene
from svgf.scene_file import SceneFile
from svgf.settings import Settings

SCENES = Path(__file__).parents[1] / "blender_scenes"


# A GPU converges every scene in seconds; two cores only the one that needs few samples. The truth's own noise counts
# against the denoiser: it flickers, too.
@pytest.mark.parametrize("name", ["cornell", "atrium", "toys"])
def test_error_and_flicker_against_the_input(device, name):
    """At 1 sample per pixel, from frame 5 on, when history has settled."""
    if device.name == "reference" or (device.name == "cpu" and name != "cornell"):
        pytest.skip("takes minutes without a GPU: svgf bench accuracy")
    size, last, samples = ((480, 270), 16, 256) if device.name == "cuda" else ((160, 90), 8, 48)
    with SceneFile(SCENES / f"{name}.svgf") as file:
        scenes = [reframe(file.scene(frame), *size) for frame in range(1, last + 1)]
    settings = Settings(*size)
    truth = converge(device, settings, scenes[4:], samples)
    rows = {row.method: row for row in measure(device, settings, name, scenes, truth, [("svgf", 1), ("eaw", 1)])}
    assert rows["svgf"].relmse <= rows[INPUT].relmse / 3
    assert rows["svgf"].flicker <= rows[INPUT].flicker / 4
    assert rows["svgf"].flip < rows["eaw"].flip < rows[INPUT].flip
    assert rows["svgf"].flicker < rows["eaw"].flicker


def dimmed(scene: Scene, share: float) -> Scene:
    """Its lamps, or what shines in it, give that share of their light; the world stays."""
    lights = tuple(replace(light, power=tuple(share * power for power in light.power)) for light in scene.lights)
    materials = tuple(
        replace(material, emission=tuple(share * radiance for radiance in material.emission))
        for material in scene.materials
    )
    return replace(scene, lights=lights, materials=materials)


@pytest.mark.parametrize("name", ["cornell", "atrium"])
def test_a_lamp_that_is_switched_shows_within_five_frames_of_one_sample(device, name):
    """On and off, over 24 frames of history, with all noise that our own tracer has. 90 % of the change that the fifth
    frame shows where there is no history, so that light which filters spread is not taken for lag: where the change is
    largest, a fifth of the image, and of all light when it goes on; what is left of it where it was dim lingers."""
    if device.name == "reference":
        pytest.skip("takes minutes in numpy")
    size = (96, 54)
    with SceneFile(SCENES / f"{name}.svgf") as file:
        bright = reframe(file.scene(1), *size).at_rest()
    states = (dimmed(bright, 0.1), bright)
    truths = [
        Renderer(Settings(*size, method="none", samples=64, seed=9), device).render(state).noisy for state in states
    ]
    largest = np.abs(truths[1] - truths[0]).mean(axis=-1)
    lit = largest >= np.quantile(largest, 0.8)
    for before, after in ((0, 1), (1, 0)):
        renderer = Renderer(Settings(*size), device)
        for _ in range(24):
            renderer.render(states[before])
        switched = replace(states[after], frame=2)
        frames = [renderer.render(switched) for _ in range(5)]
        assert not frames[0].reset
        anew = Renderer(Settings(*size), device)
        without_history = [anew.render(states[after]) for _ in range(5)][4].color
        for where, least in ((lit, 0.9), (np.ones_like(lit), 0.9 if after else 0.75)):
            change = (without_history - truths[before])[where].mean()
            assert (frames[4].color - truths[before])[where].mean() / change >= least
