# SPDX-License-Identifier: Apache-2.0
"""Settings refuse what makes no sense, and the Python list of denoise settings is the native one."""

from __future__ import annotations

import dataclasses
import importlib
import math

import pytest

from svgf.errors import InputError
from svgf.settings import METHODS, PIXEL_FILTERS, SIGNALS, DenoiseSettings, Settings

FIELDS = dataclasses.fields(DenoiseSettings)


@pytest.mark.parametrize("build", ["cpu", "cpu_avx2", "cuda"])
def test_denoise_settings_are_the_native_ones(build):
    try:
        native = importlib.import_module(f"svgf._native.{build}")
    except ImportError:
        pytest.skip(f"svgf._native.{build} is not built")
    python = [{"name": item.name, "type": item.type, "default": item.default, **item.metadata} for item in FIELDS]
    assert python == native.denoise_settings()


@pytest.mark.parametrize("item", FIELDS, ids=lambda item: item.name)
def test_each_denoise_setting_is_documented_and_checked(item):
    minimum, maximum = item.metadata["minimum"], item.metadata["maximum"]
    assert minimum <= item.default <= maximum
    assert item.metadata["meaning"].endswith(".")
    for good in (minimum, maximum):
        assert getattr(DenoiseSettings(**{item.name: type(item.default)(good)}), item.name) == good
    for bad in (minimum - 1, maximum + 1, math.nan, "0.2", None, True):
        with pytest.raises(InputError, match=f"DenoiseSettings.{item.name} is .*Give a .*number"):
            DenoiseSettings(**{item.name: bad})


def test_denoise_settings_as_dict_and_back():
    settings = DenoiseSettings(alpha=0.1, levels=3)
    assert DenoiseSettings.from_dict(settings.as_dict()) == settings
    assert DenoiseSettings.from_dict({"levels": 3}).levels == 3
    with pytest.raises(InputError, match='"sigma_luminence".*Did you mean "sigma_luminance"'):
        DenoiseSettings.from_dict({"sigma_luminence": 4.0})


@pytest.mark.parametrize(
    ("seconds", "rate", "frames"),
    [(0.0, 60.0, 20.0), (0.5, 30.0, 15.0), (0.5, 144.0, 72.0), (1e-3, 24.0, 1.0), (3600.0, 1e5, 4096.0)],
)
def test_history_in_seconds(seconds, rate, frames):
    assert DenoiseSettings(history_seconds=seconds, frame_rate=rate).longest_history == frames


def test_levels_are_whole():
    with pytest.raises(InputError, match="levels is 2.5. Give a whole number"):
        DenoiseSettings(levels=2.5)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("width", 0),
        ("height", -1),
        ("width", 1.5),
        ("samples", 0),
        ("samples", None),
        ("bounces", -1),
        ("seed", -1),
        ("seed", 2**32),
        ("exposure", -0.5),
        ("exposure", math.inf),
        ("denoise", {"alpha": 0.1}),
    ],
)
def test_settings_name_the_field(name, bad):
    with pytest.raises(InputError, match=f"Settings.{name} is "):
        Settings(**{name: bad})


@pytest.mark.parametrize(
    ("name", "typo", "meant", "names"),
    [
        ("method", "svfg", "svgf", METHODS),
        ("signals", "diffuse-specular", "diffuse_specular", SIGNALS),
        ("pixel_filter", "centre", "center", PIXEL_FILTERS),
    ],
)
def test_settings_suggest_names(name, typo, meant, names):
    with pytest.raises(InputError) as raised:
        Settings(**{name: typo})
    assert f'Did you mean "{meant}"?' in raised.value.hint
    assert all(known in raised.value.hint for known in names)


def test_pixel_filter_follows_the_method():
    assert Settings().resolved_pixel_filter == "box"
    assert Settings(method="svgf").resolved_pixel_filter == "center"
    assert Settings(method="none").resolved_pixel_filter == "box"
    assert Settings(method="none", pixel_filter="center").resolved_pixel_filter == "center"


def test_settings_take_their_defaults_from_the_scene():
    settings = Settings()
    assert settings.width is settings.height is settings.bounces is settings.exposure is None
    assert settings.denoise == DenoiseSettings()
