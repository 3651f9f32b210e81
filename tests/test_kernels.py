# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled for fewer effects or for all: which one runs changes no bit of the image."""

import numpy as np
import pytest

from svgf.bench import effects as effects_bench
from svgf.effects import Effects, find_effects

from . import scenes
from .material_cases import varied_scenes
from .tracing import trace

SCENES = {**scenes.device_scenes(), "coat": varied_scenes()["lit_coat"]}


def test_kernels_go_from_the_cheapest_to_the_one_that_covers_all(device):
    kernels = device.kernels
    assert kernels[-1] & ~Effects.NONE == ~Effects.NONE
    for index, kernel in enumerate(kernels):
        assert device.kernel_for(kernel) == kernel
        assert not any(kernel & earlier == kernel for earlier in kernels[:index])


@pytest.mark.parametrize("name", SCENES)
def test_every_kernel_that_covers_a_scene_gives_the_same_bits(device, name):
    effects = find_effects(SCENES[name])
    covering = [kernel for kernel in device.kernels if effects & kernel == effects]
    assert covering and covering[0] == device.kernel_for(effects)
    first = trace(device, SCENES[name])
    for kernel in covering[1:]:
        other = trace(device, SCENES[name], kernel=int(kernel))
        assert other.keys() == first.keys()
        for image in first:
            np.testing.assert_array_equal(other[image], first[image], err_msg=f"{image}, kernel {kernel!r}")


def test_the_scenes_reach_every_kernel(device):
    """Else the comparison above compares nothing."""
    assert {device.kernel_for(find_effects(scene)) for scene in SCENES.values()} == set(device.kernels)


def test_every_effect_can_be_left_out():
    assert set(effects_bench.WITHOUT) == set(Effects)


FOUND = [effect for effect in effects_bench.WITHOUT if any(effect in find_effects(scene) for scene in SCENES.values())]


@pytest.mark.parametrize("effect", FOUND)
def test_a_scene_can_do_without_each_effect(effect):
    """What the benchmark calls the same scene without an effect has not got it, and is else as it was."""
    for scene in (scene for scene in SCENES.values() if effect in find_effects(scene)):
        left = find_effects(effects_bench.WITHOUT[effect](scene))
        assert effect not in left and left & ~find_effects(scene) == Effects.NONE
