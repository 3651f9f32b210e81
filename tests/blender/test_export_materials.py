# SPDX-License-Identifier: Apache-2.0
"""Shader nodes as materials of a scene, and what is named where there is no counterpart."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_image, add_material, add_mesh, add_shader, export, link_texture, principled, validate
from svgf.scene import Extension, Interpolation, Material, MaterialKind, TextureMap


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
    assert material.base_color == (1, 0, 0.5) and not scene.warnings
    socket = principled(bpy.data.materials["Odd"]).inputs["IOR"]
    node = bpy.data.materials["Odd"].node_tree.nodes.new("ShaderNodeValue")
    node.outputs[0].default_value = -0.5
    bpy.data.materials["Odd"].node_tree.links.new(node.outputs[0], socket)
    assert 0 < export().materials[0].ior < 1e-4


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


def links(material):
    return material.node_tree.links.new


def new(material, kind, **settings):
    node = material.node_tree.nodes.new(kind)
    for name, value in settings.items():
        setattr(node, name, value)
    return node


def surface_socket(material):
    return material.node_tree.get_output_node("CYCLES").inputs["Surface"]


SHADERS = [
    ("ShaderNodeBsdfDiffuse", {"Color": (0.1, 0.2, 0.3), "Roughness": 0.25}, MaterialKind.DIFFUSE,
     {"base_color": (0.1, 0.2, 0.3), "diffuse_roughness": 0.25}),
    ("ShaderNodeBsdfGlass", {"Color": (1, 0.5, 1), "Roughness": 0.25, "IOR": 1.25}, MaterialKind.GLASS,
     {"base_color": (1, 0.5, 1), "roughness": 0.25, "ior": 1.25, "multiscatter": True}),
    ("ShaderNodeBsdfAnisotropic", {"Color": (1, 0.5, 1), "Roughness": 0.25, "Anisotropy": -0.5, "Rotation": 1.25},
     MaterialKind.GLOSSY, {"base_color": (1, 0.5, 1), "anisotropic": -0.5, "anisotropic_rotation": 0.25}),
    ("ShaderNodeBsdfRefraction", {"Color": (1, 0.5, 1), "Roughness": 0.0}, MaterialKind.REFRACTION,
     {"ior": 1.45, "multiscatter": False}),
    ("ShaderNodeBsdfTranslucent", {"Color": (0.1, 0.2, 0.3)}, MaterialKind.TRANSLUCENT,
     {"base_color": (0.1, 0.2, 0.3)}),
    ("ShaderNodeBsdfTransparent", {"Color": (0.1, 0.2, 0.3)}, MaterialKind.TRANSPARENT,
     {"base_color": (0.1, 0.2, 0.3)}),
    ("ShaderNodeBsdfMetallic", {"Base Color": (0.9, 0.6, 0.2), "Edge Tint": (1, 0.8, 0.5)}, MaterialKind.PRINCIPLED,
     {"metallic": 1, "base_color": (0.9, 0.6, 0.2), "specular_tint": (1, 0.8, 0.5)}),
    ("ShaderNodeEmission", {"Color": (1, 0.5, 0), "Strength": 4.0}, MaterialKind.DIFFUSE,
     {"base_color": (0, 0, 0), "emission": (4, 2, 0)}),
]  # fmt: skip


@pytest.mark.parametrize(("node", "inputs", "kind", "expected"), SHADERS)
def test_plain_shaders(node, inputs, kind, expected):
    material = add_material()
    add_shader(material, node, **inputs)
    scene, exported_material = exported(material)
    assert exported_material.kind is kind
    for name, value in expected.items():
        assert getattr(exported_material, name) == pytest.approx(value), name
    assert not scene.warnings


def test_conductors_by_their_indices():
    """Copper's reflectance facing the view, from its tabulated indices."""
    material = add_material()
    node = add_shader(material, "ShaderNodeBsdfMetallic")
    node.fresnel_type = "PHYSICAL_CONDUCTOR"
    node.inputs["IOR"].default_value = (0.271, 0.677, 1.316)
    node.inputs["Extinction"].default_value = (3.609, 2.625, 2.292)
    _, exported_material = exported(material)
    assert exported_material.base_color == pytest.approx((0.926, 0.721, 0.504), abs=2e-3)
    assert all(0.5 < part <= 1 for part in exported_material.specular_tint)


def test_unusual_distributions_are_named():
    material = add_material()
    node = add_shader(material, "ShaderNodeBsdfAnisotropic")
    node.distribution = "ASHIKHMIN_SHIRLEY"
    scene, _ = exported(material)
    assert "the Ashikhmin-Shirley distribution" in only_warning(scene) and "GGX is used" in only_warning(scene)


def test_all_layers_of_the_principled_bsdf():
    values = {
        "Coat_Weight": 0.5,
        "Coat_Roughness": 0.2,
        "Coat_IOR": 1.75,
        "Coat_Tint": (0.5, 0.25, 1),
        "Sheen_Weight": 0.25,
        "Sheen_Roughness": 0.75,
        "Sheen_Tint": (1, 0.5, 0.25),
        "Anisotropic": 0.5,
        "Anisotropic_Rotation": 0.125,
        "Diffuse_Roughness": 0.75,
        "Alpha": 0.5,
    }
    scene, material = exported(add_material("Rich", **values))
    for name, value in values.items():
        assert getattr(material, name.lower()) == pytest.approx(value), name
    assert not scene.warnings


def test_tangents_of_anisotropy():
    material = add_material(Anisotropic=0.5)
    tangent = new(material, "ShaderNodeTangent", direction_type="UV_MAP")
    links(material)(tangent.outputs[0], principled(material).inputs["Tangent"])
    assert exported(material)[1].tangent_uv_layer == 0
    tangent.direction_type, tangent.axis = "RADIAL", "X"
    scene = export()
    assert scene.materials[0].tangent_uv_layer == -1 and "they circle around the Z axis" in only_warning(scene)


@pytest.mark.parametrize("kind", ["ShaderNodeFresnel", "ShaderNodeLayerWeight"])
def test_normals_of_factors_are_named(kind):
    material = add_material()
    mix, factor = new(material, "ShaderNodeMixShader"), new(material, kind)
    links(material)(factor.outputs[0], mix.inputs[0])
    links(material)(mix.outputs[0], material.node_tree.get_output_node("CYCLES").inputs["Surface"])
    assert not exported(material)[0].warnings
    bump = new(material, "ShaderNodeBump")
    links(material)(bump.outputs[0], factor.inputs["Normal"])
    assert "a normal of its own of node" in only_warning(export())


def test_nothing_at_the_output_is_black():
    material = add_material()
    material.node_tree.links.clear()
    scene, exported_material = exported(material)
    assert exported_material.kind is MaterialKind.DIFFUSE and exported_material.base_color == (0, 0, 0)
    material.node_tree.nodes.clear()
    assert export().materials[0].base_color == (0, 0, 0)
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


def mixed(material, factor=0.5):
    """A Mix Shader of an Emission and the material's Principled BSDF."""
    mix, emission = new(material, "ShaderNodeMixShader"), new(material, "ShaderNodeEmission")
    mix.inputs[0].default_value = factor
    links(material)(emission.outputs[0], mix.inputs[1])
    links(material)(principled(material).outputs[0], mix.inputs[2])
    links(material)(mix.outputs[0], surface_socket(material))
    return mix


@pytest.mark.parametrize(("factor", "emits"), [(0.0, True), (1.0, False)])
def test_mix_shader_of_one_side(factor, emits):
    material = add_material()
    mixed(material, factor)
    scene, exported_material = exported(material)
    assert any(exported_material.emission) == emits and len(scene.materials) == 1 and not scene.warnings


def test_mix_shaders_nested_and_added():
    material = add_material("Nest")
    mix = mixed(material, 0.25)
    add, glass = new(material, "ShaderNodeAddShader"), new(material, "ShaderNodeBsdfGlass")
    links(material)(mix.outputs[0], add.inputs[0])
    links(material)(glass.outputs[0], add.inputs[1])
    links(material)(add.outputs[0], surface_socket(material))
    scene, top = exported(material)
    assert top.kind is MaterialKind.ADD and not scene.warnings
    inner, other = scene.materials[top.first], scene.materials[top.second]
    assert (inner.kind, inner.factor, other.kind) == (MaterialKind.MIX, 0.25, MaterialKind.GLASS)
    assert scene.materials[inner.first].emission == (1, 1, 1)
    assert scene.materials[inner.second].kind is MaterialKind.PRINCIPLED
    assert {part.name for part in scene.materials} == {"Nest"}


def test_mix_factors():
    material = add_material()
    mix = mixed(material)
    fresnel, weight = new(material, "ShaderNodeFresnel"), new(material, "ShaderNodeLayerWeight")
    fresnel.inputs["IOR"].default_value, weight.inputs["Blend"].default_value = 1.75, 0.75
    links(material)(fresnel.outputs[0], mix.inputs[0])
    assert exported(material)[1].factor_fresnel_ior == 1.75
    links(material)(weight.outputs["Fresnel"], mix.inputs[0])
    assert export().materials[0].factor_fresnel_ior == pytest.approx(4)
    links(material)(weight.outputs["Facing"], mix.inputs[0])
    scene = export()
    assert scene.materials[0].factor_facing_blend == 0.75 and scene.materials[0].factor_fresnel_ior == 0
    image = link_texture(material, add_image(color_space="Non-Color"))
    links(material)(image.outputs["Alpha"], mix.inputs[0])
    assert export().materials[0].maps["factor"] == TextureMap(0, channel=3)


def test_circles_and_endless_mixes_are_named():
    material = add_material("Loop")
    mix = mixed(material)
    for _ in range(20):
        outer = new(material, "ShaderNodeMixShader")
        links(material)(mix.outputs[0], outer.inputs[1])
        mix = outer
    links(material)(mix.outputs[0], surface_socket(material))
    scene, _ = exported(material)
    assert "more than 16 levels of mixed shaders" in only_warning(scene)
    first = next(node for node in material.node_tree.nodes if node.type == "MIX_SHADER")
    links(material)(mix.outputs[0], first.inputs[1])  # Blender marks a link of the circle as invalid
    validate(export())


APPROXIMATED = {
    "Subsurface_Weight": "subsurface scattering is not supported yet; diffuse reflection is used instead.",
    "Thin_Film_Thickness": "thin film is not supported yet; it is left out.",
}


@pytest.mark.parametrize("socket", APPROXIMATED)
def test_what_is_approximated_is_named(socket):
    scene, _ = exported(add_material("Fancy", **{socket: 0.5}))
    assert only_warning(scene) == f'Material "Fancy": {APPROXIMATED[socket]}'


def test_sockets_without_effect_are_not_named():
    material = add_material("Plain")
    tree = material.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    for name in ("Coat Roughness", "Sheen Tint", "Emission Color", "Subsurface Radius"):
        tree.links.new(noise.outputs[0], principled(material).inputs[name])
    scene, _ = exported(material)
    assert not scene.warnings


def test_nodes_that_ask_for_more_than_uvs_are_named():
    material = add_material("Rough")
    path, ramp = new(material, "ShaderNodeLightPath"), new(material, "ShaderNodeValToRGB")
    links(material)(path.outputs["Ray Length"], ramp.inputs[0])
    links(material)(ramp.outputs[0], principled(material).inputs["Base Color"])
    ramp.inputs[0].default_value = 1.0
    links(material)(path.outputs["Ray Depth"], principled(material).inputs["Roughness"])
    principled(material).inputs["Roughness"].default_value = 0.3
    scene, exported_material = exported(material)
    assert exported_material.roughness == pytest.approx(0.3) and exported_material.base_color == (1, 1, 1)
    text = "is not supported yet; the value of the socket is used instead."
    assert set(scene.warnings) == {
        f'Material "Rough": node "Light Path" (Light Path) on "Factor" {text}',
        f'Material "Rough": node "Light Path" (Light Path) on "Roughness" {text}',
    }


def test_other_shaders_and_outputs_are_named():
    material = add_material("Odd")
    add_shader(material, "ShaderNodeBsdfToon")
    tree = material.node_tree
    output = tree.get_output_node("CYCLES")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    tree.links.new(tree.nodes.new("ShaderNodeVectorDisplacement").outputs[0], output.inputs["Displacement"])
    warnings = "\n".join(exported(material)[0].warnings)
    assert 'Material "Odd": node "Toon BSDF" (Toon BSDF) is not supported yet' in warnings
    assert 'Material "Odd": volumes are not supported yet' in warnings
    assert 'node "Vector Displacement" (Vector Displacement) for displacement is not supported yet' in warnings


def test_a_finding_of_many_materials_is_one_sentence():
    quad = add_mesh()
    for index in range(6):
        add_material(f"M{index}", quad, Thin_Film_Thickness=1.0)
    text = "thin film is not supported yet; it is left out."
    assert only_warning(export()) == f'Material "M0", "M1", "M2" and 3 more: {text}'
