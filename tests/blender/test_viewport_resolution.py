# SPDX-License-Identifier: Apache-2.0
"""The resolution of a view drops only while it changes, and only as far as the budget asks for."""

from __future__ import annotations

import pytest

pytest.importorskip("bpy")

from svgf_blender.viewport.resolution import STILL_SECONDS, Resolution

PIXELS = 1000


@pytest.fixture
def resolution():
    """Of a view whose frames take 100 ms."""
    resolution = Resolution()
    resolution.measure(100.0, PIXELS)
    return resolution


@pytest.mark.parametrize(
    ("budget", "divisor"), [(0, 1), (1000, 1), (100, 1), (99, 2), (25, 2), (20, 3), (6.25, 4), (1.6, 8), (0.01, 8)]
)
def test_budget_decides(resolution, budget, divisor):
    assert resolution.choose(PIXELS, budget, 10.0, changed=True) == divisor


def test_still_view_is_whole(resolution):
    assert resolution.choose(PIXELS, 25, 10.0, changed=False) == 1
    assert resolution.choose(PIXELS, 25, 10.0, changed=True) == 2
    assert resolution.choose(PIXELS, 25, 10.0 + 0.9 * STILL_SECONDS, changed=False) == 2
    assert resolution.choose(PIXELS, 25, 10.0 + 1.1 * STILL_SECONDS, changed=False) == 1


def test_changes_in_a_row_keep_the_coarsest(resolution):
    """Each step blurs or thins the history."""
    resolution.choose(PIXELS, 25, 10.0, changed=True)
    resolution.measure(500.0, PIXELS)
    assert resolution.choose(PIXELS, 25, 10.1, changed=True) == 6
    resolution.measure(1.0, PIXELS)
    assert resolution.choose(PIXELS, 25, 10.2, changed=True) == 6
    assert resolution.choose(PIXELS, 25, 20.0, changed=True) == 1


@pytest.mark.parametrize(("width", "height", "divisor"), [(100, 100, 1), (640, 480, 6), (1920, 1080, 8)])
def test_first_frame_is_coarse_until_its_cost_is_known(width, height, divisor):
    assert Resolution().choose(width * height, 50, 10.0, changed=True) == divisor
    assert Resolution().choose(width * height, 0, 10.0, changed=True) == 1
