# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender and Cycles can do with a scene, a camera, an object or a lamp and svgf cannot; nodes name their own."""

from __future__ import annotations

import bpy
import numpy as np

from .findings import Findings
from .transforms import lengths

_MOST_BOUNCES = 1024  # Cycles' "no limit"


def find_in_scene(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, findings: Findings) -> None:
    render, cycles = scene.render, getattr(scene, "cycles", None)  # absent where the Cycles add-on is disabled
    off = [name for switch, name in (("use_sky", "sky"), ("use_solid", "surfaces")) if not getattr(view_layer, switch)]
    if off:
        findings.add(scene, f"view layers without {', '.join(off)} are not supported yet; they are there.")
    if render.use_motion_blur:
        findings.add(scene, "motion blur is not supported yet; frames are sharp.")
    if render.use_freestyle:
        findings.add(scene, "Freestyle is not supported; no lines are drawn.")
    if render.use_multiview:
        findings.add(scene, "stereoscopy is not supported; there is one picture, of the camera itself.")
    if cycles is None:
        return
    if render.film_transparent and cycles.film_transparent_glass:
        findings.add(scene, "transparent glass is not supported yet; glass in front of the film is opaque.")
    if _filters_pixels(cycles):
        findings.add(scene, "Cycles' pixel filter is not supported yet; pixels are the mean of their own area.")
    if cycles.use_fast_gi:
        findings.add(scene, "fast global illumination is not supported; light is followed for all its bounces.")
    if render.use_simplify:
        if cycles.use_camera_cull or cycles.use_distance_cull:
            findings.add(scene, "culling of objects is not supported; all of them are there.")
        if any(_differs(cycles, f"texture_{name}") for name in _TEXTURE_LIMITS):
            findings.add(scene, "a limit on the size of textures is not supported; images keep theirs.")


_TEXTURE_LIMITS = ("limit", "limit_render", "resolution", "resolution_render")  # the last two since Blender 5.2


def find_in_camera(camera: bpy.types.Object, findings: Findings) -> None:
    data = camera.data
    if data.type not in {"PERSP", "ORTHO"}:
        name = data.bl_rna.properties["type"].enum_items[data.type].name.lower()
        findings.add(data, f"{name} cameras are not supported yet; a perspective one is used instead.")
    if np.linalg.det(np.array(camera.matrix_world, np.float64)[:3, :3]) < 0:
        findings.add(
            camera, "a mirrored camera (negative scale) is not supported yet; it is used without the mirroring."
        )


def find_in_object(owner: bpy.types.Object, findings: Findings) -> None:
    """owner: an evaluated mesh object."""
    if owner.is_shadow_catcher:
        findings.add(owner, "shadow catchers are not supported yet; the object is an ordinary one.")
    _find_light_linking(owner, findings)
    if _differs(owner, "shadow_terminator_shading_offset"):
        findings.add(owner, "a shading offset of the shadow terminator is not supported; it stays where it is.")
    if any(_dices(modifier) for modifier in owner.modifiers):
        findings.add(owner, "adaptive subdivision is not supported yet; the modifier's own levels are used.")
    for system in owner.particle_systems:
        if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
            findings.add(owner, f'hair of particle system "{system.name}" is not supported yet; it is left out.')


def find_in_lamp(lamp: bpy.types.Object, findings: Findings) -> None:
    light = lamp.data
    _find_light_linking(lamp, findings)
    if light.type == "SPOT" and np.ptp(lengths(np.array(lamp.matrix_world))) > 1e-4 * max(lamp.matrix_world.to_scale()):
        findings.add(lamp, "a spot lamp scaled unevenly is not supported yet; its cone is round.")
    if not light.use_shadow:
        findings.add(light, "a lamp without shadows is not supported yet; it casts them.")
    cycles = getattr(light, "cycles", None)
    if cycles is None:
        return
    if cycles.max_bounces < _MOST_BOUNCES:
        findings.add(light, "a limit on a lamp's own bounces is not supported yet; it lights every bounce.")
    if cycles.is_caustics_light:
        findings.add(light, "shadow caustics are not supported; the light finds its way through glass by chance.")


def find_in_world(world: bpy.types.World, findings: Findings) -> None:
    cycles = getattr(world, "cycles", None)
    if cycles is None:
        return
    if cycles.max_bounces < _MOST_BOUNCES:
        findings.add(world, "a limit on the world's own bounces is not supported yet; it lights every bounce.")
    if cycles.is_caustics_light:
        findings.add(world, "shadow caustics are not supported; the light finds its way through glass by chance.")
    if not getattr(cycles, "use_shadows", True):  # since Blender 5.2
        findings.add(world, "a world without shadows is not supported yet; it casts them.")


def _filters_pixels(cycles: bpy.types.PropertyGroup) -> bool:
    """Whether an artist has chosen another filter than Blender's default, which is left out in every file, and than the
    box, which svgf has, too."""
    kind = cycles.pixel_filter_type
    return kind != "BOX" and (_differs(cycles, "pixel_filter_type") or _differs(cycles, "filter_width"))


def _find_light_linking(owner: bpy.types.Object, findings: Findings) -> None:
    linking = owner.light_linking
    if linking.receiver_collection is not None or linking.blocker_collection is not None:
        findings.add(owner, "light linking is not supported yet; lamps shine on everything.")


def _dices(modifier: bpy.types.Modifier) -> bool:
    return modifier.type == "SUBSURF" and getattr(modifier, "use_adaptive_subdivision", False)


def _differs(owner: bpy.types.bpy_struct, name: str) -> bool:
    """Whether an artist has set a property that this Blender has."""
    found = owner.bl_rna.properties.get(name)
    return found is not None and getattr(owner, name) != found.default
