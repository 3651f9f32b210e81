# SPDX-License-Identifier: GPL-3.0-or-later
"""What arrives at a socket, as an expression: one entry for each type of node that computes a number or a colour.

What an expression cannot say (a node that asks for the view, the object, the ray) is named, and the value of the
socket that it drives stands for it.
"""

from __future__ import annotations

from collections.abc import Callable, Set

import bpy
import numpy as np

from .evaluation import arithmetic, color, images, noise, patterns, voronoi
from .evaluation.expression import Expression, apply, constant, coordinate
from .nodes import Place, describe, trace
from .textures import Find, FindImage, TextureCache

# Coordinates by name: a UV map by its own, the active one by "".
UV = "uv:"
# Of a point of the world, from the camera.
DIRECTION = "direction"
# Of the world, 1 in all components for rays of the camera, else 0.
CAMERA_RAY = "camera ray"

_MAGENTA = (1.0, 0.0, 1.0)
_GREY = (0.5, 0.5, 0.5)
_TABLE_SIZE = 256


class ValueReader:
    """Reads the sockets of one material, world or lamp."""

    def __init__(
        self,
        textures: TextureCache,
        find: Find,
        find_image: FindImage,
        uv_maps: Set[str] = frozenset(),
        is_world: bool = False,
        sky: Callable[[bpy.types.Node], images.Image | str] | None = None,
    ) -> None:
        """find: takes sentences on what is not simulated. uv_maps: names that an Attribute node may ask for.

        is_world: coordinates are directions, to be evaluated at {DIRECTION: unit vectors}. sky: see ``sky_image``.
        """
        self._textures = textures
        self._find = find
        self._find_image = find_image
        self._uv_maps = uv_maps
        self._is_world = is_world
        self._sky = sky
        self._known: dict[tuple, Expression | None] = {}

    def read(self, start: Place) -> Expression:
        """The value of an input, as a number or as a vector."""
        wanted = start.socket.type
        place = trace(start)
        if not place.is_output:
            return _converted(_own_value(place.socket), place.socket.type, wanted)
        value = self._output(place)
        if value is None:
            name = start.socket.name
            self._find(
                f'{describe(place.node)} on "{name}" is not supported yet; the value of the socket is used instead.'
            )
            return _converted(_own_value(start.socket), wanted, wanted)
        return _converted(value, place.socket.type, wanted)

    def _output(self, place: Place) -> Expression | None:
        if place.key not in self._known:
            # Until it is known, a circle that leads back here finds a node without a value.
            self._known[place.key] = None
            builder = _BUILDERS.get(place.node.type)
            self._known[place.key] = builder and builder(_Node(self, place))
        return self._known[place.key]

    def coordinates(self, place: Place | None) -> Expression:
        """At the Vector input of a texture; generated ones where nothing is linked."""
        if place is not None and trace(place).is_output:
            return self.read(place)
        return self.generated("generated coordinates", place.node)

    def generated(self, what: str, node: bpy.types.Node) -> Expression:
        """Coordinates of the world are directions; those of objects are replaced."""
        if self._is_world:
            return coordinate(DIRECTION)
        self._find(f"{what} of {describe(node)} are not supported yet; UVs are used instead.")
        return coordinate(UV)

    def image(self, node: bpy.types.Node) -> images.Image | None:
        """Of an image node; None where there is none to read."""
        return self._textures.image(node, self._find, self._find_image)

    def sky(self, node: bpy.types.Node) -> images.Image | None:
        """Of a Sky Texture node; None where there is none."""
        if self._sky is None:
            return None
        found = self._sky(node)
        if isinstance(found, str):
            self._find(f"the sky of {describe(node)} {found}; it is an even grey.")
        return None if isinstance(found, str) else found

    def is_uv_map(self, name: str) -> bool:
        return name in self._uv_maps

    @property
    def is_world(self) -> bool:
        return self._is_world


class _Node:
    """A node whose output is asked for."""

    def __init__(self, reader: ValueReader, place: Place) -> None:
        self.reader = reader
        self.place = place
        self.rna = place.node
        self.output = place.socket.identifier

    def input(self, name: str | int) -> Expression:
        return self.reader.read(self.place.input(name))

    def inputs(self, *names: str | int) -> list[Expression]:
        return [self.input(name) for name in names]

    def numbers(self, *names: str) -> list[Expression]:
        """Those that this version of Blender lacks are 0."""
        return [constant(0.0) if self.place.input(name) is None else self.input(name) for name in names]

    def vector(self, dimensions: int = 3) -> Expression:
        """Texture coordinates, through the node's own mapping; in one dimension W is asked for instead."""
        if dimensions == 1:
            return constant((0.0,) * 3)
        return _mapped(self.rna, self.reader.coordinates(self.place.input("Vector")))


def _own_value(socket: bpy.types.NodeSocket) -> Expression:
    value = getattr(socket, "default_value", 0.0)
    if hasattr(value, "__len__"):
        return constant((*value, 0.0) if len(value) == 2 else tuple(value))
    return constant(float(value))


def _converted(value: Expression, source: str, wanted: str) -> Expression:
    """Between numbers and vectors, as links do it."""
    is_vector, want_vector = (kind in {"RGBA", "VECTOR", "ROTATION"} for kind in (source, wanted))
    if is_vector == want_vector:
        return value
    if want_vector:
        return apply(_spread, value)
    return apply(color.luminance if source == "RGBA" else _average, value)


def _spread(value: np.ndarray) -> np.ndarray:
    return np.repeat(value[:, None], 3, 1)


def _average(value: np.ndarray) -> np.ndarray:
    return value.mean(1)


def component(value: np.ndarray, *, index: int) -> np.ndarray:
    """A number out of a vector."""
    return value[:, index]


def _negated(value: np.ndarray) -> np.ndarray:
    return -value


def _joined(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(x, y, z), 1)


def _mapped(node: bpy.types.Node, vector: Expression) -> Expression:
    """Through the mapping that texture nodes had before there were Mapping nodes. Its limits do nothing in Cycles."""
    settings = node.texture_mapping
    axes = settings.mapping_x, settings.mapping_y, settings.mapping_z
    if axes != ("X", "Y", "Z"):
        vector = apply(_joined, *(_axis(vector, axis) for axis in axes))
    parts = tuple(settings.translation), tuple(settings.rotation), tuple(settings.scale)
    if parts == ((0, 0, 0), (0, 0, 0), (1, 1, 1)):
        return vector
    return apply(arithmetic.mapping, vector, *map(constant, parts), kind=settings.vector_type)


def _axis(vector: Expression, axis: str) -> Expression:
    return constant(0.0) if axis == "NONE" else apply(component, vector, index="XYZ".index(axis))


# Inputs


def _uv_map(node: _Node) -> Expression | None:
    return None if node.rna.from_instancer else coordinate(UV + node.rna.uv_map)


def _attribute(node: _Node) -> Expression | None:
    name = node.rna.attribute_name
    if node.rna.attribute_type != "GEOMETRY" or not node.reader.is_uv_map(name):
        return None
    if node.output == "Alpha":
        return constant(1.0)
    vector = coordinate(UV + name)
    return apply(_average, vector) if node.output == "Fac" else vector


def _texture_coordinates(node: _Node) -> Expression | None:
    output, is_world = node.output, node.reader.is_world
    if output == "UV" and not is_world:
        return None if node.rna.from_instancer else coordinate(UV)
    if output in {"Generated", "Object"}:
        return node.reader.generated(f"{output.lower()} coordinates", node.rna)
    return coordinate(DIRECTION) if is_world and output == "Normal" else None


def _geometry(node: _Node) -> Expression | None:
    if not node.reader.is_world:
        return None
    if node.output in {"Position", "Normal", "True Normal"}:
        return coordinate(DIRECTION)
    if node.output == "Incoming":
        return apply(_negated, coordinate(DIRECTION))
    return None


def _light_path(node: _Node) -> Expression | None:
    if not node.reader.is_world or node.output != "Is Camera Ray":
        return None
    return apply(component, coordinate(CAMERA_RAY), index=0)


def _value(node: _Node) -> Expression:
    return _own_value(node.place.socket)


# Textures


def _image_texture(node: _Node) -> Expression:
    image = node.reader.image(node.rna)
    if image is None:
        return constant(1.0 if node.output == "Alpha" else _MAGENTA)
    place = node.place.input("Vector")
    if trace(place).is_output or node.reader.is_world:
        vector = _mapped(node.rna, node.reader.coordinates(place))
    else:
        vector = _mapped(node.rna, coordinate(UV))
    return apply(images.sample_alpha if node.output == "Alpha" else images.sample_color, vector, image=image)


def _environment(node: _Node) -> Expression | None:
    image = node.reader.image(node.rna)
    if image is None:
        return constant(_MAGENTA)
    project = images.mirror_ball if node.rna.projection == "MIRROR_BALL" else images.equirectangular
    return apply(images.sample_color, apply(project, node.vector()), image=image)


def _sky(node: _Node) -> Expression | None:
    if not node.reader.is_world:
        return None
    image = node.reader.sky(node.rna)
    if image is None:
        return constant(_GREY)
    return apply(images.sample_color, apply(images.equirectangular, node.vector()), image=image)


def _noise(node: _Node) -> Expression:
    rna = node.rna
    dimensions = int(rna.noise_dimensions[0])
    numbers = node.numbers("W", "Scale", "Detail", "Roughness", "Lacunarity", "Offset", "Gain", "Distortion")
    return apply(
        noise.noise_texture,
        node.vector(dimensions),
        *numbers,
        dimensions=dimensions,
        kind=rna.noise_type,
        normalize=rna.normalize,
        color=node.output == "Color",
    )


def _voronoi(node: _Node) -> Expression:
    rna = node.rna
    dimensions = int(rna.voronoi_dimensions[0])
    numbers = node.numbers("W", "Scale", "Detail", "Roughness", "Lacunarity", "Smoothness", "Exponent", "Randomness")
    return apply(
        voronoi.voronoi_texture,
        node.vector(dimensions),
        *numbers,
        dimensions=dimensions,
        feature=rna.feature,
        metric=rna.distance,
        normalize=rna.normalize,
        output=node.output,
    )


def _white_noise(node: _Node) -> Expression:
    dimensions = int(node.rna.noise_dimensions[0])
    place = node.place.input("Vector")
    vector = constant((0.0,) * 3) if dimensions == 1 else node.reader.read(place)
    return apply(
        patterns.white_noise, vector, *node.numbers("W"), dimensions=dimensions, color=node.output == "Color"
    )


def _checker(node: _Node) -> Expression:
    share = apply(patterns.checker, node.vector(), node.input("Scale"))
    if node.output == "Fac":
        return share
    return apply(color.mix, share, node.input("Color2"), node.input("Color1"), clamp_factor=False)


def _brick(node: _Node) -> Expression:
    rna = node.rna
    numbers = node.numbers("Scale", "Mortar Size", "Mortar Smooth", "Bias", "Brick Width", "Row Height")
    both = apply(
        patterns.brick,
        node.vector(),
        *numbers,
        offset=rna.offset,
        offset_frequency=rna.offset_frequency,
        squash=rna.squash,
        squash_frequency=rna.squash_frequency,
    )
    mortar = apply(component, both, index=1)
    if node.output == "Fac":
        return mortar
    tinted = apply(
        color.mix, apply(component, both, index=0), *node.inputs("Color1", "Color2"), clamp_factor=False
    )
    return apply(color.mix, mortar, tinted, node.input("Mortar"), clamp_factor=False)


def _gradient(node: _Node) -> Expression:
    return _number_or_gray(node, apply(patterns.gradient, node.vector(), kind=node.rna.gradient_type))


def _wave(node: _Node) -> Expression:
    rna = node.rna
    numbers = node.numbers("Scale", "Distortion", "Detail", "Detail Scale", "Detail Roughness", "Phase Offset")
    direction = rna.bands_direction if rna.wave_type == "BANDS" else rna.rings_direction
    value = apply(
        patterns.wave, node.vector(), *numbers, kind=rna.wave_type, direction=direction, profile=rna.wave_profile
    )
    return _number_or_gray(node, value)


def _magic(node: _Node) -> Expression:
    value = apply(patterns.magic, node.vector(), *node.numbers("Scale", "Distortion"), depth=node.rna.turbulence_depth)
    return apply(_average, value) if node.output == "Fac" else value


def _number_or_gray(node: _Node, value: Expression) -> Expression:
    return value if node.output == "Fac" else apply(_spread, value)


# Colours


def _mix(node: _Node) -> Expression | None:
    rna = node.rna
    kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(rna.data_type)
    if kind is None:
        return None
    is_uniform = kind != "Vector" or rna.factor_mode == "UNIFORM"
    inputs = node.inputs("Factor_Float" if is_uniform else "Factor_Vector", f"A_{kind}", f"B_{kind}")
    if kind != "Color":
        return apply(color.mix, *inputs, clamp_factor=rna.clamp_factor)
    return apply(
        color.mix_color,
        *inputs,
        blend=rna.blend_type,
        clamp_factor=rna.clamp_factor,
        clamp_result=rna.clamp_result,
    )


def _mix_rgb(node: _Node) -> Expression:
    rna = node.rna
    return apply(
        color.mix_color, *node.inputs(0, 1, 2), blend=rna.blend_type, clamp_factor=True, clamp_result=rna.use_clamp
    )


def _separate_color(node: _Node) -> Expression:
    value = node.input(0)
    parts = value if node.rna.mode == "RGB" else apply(color.separate, value, mode=node.rna.mode)
    return apply(component, parts, index=("Red", "Green", "Blue").index(node.output))


def _separate_xyz(node: _Node) -> Expression:
    return apply(component, node.input(0), index="XYZ".index(node.output))


def _color_ramp(node: _Node) -> Expression:
    ramp = node.rna.color_ramp
    table = np.array([ramp.evaluate(i / (_TABLE_SIZE - 1)) for i in range(_TABLE_SIZE)], np.float32)
    table = table[:, 3:] if node.output == "Alpha" else table[:, :3]
    return apply(color.ramp, node.input(0), table=table, interpolate=ramp.interpolation != "CONSTANT")


def _curves(node: _Node) -> Expression:
    mapping = node.rna.mapping
    mapping.initialize()
    used = list(mapping.curves)[: 1 if node.rna.type == "CURVE_FLOAT" else 3]
    low = min(curve.points[0].location[0] for curve in used)
    high = max(curve.points[-1].location[0] for curve in used)
    places = np.linspace(low, high, _TABLE_SIZE).tolist()
    # The curve of all channels comes first, then that of each.
    if node.rna.type == "CURVE_RGB":
        common = [mapping.evaluate(mapping.curves[3], place) for place in places]
        columns = [[mapping.evaluate(curve, place) for place in common] for curve in used]
    else:
        columns = [[mapping.evaluate(curve, place) for place in places] for curve in used]
    table = np.array(columns, np.float32).T
    return apply(
        color.curves,
        *node.inputs(0, 1),
        table=table,
        low=low,
        high=high,
        extrapolate=mapping.extend == "EXTRAPOLATED",
    )


# Numbers and vectors


def _math(node: _Node) -> Expression:
    return apply(arithmetic.math, *node.inputs(0, 1, 2), operation=node.rna.operation, clamp=node.rna.use_clamp)


def _vector_math(node: _Node) -> Expression:
    return apply(arithmetic.vector_math, *node.inputs(0, 1, 2, 3), operation=node.rna.operation)


def _map_range(node: _Node) -> Expression:
    names = ["From Min", "From Max", "To Min", "To Max", "Steps"]
    if node.rna.data_type == "FLOAT_VECTOR":
        names = ["Vector", *(f"{name.replace(' ', '_')}_FLOAT3" for name in names)]
    else:
        names = ["Value", *names]
    return apply(arithmetic.map_range, *node.inputs(*names), kind=node.rna.interpolation_type, clamp=node.rna.clamp)


def _vector_rotate(node: _Node) -> Expression:
    kind = node.rna.rotation_type
    kind = {"X_AXIS": "X", "Y_AXIS": "Y", "Z_AXIS": "Z"}.get(kind, kind)
    inputs = node.inputs("Vector", "Center", "Axis", "Angle", "Rotation")
    return apply(arithmetic.vector_rotate, *inputs, kind=kind, invert=node.rna.invert)


def _simple(function: Callable, *names: str | int) -> Callable[[_Node], Expression]:
    return lambda node: apply(function, *node.inputs(*names))


_BUILDERS: dict[str, Callable[[_Node], Expression | None]] = {
    "ATTRIBUTE": _attribute,
    "BLACKBODY": _simple(color.blackbody, 0),
    "BRIGHTCONTRAST": _simple(color.brightness_contrast, 0, 1, 2),
    "CLAMP": lambda node: apply(arithmetic.clamp, *node.inputs(0, 1, 2), kind=node.rna.clamp_type),
    "COMBINE_COLOR": lambda node: apply(color.combine, *node.inputs(0, 1, 2), mode=node.rna.mode),
    "COMBXYZ": _simple(_joined, 0, 1, 2),
    "CURVE_FLOAT": _curves,
    "CURVE_RGB": _curves,
    "CURVE_VEC": _curves,
    "GAMMA": _simple(color.gamma, 0, 1),
    "HUE_SAT": _simple(color.hue_saturation, "Hue", "Saturation", "Value", "Fac", "Color"),
    "INVERT": _simple(color.invert, 0, 1),
    "LIGHT_PATH": _light_path,
    "MAPPING": lambda node: apply(arithmetic.mapping, *node.inputs(0, 1, 2, 3), kind=node.rna.vector_type),
    "MAP_RANGE": _map_range,
    "MATH": _math,
    "MIX": _mix,
    "MIX_RGB": _mix_rgb,
    "NEW_GEOMETRY": _geometry,
    "RGB": _value,
    "RGBTOBW": _simple(color.luminance, 0),
    "SEPARATE_COLOR": _separate_color,
    "SEPXYZ": _separate_xyz,
    "TEX_BRICK": _brick,
    "TEX_CHECKER": _checker,
    "TEX_COORD": _texture_coordinates,
    "TEX_ENVIRONMENT": _environment,
    "TEX_GRADIENT": _gradient,
    "TEX_IMAGE": _image_texture,
    "TEX_MAGIC": _magic,
    "TEX_NOISE": _noise,
    "TEX_SKY": _sky,
    "TEX_VORONOI": _voronoi,
    "TEX_WAVE": _wave,
    "TEX_WHITE_NOISE": _white_noise,
    "UVMAP": _uv_map,
    "VALTORGB": _color_ramp,
    "VALUE": _value,
    "VECTOR_ROTATE": _vector_rotate,
    "VECT_MATH": _vector_math,
    "WAVELENGTH": _simple(color.wavelength, 0),
}
