# SPDX-License-Identifier: Apache-2.0
"""A warning finds the objects that it is about."""

from __future__ import annotations

import bpy
import pytest
from blend import add_image, add_light, add_material, add_mesh, link_texture
from svgf_blender.export.findings import Finding, Findings
from svgf_blender.ui.culprits import find_objects, select


@pytest.fixture
def scene():
    for name in ("Left", "Right"):
        add_mesh(name).data.name = name
    material = add_material("Paint", bpy.data.objects["Right"])
    link_texture(material, add_image("Photo"))
    add_light("POINT", name="Lamp")
    bpy.context.view_layer.update()
    return bpy.context.view_layer


@pytest.mark.parametrize(
    ("id_type", "name", "expected"),
    [
        *(("OBJECT", "Left", "Left"), ("MATERIAL", "Paint", "Right"), ("IMAGE", "Photo", "Right")),
        *(("LIGHT", "Lamp", "Lamp"), ("MESH", "Left", "Left"), ("WORLD", "World", None), ("MATERIAL", "None", None)),
    ],
)
def test_objects_of_a_finding(scene, id_type, name, expected):
    found = [obj.name for obj in find_objects(Finding(id_type, (name,), "Text."), scene)]
    assert found == ([expected] if expected else [])


def test_image_in_a_group_that_holds_itself(scene):
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    node = group.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images["Photo"]
    material = add_material("Grouped", bpy.data.objects["Left"])
    material.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    found = find_objects(Finding("IMAGE", ("Photo",), "Text."), scene)
    assert {obj.name for obj in found} == {"Left", "Right"}
    assert [o.name for o in find_objects(Finding("NODETREE", ("Group",), "Text."), scene)] == ["Left"]


def test_selection(scene):
    right = bpy.data.objects["Right"]
    bpy.data.objects["Left"].select_set(True)
    select([right], scene)
    assert bpy.context.selected_objects == [right] and scene.objects.active == right


def test_findings_keep_the_data_blocks_that_their_sentences_name(scene):
    findings = Findings()
    for name in ("Left", "Right"):
        findings.add(bpy.data.objects[name], "this is not supported.")
    (finding,) = findings.found()
    assert (finding.id_type, finding.names) == ("OBJECT", ("Left", "Right"))
    assert findings.sentences() == ('Object "Left", "Right": this is not supported.',)


def test_operator_without_a_view(registered, scene):
    assert bpy.ops.svgf.select_culprit() == {"CANCELLED"}
