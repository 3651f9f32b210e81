# SPDX-License-Identifier: Apache-2.0
"""The add-on comes and goes without a trace, and its properties are svgf's settings."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path

import bpy
import pytest
import svgf_blender
from svgf import __version__
from svgf.errors import InputError
from svgf.light_paths import LIGHT_PATH_RANGES, LightPaths
from svgf.scene import RenderDefaults
from svgf.settings import DenoiseSettings, Settings

HANDLERS = ("render_init", "render_complete", "render_cancel", "load_pre", "undo_post", "redo_post")


def state() -> tuple:
    """All that registration may change."""
    panels = bpy.types.Panel.__subclasses__()
    return (
        hasattr(bpy.types.Scene, "svgf") or hasattr(bpy.types.ViewLayer, "svgf"),
        {panel.__name__ for panel in panels if panel.is_registered and "SVGF" in getattr(panel, "COMPAT_ENGINES", ())},
        "SVGF"
        in {getattr(kind, "bl_idname", "") for kind in bpy.types.RenderEngine.__subclasses__() if kind.is_registered},
        [len(getattr(bpy.app.handlers, name)) for name in HANDLERS],
    )


def test_ten_times():
    before = state()
    for _ in range(10):
        svgf_blender.register()
        assert bpy.context.scene.svgf.samples == 1
        bpy.context.scene.render.engine = "SVGF"
        svgf_blender.unregister()
    assert state() == before


def test_file_keeps_its_settings(registered, tmp_path):
    bpy.context.scene.svgf.denoise.levels = 3
    bpy.context.scene.render.engine = "SVGF"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "settings.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "settings.blend"))
    assert bpy.context.scene.svgf.denoise.levels == 3 and bpy.context.scene.render.engine == "SVGF"


def test_defaults_are_those_of_the_settings(registered):
    assert bpy.context.scene.svgf.to_settings() == Settings()


def test_every_property_has_description_and_range(registered):
    settings = bpy.context.scene.svgf
    groups = (settings, settings.denoise, settings.light_paths, bpy.context.view_layer.svgf)
    for group in groups:
        for item in group.bl_rna.properties:
            if item.identifier in {"rna_type", "name"} or item.type == "POINTER":
                continue
            assert item.description and item.name, item.identifier
            assert not item.description.endswith("."), item.identifier
            if item.type in {"INT", "FLOAT"}:
                assert item.hard_min > -1e9 and item.hard_max < 1e10, item.identifier
            elif item.type == "ENUM":
                assert all(choice.description for choice in item.enum_items), item.identifier


def test_denoise_properties_are_the_settings_fields(registered):
    properties = bpy.context.scene.svgf.denoise.bl_rna.properties
    for item in fields(DenoiseSettings):
        if item.name in ("frame_rate", "steps"):  # Blender's output has it; is there to be measured
            assert item.name not in properties
            continue
        shown = properties[item.name]
        assert shown.hard_min == pytest.approx(item.metadata["minimum"])
        assert shown.hard_max == pytest.approx(item.metadata["maximum"])
        assert item.metadata["meaning"].rstrip(".") in shown.description


def test_history_in_seconds_goes_by_the_frame_rate_of_the_output(registered):
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = 30, 1.001
    scene.svgf.denoise.history_seconds = 0.5
    assert scene.svgf.to_settings().denoise.longest_history == pytest.approx(15 / 1.001)


def test_light_paths_are_the_scenes_until_it_has_some_for_svgf(registered):
    settings = bpy.context.scene.svgf
    assert settings.to_settings().bounces is None and settings.to_settings().clamp_indirect is None
    settings.use_own_light_paths = True
    own = settings.to_settings()
    assert own.light_paths(LightPaths(glossy_bounces=1)) == LightPaths() and own.bounces == RenderDefaults.bounces
    settings.light_paths.bounces, settings.light_paths.clamp_indirect = 3, 0.7
    assert (settings.to_settings().bounces, settings.to_settings().clamp_indirect) == (3, 0.7)


def test_ranges_of_light_paths_are_those_of_the_settings(registered):
    shown = bpy.context.scene.svgf.light_paths.bl_rna.properties
    for name, ends in LIGHT_PATH_RANGES.items():
        assert (shown[name].hard_min, shown[name].hard_max) == ends


def test_quality_sets_samples_and_is_found_again(registered):
    settings = bpy.context.scene.svgf
    assert settings.quality == "balanced"
    for name in ("draft", "final", "balanced"):
        settings.quality = name
        assert settings.quality == name
    settings.viewport_samples += 1
    assert settings.quality == "custom"
    before = settings.viewport_samples
    settings.quality = "custom"
    assert settings.viewport_samples == before


def test_quality_is_kept_in_the_file(registered, tmp_path):
    bpy.context.scene.svgf.quality = "final"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "quality.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "quality.blend"))
    assert bpy.context.scene.svgf.quality == "final"


@pytest.mark.parametrize("name", ["samples", "seed"])
def test_ranges_are_accepted_by_the_settings(registered, name):
    shown = bpy.context.scene.svgf.bl_rna.properties[name]
    for value in (shown.hard_min, shown.hard_max):
        assert getattr(Settings(**{name: value}), name) == value
    with pytest.raises(InputError):
        Settings(**{name: shown.hard_min - 1})


def test_blender_shows_its_own_panels(registered):
    shown = state()[1]
    assert {
        *(
            "DATA_PT_lens",
            "DATA_PT_camera",
            "DATA_PT_EEVEE_light",
            "EEVEE_MATERIAL_PT_surface",
            "EEVEE_WORLD_PT_surface",
        ),
        *("RENDER_PT_format", "RENDER_PT_output", "RENDER_PT_color_management"),
        *("OBJECT_PT_visibility", "OBJECT_PT_shadow_terminator"),
    } <= shown
    assert not any("freestyle" in name or "lightprobe" in name for name in shown)
    # Ours has its place below the sampling.
    assert "SVGF_PT_simplify" in shown and not any("RENDER_PT_simplify" in name for name in shown)


def test_a_list_of_causes_names_each_kind_once(registered):
    from svgf_blender.ui.statistics import list_causes

    assert list_causes(("the world",)) == "The world"
    assert list_causes(('material "Oak"', 'material "Wool"', 'lamp "Key"')) == 'Material "Oak", "Wool", lamp "Key"'
    assert list_causes(tuple(f'lamp "{i}"' for i in range(6))) == 'Lamp "0", "1", "2", "3" and 2 more'


def test_manifest():
    manifest = tomllib.loads((Path(svgf_blender.__file__).parent / "blender_manifest.toml").read_text())
    assert manifest["version"] == __version__ and manifest["type"] == "add-on"
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert tuple(map(int, manifest["blender_version_min"].split("."))) == (4, 5, 0)
