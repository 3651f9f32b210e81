# SPDX-License-Identifier: Apache-2.0
"""Materials that reach every lobe and layer, and scenes of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from svgf.scene import Interpolation, LightKind, Material, MaterialKind, Scene, Texture, TextureMap, World

from . import scenes

COAT = Material("coat", base_color=(0.7, 0.3, 0.2), roughness=0.6, coat_weight=0.8, coat_roughness=0.2)
# Of one part each.
SINGLE = (
    Material("rough diffuse", kind=MaterialKind.DIFFUSE, base_color=(0.8, 0.5, 0.3), diffuse_roughness=0.7),
    Material("tinted metal", base_color=(0.9, 0.6, 0.3), metallic=1.0, roughness=0.4, specular_tint=(0.5, 1.0, 0.2)),
    Material("plastic", base_color=(0.2, 0.5, 0.8), specular_ior_level=0.9, specular_tint=(1.0, 0.5, 0.8), ior=1.8),
    Material("light plastic", roughness=0.4, ior=0.7),
    Material("single scattering", roughness=0.9, metallic=0.5, multiscatter=False),
    COAT,
    dataclasses.replace(COAT, name="tinted coat", coat_tint=(0.9, 0.4, 0.2), coat_ior=1.8, metallic=0.5),
    Material("sheen", base_color=(0.3, 0.1, 0.1), sheen_weight=0.9, sheen_roughness=0.4, sheen_tint=(0.9, 1.0, 0.5)),
    Material("soft sheen", base_color=(0.2, 0.2, 0.5), sheen_weight=1.0, sheen_roughness=0.9, ior=1.0),
    Material("brushed", base_color=(0.9, 0.8, 0.6), metallic=0.8, anisotropic=0.8, anisotropic_rotation=0.2),
    Material("glossy", kind=MaterialKind.GLOSSY, base_color=(0.8, 0.5, 0.3), roughness=0.5),
    Material("long glossy", kind=MaterialKind.GLOSSY, roughness=0.4, anisotropic=0.7),
    Material("wide glossy", kind=MaterialKind.GLOSSY, roughness=0.4, anisotropic=-0.7, anisotropic_rotation=0.1),
    Material("tinted glass", kind=MaterialKind.GLASS, base_color=(0.9, 0.6, 0.5), roughness=0.4),
    Material("thin glass", kind=MaterialKind.GLASS, base_color=(0.9, 0.9, 0.9), roughness=0.7, ior=0.6),
    Material("principled glass", base_color=(0.8, 0.6, 0.9), transmission=0.8, specular_tint=(1.0, 0.6, 0.3)),
    Material("refraction", kind=MaterialKind.REFRACTION, base_color=(0.9, 0.8, 0.7), roughness=0.4),
    Material("translucent", kind=MaterialKind.TRANSLUCENT, base_color=(0.6, 0.8, 0.4)),
    Material(
        "all",
        base_color=(0.7, 0.6, 0.8),
        metallic=0.3,
        transmission=0.3,
        roughness=0.5,
        anisotropic=0.6,
        coat_weight=0.5,
        coat_roughness=0.3,
        sheen_weight=0.5,
        diffuse_roughness=0.4,
    ),
)  # fmt: skip


def smooth(material: Material) -> Material:
    return dataclasses.replace(material, name=f"smooth {material.name}", roughness=0.0, coat_roughness=0.0)


def names(materials) -> list[str]:
    return [material.name.replace(" ", "_") for material in materials]


def material_scene(*materials: Material, textures=(), layers: int = 1) -> Scene:
    """A ball of the first of materials above a floor, under a lamp and a sky; the others are its parts."""
    ball = scenes.sphere(0.8, rows=12)
    floor = scenes.quad(4.0)
    corners = ball.positions[ball.triangles]
    uvs = np.stack([corners[..., 0] * 0.7 + 0.2 * corners[..., 2], corners[..., 2] * 0.6 - 0.1], axis=-1)
    ball = dataclasses.replace(ball, uvs=np.stack([uvs * (1 + i) for i in range(layers)]).astype(np.float32))
    objects = [
        (floor, scenes.transform(), [scenes.WHITE]),
        (ball, scenes.transform((0, 0, 0.9), scenes.rotation("y", 0.4) * [1.0, 1.2, 0.9]), [materials[0]]),
    ]
    scene = scenes.build(
        objects,
        scenes.camera((0.5, -3.0, 1.8), (0, 0, 0.7)),
        [scenes.lamp(LightKind.RECTANGLE, eye=(1.5, -1.0, 2.5), target=(0, 0, 0.7))],
        textures=textures,
        world=World((0.3, 0.4, 0.5)),
    )
    return dataclasses.replace(scene, materials=(scene.materials[0], *materials))


def noise_texture(seed: int = 3, size: int = 8, low: float = 0.0, high: float = 1.0) -> Texture:
    values = np.random.default_rng(seed).uniform(low, high, (size, size, 4)).astype(np.float32)
    return Texture("noise", values, False, Interpolation.CUBIC)


def normal_texture(size: int = 16) -> Texture:
    """Bumps of up to 40 degrees."""
    values = np.random.default_rng(5).uniform(0.2, 0.8, (size, size, 4)).astype(np.float32)
    values[..., 2] = 1.0
    return Texture("bumps", values, False)


def with_tangents(scene: Scene, layer: int) -> Scene:
    """The ball with tangents of its own, which are not those of its UVs, a few of them missing."""
    floor, ball = scene.meshes
    random = np.random.default_rng(6)
    tangents = random.normal(size=(len(ball.triangles), 3, 4)).astype(np.float32)
    tangents[..., 3] = np.sign(tangents[:, :1, 3])
    tangents[:20, :, :3] = 0
    return dataclasses.replace(scene, meshes=(floor, dataclasses.replace(ball, tangents=tangents, tangent_layer=layer)))


def curtain(planes: int, material: Material, emission: float = 1.0, size: float = 4.0) -> Scene:
    """Planes of a material one behind the other, before a wall that shines evenly and under a sun."""
    wall = Material("wall", kind=MaterialKind.DIFFUSE, base_color=(0.0, 0.0, 0.0), emission=(emission,) * 3)
    upright = scenes.rotation("x", np.pi / 2)
    sheet = scenes.quad(size)
    objects = [(sheet, scenes.transform((0, 0.01 * i, 0), upright), [material]) for i in range(planes)]
    objects.append((scenes.quad(size), scenes.transform((0, 1.0, 0), upright), [wall]))
    sun = scenes.lamp(LightKind.SUN, eye=(0, -3, 0), target=(0, 0, 0), size=(0.0, 0.0))
    return scenes.build(objects, scenes.camera((0, -2.0, 0), (0, 0, 0), half_width=0.3), [sun])


def varied_scenes() -> dict[str, Scene]:
    """What lies beyond constants: maps, normal maps, mixes, alpha."""
    bumpy = {"normal": TextureMap(0, uv_layer=1)}
    plastic = Material("bumpy", base_color=(0.6, 0.3, 0.2), roughness=0.4, maps=bumpy)
    matte = Material("bumpy matte", kind=MaterialKind.DIFFUSE, maps=bumpy, normal_strength=0.6)
    mapped = Material(
        "mapped",
        anisotropic=0.5,
        tangent_uv_layer=0,
        coat_weight=0.1,
        sheen_weight=0.1,
        maps={
            "base_color": TextureMap(0),
            "roughness": TextureMap(0, 1),
            "metallic": TextureMap(0, 2),
            "coat_weight": TextureMap(0, 3),
            "ior": TextureMap(1, 0),
            "anisotropic_rotation": TextureMap(0, 0),
            "sheen_weight": TextureMap(0, 1, 1),
        },
    )
    glass = Material("glass", kind=MaterialKind.GLASS, roughness=0.2)
    red = Material("red", kind=MaterialKind.DIFFUSE, base_color=(0.8, 0.1, 0.1))
    glow = Material("glow", emission=(2.0, 1.0, 0.5), base_color=(0.1, 0.1, 0.1))
    mix = Material("mix", kind=MaterialKind.MIX, first=2, second=3, factor=0.3)
    lit_coat = dataclasses.replace(COAT, emission=(1.0, 0.7, 0.4), coat_tint=(0.9, 0.5, 0.3), sheen_weight=0.5)
    mirror = material_scene(Material("mirror", metallic=1.0, roughness=0.1), textures=[noise_texture()])
    backdrop = dataclasses.replace(mirror.world, backdrop_radiance=(0.9, 0.8, 0.2), backdrop_environment=0)
    return {
        "backdrop": dataclasses.replace(mirror, world=backdrop),
        "lit_coat": material_scene(lit_coat),
        "bumpy": material_scene(plastic, textures=[normal_texture()], layers=2),
        "bumpy_tangents": with_tangents(material_scene(plastic, textures=[normal_texture()], layers=2), 1),
        "bumpy_other_tangents": with_tangents(material_scene(matte, textures=[normal_texture()], layers=2), 0),
        "brushed_tangents": with_tangents(
            material_scene(Material("brushed", metallic=1.0, anisotropic=0.8, tangent_uv_layer=0)), 0
        ),
        "bumpy_below_coat": material_scene(
            dataclasses.replace(COAT, maps=bumpy, roughness=0.4), textures=[normal_texture()], layers=2
        ),
        "bumpy_below_smooth_coat": material_scene(
            dataclasses.replace(COAT, maps=bumpy, coat_roughness=0.0, emission=(0.2, 0.1, 0.1)),
            textures=[normal_texture()],
            layers=2,
        ),
        "bumpy_coat": material_scene(
            dataclasses.replace(COAT, maps=bumpy, coat_normal_mapped=True), textures=[normal_texture()], layers=2
        ),
        "bumpy_matte": material_scene(matte, textures=[normal_texture()], layers=2),
        "mapped": material_scene(mapped, textures=[noise_texture(), noise_texture(4, low=1.0, high=2.0)], layers=2),
        "mix": material_scene(mix, glass, red),
        "fresnel_mix": material_scene(dataclasses.replace(mix, factor_fresnel_ior=1.5), red, glass),
        "facing_mix": material_scene(dataclasses.replace(mix, factor_facing_blend=0.7), red, glass),
        "sum": material_scene(Material("sum", kind=MaterialKind.ADD, first=2, second=3), red, glow),
        "alpha": material_scene(Material("half there", base_color=(0.7, 0.3, 0.2), alpha=0.4)),
        "cut_out": material_scene(
            Material("cut out", emission=(1.0, 0.5, 0.2), maps={"alpha": TextureMap(0, 1)}), textures=[noise_texture()]
        ),
        "transparent_mix": material_scene(
            dataclasses.replace(mix, factor_facing_blend=0.4),
            glass,
            Material("film", kind=MaterialKind.TRANSPARENT, base_color=(0.9, 0.5, 0.3)),
        ),
        "nested": material_scene(
            Material("nested", kind=MaterialKind.MIX, first=2, second=3, maps={"factor": TextureMap(0)}),
            Material("sum", kind=MaterialKind.ADD, first=4, second=5),
            red,
            glass,
            glow,
            textures=[noise_texture()],
        ),
    }
