# SPDX-License-Identifier: Apache-2.0
"""Images and node trees as the textures of materials."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_image, add_material, add_mesh, export, link_texture, principled, validate
from node_cycles import NodeBench
from svgf.scene import Extension, Interpolation

RANDOM = np.random.default_rng(7)
COLORFUL = np.concatenate([RANDOM.random((5, 7, 3)), np.ones((5, 7, 1))], 2)


def add_quad(material=None, uvs=((0, 0), (1, 0), (1, 1), (0, 1)), name="UVMap"):
    quad = add_mesh()
    add_uv_map(quad, name, uvs)
    if material is not None:
        quad.data.materials.append(material)
    return quad


def add_uv_map(quad, name, uvs) -> None:
    quad.data.uv_layers.new(name=name).uv.foreach_set("vector", np.float32(uvs).ravel())


def new(material, kind, **settings):
    node = material.node_tree.nodes.new(kind)
    for name, value in settings.items():
        setattr(node, name, value)
    return node


def connect(material, start, end) -> None:
    material.node_tree.links.new(start, end)


def exported(material):
    add_quad(material)
    scene = export()
    validate(scene)
    return scene, scene.materials[0]


def only_warning(scene) -> str:
    (warning,) = scene.warnings
    return warning


@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "CLIP", "MIRROR"])
@pytest.mark.parametrize("interpolation", ["Linear", "Closest", "Cubic"])
def test_images_as_cycles_reads_them(interpolation, extension):
    bench = NodeBench()
    image = bench.add("ShaderNodeTexImage", image=add_image("Image", COLORFUL))
    image.interpolation, image.extension = interpolation, extension
    bench.link(bench.vector(bench.spread(bench.u, -1.3, 1.9), bench.spread(bench.v, -1.7, 1.4), 0.0), image.inputs[0])
    expected, (actual, found) = bench.cycles(image.outputs[0]), bench.evaluated(image.outputs[0])
    assert not found
    assert np.mean(np.abs(actual - expected).max(axis=1) > 2e-3) <= 0.02


@pytest.mark.parametrize("output", ["Color", "Alpha"])
@pytest.mark.parametrize("alpha_mode", ["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"])
@pytest.mark.parametrize("both", [False, True])
def test_alpha_as_cycles_reads_it(alpha_mode, output, both):
    pixels = COLORFUL.copy()
    pixels[..., 3] = RANDOM.uniform(0.2, 1, pixels.shape[:2])
    bench = NodeBench()
    image = bench.add("ShaderNodeTexImage", image=add_image("Image", pixels))
    image.image.alpha_mode = alpha_mode
    image.image.reload()  # the pixels of the packed file are read anew
    bench.link(bench.uv, image.inputs[0])
    if both:
        add = bench.add("ShaderNodeMath")
        bench.link(image.outputs["Color"], add.inputs[0])
        bench.link(image.outputs["Alpha"], add.inputs[1])
        socket = add.outputs[0]
    else:
        socket = image.outputs[output]
    assert np.allclose(bench.evaluated(socket)[0], bench.cycles(socket), atol=3e-3)


@pytest.mark.parametrize(
    "color_space",
    [
        "sRGB",
        "Non-Color",
        "Linear Rec.709",
        "Linear Rec.2020",
        "Linear DCI-P3 D65",
        "Linear CIE-XYZ D65",
        "Display P3",
        "Rec.1886",
        "Rec.2020",
        "ACEScg",
        "ACES2065-1",
    ],
)
def test_color_spaces_as_cycles_reads_them(color_space):
    bench = NodeBench()
    image = bench.add("ShaderNodeTexImage", image=add_image("Image", COLORFUL, color_space), interpolation="Closest")
    bench.link(bench.uv, image.inputs[0])
    expected, (actual, found) = bench.cycles(image.outputs[0]), bench.evaluated(image.outputs[0])
    assert not found
    # Cycles keeps such images as bytes or half floats.
    assert np.abs(actual - np.clip(expected, actual.min(), None)).max() < 0.012


def test_color_spaces_that_are_not_known_are_named():
    material = add_material()
    link_texture(material, add_image("Log", COLORFUL, "Filmic Log"))
    scene, _ = exported(material)
    assert only_warning(scene) == (
        'Image "Log": colour space "Filmic Log" is not supported yet; the image is read as sRGB.'
    )


def test_associated_alpha():
    """Colours are stored times alpha, and divided again where the node's Alpha is used, as in Cycles."""
    material = add_material()
    node = link_texture(material, add_image("Half", np.full((2, 2, 4), (0.5, 0.5, 0.5, 0.4))))
    scene, _ = exported(material)
    assert (scene.textures[0].pixels[..., :3] == 51).all() and not scene.textures[0].associated_alpha
    connect(material, node.outputs["Alpha"], principled(material).inputs["Alpha"])
    scene = export()
    assert scene.textures[0].associated_alpha and len(scene.textures) == 1 and not scene.warnings
    assert scene.materials[0].maps["alpha"].channel == 3


@pytest.mark.parametrize("both", [False, True])
def test_missing_images(both):
    material = add_material()
    image = bpy.data.images.new("Gone", 1, 1)
    image.source, image.filepath = "FILE", "//nowhere.png"
    node = link_texture(material, image)
    if both:
        connect(material, node.outputs["Alpha"], principled(material).inputs["Alpha"])
    scene, exported_material = exported(material)
    assert exported_material.base_color == (1, 0, 1) and exported_material.alpha == 1 and not scene.textures
    assert only_warning(scene) == 'Image "Gone": the image cannot be read; magenta is used instead, as Blender does.'


def test_a_node_without_an_image_is_magenta():
    material = add_material()
    link_texture(material, None)
    scene, exported_material = exported(material)
    assert exported_material.base_color == (1, 0, 1) and not scene.warnings


def test_huge_images_are_reduced(monkeypatch):
    material = add_material()
    pixels = np.zeros((1, 32768, 4), np.float32)
    pixels[0, 1::2] = 1
    link_texture(material, add_image("Long", pixels, "Non-Color"))
    scene, _ = exported(material)
    assert scene.textures[0].pixels.shape == (1, 16384, 4) and (scene.textures[0].pixels == 128).all()
    assert only_warning(scene) == (
        'Image "Long": 32768 x 1 pixels are more than 16384 on a side; the image is reduced to fit.'
    )


def test_images_on_disk_and_generated(tmp_path):
    disk = add_image("Disk", COLORFUL)
    disk.filepath_raw, disk.file_format = str(tmp_path / "disk.png"), "PNG"
    disk.unpack(method="REMOVE")
    disk.save()
    disk.source = "FILE"
    generated = bpy.data.images.new("Grid", 8, 4)
    generated.generated_type = "COLOR_GRID"
    quad = add_quad()
    for image in (disk, generated):
        link_texture(add_material(image.name, quad), image)
    scene = export()
    assert [texture.pixels.shape for texture in scene.textures] in ([(5, 7, 4)], [(5, 7, 4), (4, 8, 4)])
    assert np.array_equal(scene.textures[0].pixels, np.rint(COLORFUL * 255)) and not scene.warnings


def test_channels_need_no_bake():
    """Packed metallic and roughness, a grey image for a number."""
    from svgf_blender.export import baking

    material = add_material()
    node = link_texture(material, add_image("Packed", COLORFUL, "Non-Color"))
    separate = new(material, "ShaderNodeSeparateColor")
    shader = principled(material)
    connect(material, node.outputs["Color"], separate.inputs[0])
    connect(material, separate.outputs["Green"], shader.inputs["Roughness"])
    connect(material, separate.outputs["Blue"], shader.inputs["Metallic"])
    gray = np.repeat(COLORFUL[..., :1], 4, 2)
    link_texture(material, add_image("Gray", gray, "Non-Color"), "Coat Weight")
    bakes = baking.cache.bakes
    scene, exported_material = exported(material)
    maps = exported_material.maps
    assert (maps["roughness"].texture, maps["roughness"].channel) == (maps["base_color"].texture, 1)
    assert (maps["metallic"].texture, maps["metallic"].channel) == (maps["base_color"].texture, 2)
    assert maps["coat_weight"].channel == 0 and len(scene.textures) == 2
    assert baking.cache.bakes == bakes and not scene.warnings


@pytest.mark.parametrize("kind", ["POINT", "TEXTURE", "VECTOR"])
def test_mappings_fold_into_the_transform(kind):
    material = add_material()
    node = link_texture(material, add_image("Image", COLORFUL))
    mapping = new(material, "ShaderNodeMapping", vector_type=kind)
    mapping.inputs["Rotation"].default_value = (0, 0, np.pi / 2)
    mapping.inputs["Scale"].default_value = (2, 4, 1)
    if kind != "VECTOR":
        mapping.inputs["Location"].default_value = (0.5, 0.25, 0)
    coordinates = new(material, "ShaderNodeTexCoord")
    connect(material, coordinates.outputs["UV"], mapping.inputs["Vector"])
    connect(material, mapping.outputs[0], node.inputs["Vector"])
    _, exported_material = exported(material)
    expected = {
        "POINT": (0, -4, 0.5, 2, 0, 0.25),
        "VECTOR": (0, -4, 0, 2, 0, 0),
        "TEXTURE": (0, 0.5, -0.125, -0.25, 0, 0.125),
    }[kind]
    assert exported_material.maps["base_color"].uv_transform == pytest.approx(expected, abs=1e-6)


def test_uv_maps_by_name():
    material = add_material()
    node = link_texture(material, add_image("Image", COLORFUL))
    uv_map = new(material, "ShaderNodeUVMap", uv_map="UVMap")
    connect(material, uv_map.outputs[0], node.inputs["Vector"])
    quad = add_quad(material)
    scene = export()
    assert scene.meshes[0].uvs.ndim == 3 and scene.materials[0].maps["base_color"].uv_layer == 0
    add_uv_map(quad, "Second", np.full((4, 2), 0.25))
    uv_map.uv_map = "Second"
    scene = export()
    validate(scene)
    assert scene.materials[0].maps["base_color"].uv_layer == 1
    assert scene.meshes[0].uvs.shape == (2, 2, 3, 2) and (scene.meshes[0].uvs[1] == 0.25).all()
    attribute = new(material, "ShaderNodeAttribute", attribute_name="Second")
    connect(material, attribute.outputs["Vector"], node.inputs["Vector"])
    assert export().materials[0].maps["base_color"].uv_layer == 1
    uv_map.uv_map = "Missing"  # reads as (0, 0), as in Cycles
    connect(material, uv_map.outputs[0], node.inputs["Vector"])
    scene = export()
    layer = scene.materials[0].maps["base_color"].uv_layer
    assert not scene.meshes[0].uvs[layer].any()
    connect(material, attribute.outputs["Vector"], node.inputs["Vector"])
    attribute.attribute_name = "Wear"
    assert 'node "Attribute" (Attribute) on "Vector" is not supported yet' in only_warning(export())


def test_meshes_without_uvs_are_named():
    material = add_material("Painted")
    link_texture(material, add_image("Image", COLORFUL))
    add_mesh("Bare").data.materials.append(material)
    scene = export()
    validate(scene)
    assert only_warning(scene) == (
        'Material "Painted": mesh "Bare" has no UV map; textures are read at (0, 0) there, as in Cycles.'
    )


def test_other_coordinates_and_projections_are_named():
    material = add_material()
    node = link_texture(material, add_image("Image", COLORFUL))
    node.projection = "BOX"
    connect(material, new(material, "ShaderNodeTexCoord").outputs["Object"], node.inputs["Vector"])
    warnings = "\n".join(exported(material)[0].warnings)
    assert 'object coordinates of node "Texture Coordinate" (Texture Coordinate) are not supported yet' in warnings
    assert "box projection of images is not supported yet" in warnings


def ramp_of(material, start, socket="Base Color"):
    ramp = new(material, "ShaderNodeValToRGB")
    ramp.color_ramp.elements[1].color = (1, 0.25, 0, 1)
    connect(material, start, ramp.inputs[0])
    connect(material, ramp.outputs[0], principled(material).inputs[socket])
    return ramp


def test_a_chain_on_an_image_is_baked_at_its_texels():
    material = add_material()
    node = new(material, "ShaderNodeTexImage", image=add_image("Image", COLORFUL, "Non-Color"), extension="MIRROR")
    invert = new(material, "ShaderNodeInvert")
    invert.inputs[0].default_value = 1
    connect(material, node.outputs[0], invert.inputs["Color"])
    connect(material, invert.outputs[0], principled(material).inputs["Base Color"])
    scene, _ = exported(material)
    (texture,) = scene.textures
    assert texture.extension is Extension.MIRROR and texture.interpolation is Interpolation.LINEAR
    linear = (texture.pixels[..., :3] / 255.0 + 0.055) / 1.055
    assert texture.srgb and np.allclose(linear**2.4, 1 - np.rint(COLORFUL[..., :3] * 255) / 255, atol=0.01)


def test_patterns_are_baked_over_the_uvs_in_use():
    material = add_material()
    checker, coordinates = new(material, "ShaderNodeTexChecker"), new(material, "ShaderNodeTexCoord")
    checker.inputs["Scale"].default_value = 2
    connect(material, coordinates.outputs["UV"], checker.inputs["Vector"])
    connect(material, checker.outputs["Color"], principled(material).inputs["Base Color"])
    add_quad(material, ((-0.5, 0), (1.5, 0), (1.5, 1), (-0.5, 1)))
    scene = export()
    (texture,) = scene.textures
    height, width = texture.pixels.shape[:2]
    assert (height, width) == (1024, 3072)
    assert scene.materials[0].maps["base_color"].uv_transform == pytest.approx((1 / 3, 0, 1 / 3, 0, 1, 0))
    # Two cells a square, and the one at the origin has the second colour.
    assert texture.pixels[10, 1024 + 10, 0] == pytest.approx(124, abs=1)
    assert texture.pixels[10, 1024 + 600, 0] == pytest.approx(231, abs=1) == texture.pixels[10, 1000, 0]


def test_bakes_are_made_once(monkeypatch):
    from svgf_blender.export import Exporter, baking

    material = add_material()
    noise, coordinates = new(material, "ShaderNodeTexNoise"), new(material, "ShaderNodeTexCoord")
    connect(material, coordinates.outputs["UV"], noise.inputs["Vector"])
    ramp = ramp_of(material, noise.outputs[0])
    add_quad(material)
    add_mesh("Other").data.materials.append(add_material("Plain"))
    graph, exporter = bpy.context.evaluated_depsgraph_get, Exporter()
    bakes = baking.cache.bakes
    first = exporter.export(graph())
    assert baking.cache.bakes == bakes + 1
    principled(material).inputs["Roughness"].default_value = 0.125
    records = exporter.counters.materials
    second = exporter.export(graph())
    assert baking.cache.bakes == bakes + 1 and second.textures[0] is first.textures[0]
    assert exporter.counters.materials == records + 1
    assert Exporter().export(graph()).textures[0] is first.textures[0]
    ramp.color_ramp.elements[0].color = (0, 0, 1, 1)
    assert exporter.export(graph()).textures[0] is not first.textures[0] and baking.cache.bakes == bakes + 2


def test_several_uv_maps_in_one_input_are_named():
    material = add_material()
    mix = new(material, "ShaderNodeMix", data_type="RGBA")
    for name, socket in (("UVMap", mix.inputs[6]), ("Second", mix.inputs[7])):
        noise, uv_map = new(material, "ShaderNodeTexNoise"), new(material, "ShaderNodeUVMap", uv_map=name)
        connect(material, uv_map.outputs[0], noise.inputs["Vector"])
        connect(material, noise.outputs["Color"], socket)
    connect(material, mix.outputs["Result"], principled(material).inputs["Base Color"])
    add_uv_map(add_quad(material), "Second", np.zeros((4, 2)))
    assert '"Base Color" depends on several UV maps ("Second", "UVMap")' in only_warning(export())


def test_emission_by_texture_and_strength():
    material = add_material(Emission_Strength=3.0)
    node = link_texture(material, add_image("Image", COLORFUL), "Emission Color")
    _, exported_material = exported(material)
    assert exported_material.emission == (3, 3, 3) and "emission" in exported_material.maps
    connect(material, node.outputs["Color"], principled(material).inputs["Emission Strength"])
    scene = export()
    assert scene.materials[0].emission == (1, 1, 1) and scene.materials[0].maps["emission"].texture == 0


def test_groups_reroutes_and_muted_nodes():
    """A group that inverts, one within the other, behind a reroute and a muted node."""
    inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    outer = bpy.data.node_groups.new("Outer", "ShaderNodeTree")
    for tree, kind in ((inner, "ShaderNodeInvert"), (outer, "ShaderNodeGroup")):
        tree.interface.new_socket("Color", in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
        start, node, end = (tree.nodes.new(name) for name in ("NodeGroupInput", kind, "NodeGroupOutput"))
        if tree is outer:
            node.node_tree = inner
        else:
            node.inputs[0].default_value = 1
        tree.links.new(start.outputs[0], node.inputs["Color"])
        tree.links.new(node.outputs[0], end.inputs[0])
    material = add_material()
    group, muted = new(material, "ShaderNodeGroup", node_tree=outer), new(material, "ShaderNodeGamma", mute=True)
    group.inputs[0].default_value = (0.25, 0.5, 1, 1)
    reroute = new(material, "NodeReroute")
    connect(material, group.outputs[0], muted.inputs[0])
    connect(material, muted.outputs[0], reroute.inputs[0])
    connect(material, reroute.outputs[0], principled(material).inputs["Base Color"])
    scene, exported_material = exported(material)
    assert exported_material.base_color == pytest.approx((0.75, 0.5, 0)) and not scene.warnings


def test_circles_of_links_are_survived():
    material = add_material(Base_Color=(0.25, 0.5, 1))
    first, second = new(material, "ShaderNodeGamma"), new(material, "ShaderNodeGamma")
    connect(material, first.outputs[0], second.inputs[0])
    connect(material, second.outputs[0], first.inputs[0])
    connect(material, second.outputs[0], principled(material).inputs["Base Color"])
    scene, exported_material = exported(material)
    assert np.isfinite(exported_material.base_color).all()


def test_normal_maps():
    material = add_material()
    node = new(material, "ShaderNodeTexImage", image=add_image("Normal", COLORFUL, "Non-Color"))
    normal_map = new(material, "ShaderNodeNormalMap")
    normal_map.inputs["Strength"].default_value = 0.75
    connect(material, node.outputs["Color"], normal_map.inputs["Color"])
    connect(material, normal_map.outputs[0], principled(material).inputs["Normal"])
    scene, exported_material = exported(material)
    assert exported_material.maps["normal"].texture == 0 and exported_material.normal_strength == 0.75
    assert np.array_equal(scene.textures[0].pixels, np.rint(COLORFUL * 255)) and not scene.warnings
    normal_map.space = "OBJECT"
    assert "object space of node" in only_warning(export())


def decoded(texture) -> np.ndarray:
    return texture.pixels[..., :3] * 2 - 1


def test_tangents_of_another_uv_map_are_named():
    material = add_material()
    node = link_texture(material, add_image("Bumps", COLORFUL, "Non-Color"))
    normal_map = new(material, "ShaderNodeNormalMap", uv_map="UVMap")
    connect(material, node.outputs["Color"], normal_map.inputs["Color"])
    connect(material, normal_map.outputs[0], principled(material).inputs["Normal"])
    quad = add_quad(material)
    assert not export().warnings
    add_uv_map(quad, "Second", np.full((4, 2), 0.25))
    normal_map.uv_map = "Second"
    assert "takes its tangents of another UV map" in only_warning(export())


@pytest.mark.parametrize("invert", [False, True])
def test_bumps_are_baked_to_normal_maps(invert):
    """A plane that rises by a metre a UV, over 2 metres a UV, has a slope of one half."""
    material = add_material()
    bump, coordinates = new(material, "ShaderNodeBump", invert=invert), new(material, "ShaderNodeTexCoord")
    separate = new(material, "ShaderNodeSeparateXYZ")
    bump.inputs["Distance"].default_value = 1
    connect(material, coordinates.outputs["UV"], separate.inputs[0])
    connect(material, separate.outputs["X"], bump.inputs["Height"])
    connect(material, bump.outputs[0], principled(material).inputs["Normal"])
    scene, exported_material = exported(material)
    normals = decoded(scene.textures[exported_material.maps["normal"].texture])
    slope = 0.5 if invert else -0.5
    assert np.allclose(normals, np.array([slope, 0, 1]) / np.sqrt(1.25), atol=2e-3) and not scene.warnings


def test_displacement_as_bumps():
    material = add_material()
    displacement, coordinates = new(material, "ShaderNodeDisplacement"), new(material, "ShaderNodeTexCoord")
    separate = new(material, "ShaderNodeSeparateXYZ")
    displacement.inputs["Scale"].default_value = 2
    connect(material, coordinates.outputs["UV"], separate.inputs[0])
    connect(material, separate.outputs["Y"], displacement.inputs["Height"])
    output = material.node_tree.get_output_node("CYCLES")
    connect(material, displacement.outputs[0], output.inputs["Displacement"])
    scene, exported_material = exported(material)
    normals = decoded(scene.textures[exported_material.maps["normal"].texture])
    assert np.allclose(normals, np.array([0, -1, 1]) / np.sqrt(2), atol=2e-3) and not scene.warnings
    material.displacement_method = "DISPLACEMENT"
    assert "it bends the normals alone" in only_warning(export())


@pytest.mark.parametrize("strength", [1.0, 0.6])
def test_bumps_as_cycles_bends_normals(strength):
    """Baked by Cycles to a tangent-space normal map of the same plane."""
    bench = NodeBench()
    bump, gradient = bench.add("ShaderNodeBump"), bench.add("ShaderNodeTexGradient", gradient_type="QUADRATIC")
    diffuse = bench.add("ShaderNodeBsdfDiffuse")
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = strength, 0.7
    bench.link(bench.uv, gradient.inputs[0])
    bench.link(gradient.outputs["Fac"], bump.inputs["Height"])
    bench.link(bump.outputs[0], diffuse.inputs["Normal"])
    expected = bench.cycles_normals(diffuse.outputs[0])
    scene = export()
    normal_map = scene.textures[scene.materials[0].maps["normal"].texture].pixels[..., :3] * 2 - 1
    side = len(normal_map)
    x, y = (np.clip(bench.points[:, :2].T * side, 0, side - 1)).astype(int)
    # Cycles bakes slopes over a tenth of a texel of a small picture, in single precision.
    assert np.abs(normal_map[y, x] - expected).max() < 0.01


def test_views_read_only_the_materials_that_changed():
    from svgf_blender.export import Exporter
    from svgf_blender.export.changes import Changes

    material = add_material("Baked")
    noise, coordinates = new(material, "ShaderNodeTexNoise"), new(material, "ShaderNodeTexCoord")
    connect(material, coordinates.outputs["UV"], noise.inputs["Vector"])
    ramp_of(material, noise.outputs[0])
    quad = add_quad(material)
    add_mesh("Other").data.materials.append(add_material("Plain", Thin_Film_Thickness=1.0))
    exporter, graph = Exporter(), bpy.context.evaluated_depsgraph_get
    camera = exporter.export(graph()).camera
    cache = exporter._materials
    first = exporter.export_view(graph(), camera, Changes())
    reads = cache.reads
    bpy.data.materials["Plain"].node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.125
    second = exporter.export_view(graph(), camera, Changes(materials=frozenset({"Plain"})))
    assert cache.reads == reads + 1 and second.materials[1].roughness == 0.125
    assert second.materials[0] is first.materials[0] and second.textures is first.textures
    assert second.warnings == first.warnings and first.warnings
    # UVs that leave the square need another bake, though no material has changed.
    quad.data.uv_layers[0].uv.foreach_set("vector", np.float32([0, 0, 2, 0, 2, 1, 0, 1]))
    quad.data.update()
    third = exporter.export_view(graph(), camera, Changes(geometry=frozenset({quad.name_full})))
    assert cache.reads == reads + 2 and third.textures[0] is not second.textures[0]


def test_changes_of_materials():
    """What Blender reports of edits: the tree alone for a colour ramp, a group without its users."""
    from svgf_blender.export.changes import find_changes

    material = add_material("Edited")
    ramp, group = new(material, "ShaderNodeValToRGB"), bpy.data.node_groups.new("Group", "ShaderNodeTree")
    gamma = group.nodes.new("ShaderNodeGamma")
    new(material, "ShaderNodeGroup", node_tree=group)
    add_quad(material)
    seen = []

    def changes():
        seen.clear()
        bpy.context.view_layer.update()
        return seen[-1].materials

    def report(scene, depsgraph):
        seen.append(find_changes(depsgraph.updates))

    bpy.app.handlers.depsgraph_update_post.append(report)
    try:
        bpy.context.view_layer.update()
        principled(material).inputs["Roughness"].default_value = 0.25
        assert changes() == {"Edited"}
        ramp.color_ramp.elements[0].color = (1, 0, 0, 1)
        assert changes() is None
        gamma.inputs["Gamma"].default_value = 2
        assert changes() is None
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(report)
