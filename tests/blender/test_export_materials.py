# SPDX-License-Identifier: Apache-2.0
"""Shader nodes as Principled BSDF inputs: exact where possible, and named where not."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_image, add_material, add_mesh, add_shader, export, link_texture, principled, validate
from svgf.scene import Extension, Interpolation, Material


def exported(material):
    """The scene of a quad with a material, and that material."""
    quad = add_mesh()
    quad.data.uv_layers.new(name="UVMap")
    quad.data.materials.append(material)
    scene = export()
    validate(scene)
    return scene, scene.materials[0]


def only_warning(scene) -> str:
    (warning,) = scene.warnings
    return warning


def test_principled_constants():
    values = {
        "Base_Color": (0.1, 0.2, 0.3),
        "Metallic": 0.25,
        "Roughness": 0.75,
        "IOR": 1.33,
        "Transmission_Weight": 0.5,
        "Specular_IOR_Level": 0.4,
        "Specular_Tint": (0.9, 0.8, 0.7),
        "Emission_Color": (1, 0.5, 0.25),
        "Emission_Strength": 8.0,
    }
    scene, material = exported(add_material("Paint", **values))
    assert material.name == "Paint" and not material.maps
    assert np.allclose(material.base_color, (0.1, 0.2, 0.3))
    assert (material.metallic, material.roughness, material.ior) == pytest.approx((0.25, 0.75, 1.33))
    assert (material.transmission, material.specular_ior_level) == pytest.approx((0.5, 0.4))
    assert np.allclose(material.specular_tint, (0.9, 0.8, 0.7)) and np.allclose(material.emission, (8, 4, 2))
    assert not scene.warnings


def test_defaults_are_blenders():
    _, material = exported(add_material("New"))
    assert material.base_color == pytest.approx(Material.base_color) and material.ior == pytest.approx(Material.ior)
    assert (material.metallic, material.roughness, material.transmission, material.specular_ior_level) == (
        0,
        0.5,
        0,
        0.5,
    )
    assert material.emission == (0, 0, 0)


def test_no_material_and_empty_slot():
    quad = add_mesh()
    assert export().materials == (Material(),)
    quad.data.materials.append(None)
    assert export().materials == (Material(),)


def test_values_out_of_range_are_clamped():
    scene, material = exported(add_material("Odd", Base_Color=(2, -1, 0.5), IOR=1.0))
    assert material.base_color == (1, 0, 0.5)
    socket = principled(bpy.data.materials["Odd"]).inputs["IOR"]
    node = bpy.data.materials["Odd"].node_tree.nodes.new("ShaderNodeValue")
    node.outputs[0].default_value = 0.5
    bpy.data.materials["Odd"].node_tree.links.new(node.outputs[0], socket)
    scene = export()
    assert scene.materials[0].ior == 1 and "an IOR of 0.5 is not supported" in only_warning(scene)


def test_constants_from_nodes_and_reroutes():
    material = add_material()
    tree, shader = material.node_tree, principled(material)
    rgb, value, reroute = (tree.nodes.new(kind) for kind in ("ShaderNodeRGB", "ShaderNodeValue", "NodeReroute"))
    rgb.outputs[0].default_value = (0.3, 0.6, 0.9, 1)
    value.outputs[0].default_value = 0.125
    tree.links.new(rgb.outputs[0], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], shader.inputs["Base Color"])
    tree.links.new(value.outputs[0], shader.inputs["Roughness"])
    scene, material = exported(material)
    assert np.allclose(material.base_color, (0.3, 0.6, 0.9)) and material.roughness == 0.125
    assert not scene.warnings


CHECKER = np.zeros((2, 3, 4))
CHECKER[..., 3] = 1
CHECKER[0, 0, :3] = 0.5
CHECKER[1, 2, :3] = (1, 0, 0)


@pytest.mark.parametrize(
    ("color_space", "is_float", "srgb"),
    [("sRGB", False, True), ("Non-Color", False, False), ("Linear Rec.709", True, False)],
)
def test_base_color_texture(color_space, is_float, srgb):
    material = add_material()
    node = link_texture(material, add_image("Checker", CHECKER, color_space, is_float))
    node.interpolation, node.extension = "Closest", "MIRROR"
    scene, material = exported(material)
    (texture,) = scene.textures
    assert material.maps["base_color"].texture == 0 and texture.srgb is srgb
    assert texture.interpolation is Interpolation.CLOSEST and texture.extension is Extension.MIRROR
    assert texture.pixels.shape == (2, 3, 4) and texture.pixels.dtype == (np.float32 if is_float else np.uint8)
    expected = CHECKER if is_float else np.rint(CHECKER * 255)
    assert np.allclose(texture.pixels, expected, atol=1e-6) and not scene.warnings


def test_textures_on_disk_and_shared_by_materials(tmp_path):
    image = add_image("Checker", CHECKER)
    image.filepath_raw, image.file_format = str(tmp_path / "checker.png"), "PNG"
    image.save()
    bpy.data.images.remove(image)
    image = bpy.data.images.load(str(tmp_path / "checker.png"))
    quad = add_mesh()
    quad.data.uv_layers.new()
    for name in ("A", "B"):
        link_texture(add_material(name, quad), image)
    quad.data.materials.append(bpy.data.materials["A"])
    other = add_mesh("Other")
    other.data.materials.append(bpy.data.materials["B"])
    scene = export()
    assert len(scene.materials) == 2 and len(scene.textures) == 1
    assert np.array_equal(scene.textures[0].pixels, np.rint(CHECKER * 255))


@pytest.mark.parametrize(("uses_alpha", "expected"), [(False, 51), (True, 128)])
def test_alpha_of_the_image(uses_alpha, expected):
    """As measured in Cycles: colour times alpha in the image's encoding, unless the node's Alpha is used."""
    material = add_material()
    node = link_texture(material, add_image("Half", np.full((2, 2, 4), (0.5, 0.5, 0.5, 0.4))))
    if uses_alpha:
        material.node_tree.links.new(node.outputs["Alpha"], principled(material).inputs["Alpha"])
    scene, _ = exported(material)
    assert (scene.textures[0].pixels[..., :3] == expected).all()
    assert any("alpha is not supported yet" in warning for warning in scene.warnings) == uses_alpha


def test_missing_image():
    material = add_material()
    image = bpy.data.images.new("Gone", 1, 1)
    image.source, image.filepath = "FILE", "//nowhere.png"
    link_texture(material, image)
    scene, exported_material = exported(material)
    assert exported_material.base_color == (1, 0, 1) and not scene.textures
    assert only_warning(scene) == 'Image "Gone": the image cannot be read; magenta is used instead, as Blender does.'


def test_texture_coordinates():
    material = add_material()
    node = link_texture(material, add_image())
    tree = material.node_tree
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(coordinates.outputs["UV"], node.inputs["Vector"])
    scene, _ = exported(material)
    assert not scene.warnings
    tree.links.new(coordinates.outputs["Object"], node.inputs["Vector"])
    node.projection, node.interpolation = "BOX", "Cubic"
    warnings = "\n".join(export().warnings)
    assert 'node "Texture Coordinate" (Texture Coordinate) for texture coordinates is not supported yet' in warnings
    assert "box projection of images is not supported yet" in warnings
    assert "cubic image interpolation is not supported yet" in warnings


@pytest.mark.parametrize(
    ("kind", "inputs", "expected"),
    [
        (
            "ShaderNodeBsdfDiffuse",
            {"Color": (0.1, 0.2, 0.3)},
            Material(base_color=(0.1, 0.2, 0.3), roughness=1, specular_ior_level=0),
        ),
        (
            "ShaderNodeBsdfGlass",
            {"Color": (1, 1, 1), "Roughness": 0.25, "IOR": 1.5},
            Material(base_color=(1, 1, 1), roughness=0.25, transmission=1),
        ),
        (
            "ShaderNodeBsdfAnisotropic",
            {"Color": (1, 1, 1), "Roughness": 0.25},
            Material(base_color=(1, 1, 1), metallic=1, roughness=0.25),
        ),
        (
            "ShaderNodeEmission",
            {"Color": (1, 0.5, 0), "Strength": 4.0},
            Material(base_color=(0, 0, 0), roughness=1, specular_ior_level=0, emission=(4, 2, 0)),
        ),
    ],
)
def test_other_shaders_that_are_exact(kind, inputs, expected):
    material = add_material()
    add_shader(material, kind, **inputs)
    scene, exported_material = exported(material)
    for name in ("base_color", "metallic", "roughness", "ior", "transmission", "specular_ior_level", "emission"):
        assert getattr(exported_material, name) == pytest.approx(getattr(expected, name)), name
    assert not scene.warnings


def test_nothing_at_the_output_is_black():
    material = add_material()
    material.node_tree.links.clear()
    scene, exported_material = exported(material)
    assert exported_material.base_color == (0, 0, 0) and exported_material.specular_ior_level == 0
    assert not scene.warnings


def test_surface_plus_emission_is_exact():
    material = add_material(Base_Color=(0.5, 0.5, 0.5))
    tree = material.node_tree
    add, emission = tree.nodes.new("ShaderNodeAddShader"), tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 2
    emission.inputs["Color"].default_value = (1, 0, 0, 1)
    tree.links.new(emission.outputs[0], add.inputs[0])
    tree.links.new(principled(material).outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    scene, exported_material = exported(material)
    assert exported_material.base_color == (0.5, 0.5, 0.5) and exported_material.emission == (2, 0, 0)
    assert not scene.warnings


@pytest.mark.parametrize(("factor", "emits", "warned"), [(0.0, True, False), (1.0, False, False), (0.7, False, True)])
def test_mix_shader(factor, emits, warned):
    material = add_material()
    tree = material.node_tree
    mix, emission = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeEmission")
    mix.inputs[0].default_value = factor
    tree.links.new(emission.outputs[0], mix.inputs[1])
    tree.links.new(principled(material).outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    scene, exported_material = exported(material)
    assert any(exported_material.emission) == emits and bool(scene.warnings) == warned


LAYERS = {
    "Subsurface_Weight": "subsurface scattering",
    "Coat_Weight": "coat",
    "Sheen_Weight": "sheen",
    "Thin_Film_Thickness": "thin film",
    "Diffuse_Roughness": "diffuse roughness",
    "Anisotropic": "anisotropy",
}


@pytest.mark.parametrize("socket", LAYERS)
def test_layers_are_named(socket):
    scene, _ = exported(add_material("Fancy", **{socket: 0.5}))
    assert only_warning(scene) == f'Material "Fancy": {LAYERS[socket]} is not supported yet; it is left out.'


def test_sockets_without_effect_are_not_named():
    material = add_material("Plain")
    tree = material.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    for name in ("Coat Roughness", "Sheen Tint", "Emission Color", "Subsurface Radius"):
        tree.links.new(noise.outputs[0], principled(material).inputs[name])
    scene, _ = exported(material)
    assert not scene.warnings


def test_driven_sockets_are_named():
    material = add_material("Rough")
    tree, shader = material.node_tree, principled(material)
    link_texture(material, add_image(), "Roughness")
    ramp, normal_map = tree.nodes.new("ShaderNodeValToRGB"), tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(ramp.outputs[0], shader.inputs["Base Color"])
    tree.links.new(normal_map.outputs[0], shader.inputs["Normal"])
    shader.inputs["Roughness"].default_value = 0.3
    scene, exported_material = exported(material)
    assert exported_material.roughness == pytest.approx(0.3)
    assert set(scene.warnings) == {
        'Material "Rough": node "Image Texture" (Image Texture) on "Roughness" is not supported yet; '
        "the value of the socket is used instead.",
        'Material "Rough": node "Color Ramp" (Color Ramp) on "Base Color" is not supported yet; '
        "the value of the socket is used instead.",
        'Material "Rough": normal maps are not supported yet; the normals of the mesh are used instead.',
    }


def test_other_shaders_and_outputs_are_named():
    material = add_material("Odd")
    add_shader(material, "ShaderNodeBsdfToon")
    tree = material.node_tree
    output = tree.get_output_node("CYCLES")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    tree.links.new(tree.nodes.new("ShaderNodeDisplacement").outputs[0], output.inputs["Displacement"])
    warnings = "\n".join(exported(material)[0].warnings)
    assert 'Material "Odd": node "Toon BSDF" (Toon BSDF) is not supported yet' in warnings
    assert 'Material "Odd": volumes are not supported yet' in warnings
    assert 'Material "Odd": displacement is not supported yet' in warnings


def test_a_finding_of_many_materials_is_one_sentence():
    quad = add_mesh()
    for index in range(6):
        add_material(f"M{index}", quad, Coat_Weight=1.0)
    assert only_warning(export()) == 'Material "M0", "M1", "M2" and 3 more: coat is not supported yet; it is left out.'
