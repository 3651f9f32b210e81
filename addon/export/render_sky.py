# SPDX-License-Identifier: GPL-3.0-or-later
"""A program: ``blender --background --python render_sky.py -- SETTINGS WIDTH FOLDER``.

Cycles renders the sky of a Sky Texture node with these settings (JSON) as an equirectangular sky.exr, whose middle is
+X, and where it has a sun, the rows of that once more as sun.exr.
"""

import json
import math
import sys

import bpy


def main(settings: dict, width: int, folder: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    sky, background = tree.nodes.new("ShaderNodeTexSky"), tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(sky.outputs[0], background.inputs["Color"])
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    for name, value in settings.items():
        setattr(sky, name, value)

    camera = bpy.data.cameras.new("Camera")
    camera.type = "PANO"
    (camera if hasattr(camera, "panorama_type") else camera.cycles).panorama_type = "EQUIRECTANGULAR"
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.camera.rotation_euler = math.pi / 2, 0.0, -math.pi / 2
    scene.collection.objects.link(scene.camera)

    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, width // 2, 100
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    image = render.image_settings
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGB", "32"

    # A sky is smooth, but for its sun.
    cycles.samples, cycles.filter_width = 1, 0.01
    _render(f"{folder}/sky.exr")
    if settings["sun_disc"] and "SCATTERING" in settings["sky_type"] or settings["sky_type"] == "NISHITA":
        cycles.samples, cycles.filter_width = 64, 1.0
        render.use_border = render.use_crop_to_border = True
        render.border_min_y, render.border_max_y = sun_rows(settings, width)
        _render(f"{folder}/sun.exr")


def sun_rows(settings: dict, width: int) -> tuple[float, float]:
    """The part of the height that the sun is in, from the bottom, in whole pixels."""
    height, reach = width // 2, settings["sun_size"] / 2
    low, high = (0.5 + (settings["sun_elevation"] + offset) / math.pi for offset in (-reach, reach))
    return max(math.floor(low * height) - 1, 0) / height, min(math.ceil(high * height) + 1, height) / height


def _render(path: str) -> None:
    bpy.context.scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    main(json.loads(arguments[0]), int(arguments[1]), arguments[2])
