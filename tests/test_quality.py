# SPDX-License-Identifier: Apache-2.0
"""What the denoiser is for: on our scenes, far less error than its input and far less flicker."""

from __future__ import annotations

from pathlib import Path

import pytest

from svgf.bench.accuracy import INPUT, converge, measure
from svgf.framing import reframe
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
