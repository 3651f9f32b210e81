# SPDX-License-Identifier: Apache-2.0
"""Nodes evaluated at export against the same nodes in Cycles."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="bpy is not installed: pip install svgf[blender]")

from node_cycles import NodeBench  # noqa: E402

# Of values up to a few units. Where a node jumps, the coordinates of a texel may fall on the other side of the jump.
TOLERANCE = 2e-4
JUMPS = 0.02


def compare(bench: NodeBench, socket, tolerance: float = TOLERANCE, jumps: float = JUMPS) -> None:
    expected = bench.cycles(socket)
    actual, found = bench.evaluated(socket)
    assert not found
    error = np.abs(actual - expected).max(axis=1) / np.maximum(1, np.abs(expected).max(axis=1))
    assert np.ptp(expected) > 0, "the case shows nothing"
    wrong = np.mean(error > tolerance)
    assert wrong <= jumps, f"{wrong:.1%} differ, by up to {error.max():.4g} at {error.argmax()}"


def node_case(kind: str, output: str | int = 0, inputs: dict | None = None, **settings):
    """An id of the settings, and the case."""
    name = "-".join([kind.removeprefix("ShaderNode"), *map(str, settings.values()), str(output)])
    return pytest.param(kind, output, inputs or {}, settings, id=name)


@pytest.fixture
def bench() -> NodeBench:
    return NodeBench()


def drive(bench: NodeBench, node, inputs: dict) -> None:
    """inputs: by name or number, a constant or one of the drivers below."""
    u, v = bench.u, bench.v
    drivers = {
        "u": lambda: u,
        "v": lambda: v,
        "signed u": lambda: bench.spread(u, -2.3, 2.7),
        "signed v": lambda: bench.spread(v, -1.9, 2.2),
        "wide": lambda: bench.vector(bench.spread(u, -1.3, 1.9), bench.spread(v, -1.7, 1.4), 0.37),
        "vector": lambda: bench.vector(bench.spread(v, -1.1, 1.6), 0.41, bench.spread(u, -0.7, 2.3)),
        "color": lambda: bench.vector(u, v, 0.3),
        "other color": lambda: bench.vector(bench.spread(v, 1, 0), bench.spread(u, 0.9, 0.2), u),
        "cells": lambda: snapped(bench),
    }
    for key, value in inputs.items():
        socket = next((s for s in node.inputs if s.identifier == key), None) or node.inputs[key]
        if isinstance(value, str):
            bench.link(drivers[value](), socket)
        else:
            socket.default_value = value


def snapped(bench: NodeBench):
    node = bench.add("ShaderNodeVectorMath", operation="FLOOR")
    bench.link(bench.vector(bench.spread(bench.u, 0.01, 8.01), bench.spread(bench.v, 0.01, 8.01), 3.0), node.inputs[0])
    return node.outputs[0]


BLENDS = (
    "MIX DARKEN MULTIPLY BURN LIGHTEN SCREEN DODGE ADD OVERLAY SOFT_LIGHT LINEAR_LIGHT DIFFERENCE EXCLUSION SUBTRACT"
    " DIVIDE HUE SATURATION COLOR VALUE"
).split()
MATH = (
    "ADD SUBTRACT MULTIPLY DIVIDE MULTIPLY_ADD POWER LOGARITHM SQRT INVERSE_SQRT ABSOLUTE EXPONENT MINIMUM MAXIMUM"
    " LESS_THAN GREATER_THAN SIGN COMPARE SMOOTH_MIN SMOOTH_MAX ROUND FLOOR CEIL TRUNC FRACT MODULO FLOORED_MODULO WRAP"
    " SNAP PINGPONG SINE COSINE TANGENT ARCSINE ARCCOSINE ARCTANGENT ARCTAN2 SINH COSH TANH RADIANS DEGREES"
).split()
VECTOR_MATH = (
    "ADD SUBTRACT MULTIPLY DIVIDE MULTIPLY_ADD CROSS_PRODUCT PROJECT REFLECT REFRACT FACEFORWARD DOT_PRODUCT DISTANCE"
    " LENGTH SCALE NORMALIZE ABSOLUTE POWER SIGN MINIMUM MAXIMUM FLOOR CEIL FRACTION MODULO WRAP SNAP SINE COSINE TANGENT"
).split()
SCALAR_VECTORS = {"DOT_PRODUCT", "DISTANCE", "LENGTH"}

COLOR_CASES = [
    *(
        node_case(
            "ShaderNodeMix",
            2,
            {"Factor_Float": 0.7, "A_Color": "color", "B_Color": "other color"},
            data_type="RGBA",
            blend_type=blend,
            clamp_result=clamp,
        )
        for blend, clamp in product(BLENDS, (False, True))
        if not clamp or blend in {"ADD", "SUBTRACT", "LINEAR_LIGHT"}
    ),
    node_case("ShaderNodeMix", 0, {"Factor_Float": "signed u", "A_Float": 0.2, "B_Float": "v"}, clamp_factor=True),
    node_case("ShaderNodeMix", 0, {"Factor_Float": "signed u", "A_Float": 0.2, "B_Float": "v"}, clamp_factor=False),
    node_case(
        "ShaderNodeMix",
        1,
        {"Factor_Vector": "color", "A_Vector": "vector", "B_Vector": "wide"},
        data_type="VECTOR",
        factor_mode="NON_UNIFORM",
    ),
    node_case(
        "ShaderNodeMix", 1, {"Factor_Float": "u", "A_Vector": "vector", "B_Vector": "wide"}, data_type="VECTOR"
    ),
    node_case("ShaderNodeMixRGB", 0, {"Fac": "u", "Color1": "color", "Color2": "other color"}, blend_type="SCREEN"),
    node_case("ShaderNodeGamma", 0, {"Color": "color", "Gamma": 2.2}),
    node_case("ShaderNodeInvert", 0, {"Fac": "v", "Color": "color"}),
    node_case("ShaderNodeBrightContrast", 0, {"Color": "color", "Bright": 0.1, "Contrast": 0.6}),
    node_case(
        "ShaderNodeHueSaturation", 0, {"Hue": 0.8, "Saturation": 1.4, "Value": 0.9, "Fac": "v", "Color": "color"}
    ),
    node_case("ShaderNodeRGBToBW", 0, {"Color": "color"}),
    *(
        node_case("ShaderNodeSeparateColor", output, {"Color": "other color"}, mode=mode)
        for mode, output in product(("RGB", "HSV", "HSL"), range(3))
    ),
    *(
        node_case("ShaderNodeCombineColor", 0, {"Red": "u", "Green": "v", "Blue": 0.6}, mode=mode)
        for mode in ("RGB", "HSV", "HSL")
    ),
    node_case("ShaderNodeSeparateXYZ", 2, {"Vector": "vector"}),
    *(
        node_case("ShaderNodeClamp", 0, {"Value": "signed u", "Min": low, "Max": 0.9}, clamp_type=kind)
        for kind, low in (("MINMAX", 0.3), ("RANGE", 1.2))
    ),
    *(
        node_case(
            "ShaderNodeMapRange",
            0,
            {"Value": "signed u", "From Min": -1.0, "From Max": 1.5, "To Min": 2.0, "To Max": 0.5, "Steps": 5.0},
            interpolation_type=kind,
            clamp=clamp,
        )
        for kind, clamp in product(("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"), (False, True))
    ),
    *(
        node_case(
            "ShaderNodeMapRange",
            1,
            {"Vector": "wide", "To_Min_FLOAT3": (0.1, 0.2, 0.3), "To_Max_FLOAT3": (2, 1, 3)},
            data_type="FLOAT_VECTOR",
            interpolation_type=kind,
        )
        for kind in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP")
    ),
    *(
        node_case(
            "ShaderNodeMapping",
            0,
            {"Vector": "wide", "Location": (0.3, 0.2, 0.1), "Rotation": (0.4, 0.5, 0.6), "Scale": (1.5, 2, 0.7)},
            vector_type=kind,
        )
        for kind in ("TEXTURE", "VECTOR", "NORMAL", "POINT")
    ),
    *(
        node_case(
            "ShaderNodeVectorRotate",
            0,
            {"Vector": "wide", "Center": (0.1, 0.2, 0.3), "Axis": (1, 2, 0.5), "Angle": "u", "Rotation": (0.4, 0.5, 1)},
            rotation_type=kind,
            invert=invert,
        )
        for kind, invert in (
            ("AXIS_ANGLE", False),
            ("X_AXIS", True),
            ("Y_AXIS", False),
            ("Z_AXIS", False),
            ("EULER_XYZ", False),
            ("EULER_XYZ", True),
        )
    ),
]
TEXTURE_CASES = [
    node_case("ShaderNodeTexChecker", 0, {"Vector": "wide", "Color1": (1, 0.5, 0, 1), "Scale": 3.0}),
    node_case("ShaderNodeTexChecker", 1, {"Vector": "wide", "Scale": 3.0}),
    node_case("ShaderNodeTexBrick", 0, {"Vector": "wide", "Bias": 0.1, "Mortar Smooth": 0.5, "Mortar Size": 0.06}),
    node_case("ShaderNodeTexBrick", 1, {"Vector": "wide", "Scale": 3.0}, offset_frequency=3, squash=0.6),
    *(
        node_case("ShaderNodeTexGradient", 1, {"Vector": "wide"}, gradient_type=kind)
        for kind in ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "SPHERICAL", "QUADRATIC_SPHERE", "RADIAL")
    ),
    *(
        node_case("ShaderNodeTexMagic", 0, {"Vector": "wide", "Scale": 2.0, "Distortion": 1.3}, turbulence_depth=depth)
        for depth in (0, 2, 5, 10)
    ),
    *(
        node_case("ShaderNodeTexWave", 1, {"Vector": "wide"}, bands_direction=axis, wave_profile=profile)
        for axis, profile in (("X", "SIN"), ("Y", "SAW"), ("DIAGONAL", "TRI"))
    ),
    *(
        node_case(
            "ShaderNodeTexWave",
            0,
            {"Vector": "wide", "Scale": 0.7, "Distortion": 2.0, "Detail": 2.5, "Phase Offset": 0.4},
            wave_type="RINGS",
            rings_direction=axis,
            wave_profile="TRI",
        )
        for axis in ("X", "Y", "Z", "SPHERICAL")
    ),
    *(
        node_case(
            "ShaderNodeTexNoise",
            output,
            {"Vector": "wide", "W": 0.7, "Scale": 3.0, "Detail": 2.6, "Roughness": 0.6, "Distortion": 0.8},
            noise_dimensions=dimensions,
        )
        for dimensions, output in product(("2D", "3D", "4D"), (0, 1))
    ),
    node_case("ShaderNodeTexNoise", 1, {"W": "signed u", "Scale": 3.0, "Distortion": 0.5}, noise_dimensions="1D"),
    node_case("ShaderNodeTexNoise", 0, {"Vector": "wide", "Detail": 3.0}, normalize=False),
    node_case("ShaderNodeTexNoise", 0, {"Vector": "wide", "Detail": "signed u", "Roughness": "v"}),
    *(
        node_case(
            "ShaderNodeTexNoise",
            0,
            {"Vector": "wide", "Detail": detail, "Roughness": 0.7, "Offset": 0.3, "Gain": 1.4, "Lacunarity": 2.2},
            noise_type=kind,
        )
        for kind, detail in product(
            ("MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN"), (2.0, 3.4)
        )
    ),
    *(
        node_case(
            "ShaderNodeTexVoronoi",
            output,
            {"Vector": "wide", "W": 0.3, "Scale": 2.5, "Randomness": 0.9},
            voronoi_dimensions=dimensions,
            feature=feature,
        )
        for dimensions, feature, output in (
            *product(("2D", "3D"), ("F1", "F2"), ("Distance", "Color", "Position")),
            ("4D", "F1", "Distance"),
            ("4D", "F2", "W"),
            *product(("2D", "3D", "4D"), ("DISTANCE_TO_EDGE",), ("Distance",)),
            *product(("2D", "3D", "4D"), ("N_SPHERE_RADIUS",), ("Radius",)),
            *product(("2D", "3D"), ("SMOOTH_F1",), ("Distance", "Color", "Position")),
        )
    ),
    *(
        node_case(
            "ShaderNodeTexVoronoi", output, {"W": "signed u", "Scale": 2.0}, voronoi_dimensions="1D", feature=feature
        )
        for feature, output in (
            ("F1", "Distance"),
            ("F2", "Color"),
            ("SMOOTH_F1", "W"),
            ("DISTANCE_TO_EDGE", "Distance"),
            ("N_SPHERE_RADIUS", "Radius"),
        )
    ),
    *(
        node_case("ShaderNodeTexVoronoi", 0, {"Vector": "wide", "Exponent": 1.7}, distance=metric, normalize=True)
        for metric in ("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI")
    ),
    *(
        node_case(
            "ShaderNodeTexVoronoi",
            output,
            {"Vector": "wide", "Detail": detail, "Roughness": 0.6, "Scale": 2.0},
            feature=feature,
            normalize=True,
        )
        for feature, output in (("F1", "Distance"), ("F2", "Color"), ("DISTANCE_TO_EDGE", "Distance"))
        for detail in (2.4, "signed v")
    ),
    *(
        node_case("ShaderNodeTexWhiteNoise", output, {"Vector": "cells", "W": 2.0}, noise_dimensions=dimensions)
        for dimensions, output in product(("2D", "3D", "4D"), (0, 1))
    ),
]


def run(bench: NodeBench, kind: str, output, inputs: dict, settings: dict, **tolerances) -> None:
    node = bench.add(kind, **settings)
    drive(bench, node, inputs)
    compare(bench, node.outputs[output], **tolerances)


@pytest.mark.parametrize(("kind", "output", "inputs", "settings"), COLOR_CASES)
def test_colors_and_vectors(bench, kind, output, inputs, settings):
    run(bench, kind, output, inputs, settings)


@pytest.mark.parametrize(("kind", "output", "inputs", "settings"), TEXTURE_CASES)
def test_textures(bench, kind, output, inputs, settings):
    run(bench, kind, output, inputs, settings)


@pytest.mark.parametrize("settings", [
    {"use_min": True, "min": (0.2, -0.3, 0.0)},
    {"use_max": True, "max": (0.8, 0.6, 1.0), "scale": (1.5, 1.0, 1.0)},
    {"mapping_x": "Y", "mapping_y": "X", "mapping_z": "NONE"},
])  # fmt: skip
def test_mapping_of_texture_nodes(bench, settings):
    node = bench.add("ShaderNodeTexGradient", gradient_type="DIAGONAL")
    for name, value in settings.items():
        setattr(node.texture_mapping, name, value)
    drive(bench, node, {"Vector": "wide"})
    compare(bench, node.outputs["Color"])


@pytest.mark.parametrize("operation", MATH)
def test_math(bench, operation):
    run(bench, "ShaderNodeMath", 0, {0: "signed u", 1: "signed v", 2: 0.6}, {"operation": operation})


@pytest.mark.parametrize("operation", VECTOR_MATH)
def test_vector_math(bench, operation):
    inputs = {0: "wide", 1: "vector", 2: (0.5, -0.4, 0.9), 3: 0.7}
    run(bench, "ShaderNodeVectorMath", int(operation in SCALAR_VECTORS), inputs, {"operation": operation})


@pytest.mark.parametrize("interpolation", ["LINEAR", "EASE", "CONSTANT", "CARDINAL", "B_SPLINE"])
def test_color_ramp(bench, interpolation):
    node = bench.add("ShaderNodeValToRGB")
    ramp = node.color_ramp
    ramp.interpolation = interpolation
    ramp.elements.new(0.4).color = (1, 0.2, 0, 1)
    ramp.elements.new(0.7).color = (0, 0.5, 0.7, 0.3)
    drive(bench, node, {0: "signed u"})
    compare(bench, node.outputs[0])
    compare(bench, node.outputs[1])


@pytest.mark.parametrize("mode", ["RGB", "HSV", "HSL"])
def test_color_ramp_models(bench, mode):
    node = bench.add("ShaderNodeValToRGB")
    node.color_ramp.color_mode = mode
    node.color_ramp.elements[0].color = (1, 0.2, 0, 1)
    node.color_ramp.elements[1].color = (0, 0.5, 0.7, 0.3)
    drive(bench, node, {0: "u"})
    compare(bench, node.outputs[0])


@pytest.mark.parametrize("extend", ["EXTRAPOLATED", "HORIZONTAL"])
@pytest.mark.parametrize("kind", ["ShaderNodeRGBCurve", "ShaderNodeVectorCurve", "ShaderNodeFloatCurve"])
def test_curves(bench, kind, extend):
    node = bench.add(kind)
    mapping = node.mapping
    mapping.extend = extend
    for index, curve in enumerate(mapping.curves):
        curve.points.new(0.3, 0.55 + 0.1 * index)
    mapping.update()
    drive(bench, node, {0: 0.8, 1: "signed u" if kind == "ShaderNodeFloatCurve" else "wide"})
    # Beyond its ends a curve goes on with the slope of two close entries of a float32 table.
    compare(bench, node.outputs[0], tolerance=2e-3)


def test_blackbody(bench):
    """Planck's law at single temperatures against Cycles' fit of it."""
    node = bench.add("ShaderNodeBlackbody")
    bench.link(bench.spread(bench.u, 1000, 11500), node.inputs[0])
    compare(bench, node.outputs[0], tolerance=0.02)


def test_wavelength(bench):
    """The eye's response in steps of 10 nm against Cycles' of 5 nm."""
    node = bench.add("ShaderNodeWavelength")
    bench.link(bench.spread(bench.u, 400, 720), node.inputs[0])
    compare(bench, node.outputs[0], tolerance=0.02)


def test_conversions_between_numbers_vectors_and_colors(bench):
    gamma = bench.add("ShaderNodeGamma")
    math = bench.add("ShaderNodeMath")
    bench.link(bench.vector(bench.u, 0.5, bench.v), gamma.inputs[0])
    bench.link(gamma.outputs[0], math.inputs[0])  # colour to number
    compare(bench, math.outputs[0])
    bench.link(bench.vector(bench.u, 0.5, bench.v), math.inputs[1])  # vector to number
    compare(bench, math.outputs[0])


def test_trees_of_the_world_are_functions_of_the_direction(bench):
    """Coordinates that objects do not have: generated, unlinked, and those of an environment image."""
    from blend import add_image, add_world
    from svgf_blender.export.evaluation.expression import evaluate
    from svgf_blender.export.node_values import DIRECTION, ValueReader
    from svgf_blender.export.nodes import Place
    from svgf_blender.export.textures import TextureCache

    tree = add_world().node_tree
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    reader = ValueReader(TextureCache(), pytest.fail, lambda image, text: pytest.fail(text), is_world=True)
    directions = np.float32([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    gradient = tree.nodes.new("ShaderNodeTexGradient")
    tree.links.new(gradient.outputs["Color"], background.inputs["Color"])
    values = evaluate(reader.read(Place(background.inputs["Color"])), {DIRECTION: directions})
    assert np.allclose(values, np.clip(directions[:, :1], 0, 1))
    environment = tree.nodes.new("ShaderNodeTexEnvironment")
    columns = np.ones((1, 4, 4))
    columns[0, :, 0] = (0.1, 0.2, 0.3, 0.4)
    environment.image, environment.interpolation = add_image("Sky", columns, "Non-Color"), "Linear"
    tree.links.new(environment.outputs[0], background.inputs["Color"])
    values = evaluate(reader.read(Place(background.inputs["Color"])), {DIRECTION: directions})
    # +X is the middle of the picture, +Y a quarter to the left.
    assert np.allclose(values[:, 0], (0.25, 0.15, 0.25, 0.35), atol=3e-3)
