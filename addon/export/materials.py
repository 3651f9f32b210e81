# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials of one frame: Blender's node trees as records and textures of a scene."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, replace

import bpy
from svgf.scene import Material, MaterialKind, Texture

from . import baking
from .findings import Findings
from .material_inputs import Context, InputReader, TextureTable
from .node_values import ValueReader
from .nodes import Place, describe, find_input, has_nodes, trace
from .surfaces import BLACK, Surface, SurfaceReader
from .textures import TextureCache
from .uv_maps import MaterialUse, UvLayers, UvUse


@dataclass(frozen=True)
class _Reading:
    """What was read of one material. Its maps have numbers of its own textures.

    tangent_layers: UV layers that meshes need tangents of. layers, use: what else it depends on.
    """

    surface: Surface
    textures: list[Texture]
    tangent_layers: tuple[int, ...]
    findings: Findings
    layers: UvLayers
    use: MaterialUse


class MaterialCache:
    """Materials of the last frame by full name. reads: how often the nodes of one were read."""

    def __init__(self) -> None:
        self.reads = 0
        self.readings: dict[str, _Reading] = {}

    def forget(self, names: Set[str] | None = None) -> None:
        """Materials whose nodes may differ; None: any."""
        for name in list(self.readings) if names is None else names:
            self.readings.pop(name, None)


class MaterialTable:
    """Numbers the materials of one frame in the order in which they are met, then reads them.

    materials: records. The first are those that were numbered, the others what they are mixed of.
    tangent_layers: of those that were numbered, in order.
    """

    def __init__(self, textures: TextureCache, cache: MaterialCache, findings: Findings, layers: UvLayers) -> None:
        self.materials: list[Material] = []
        self.tangent_layers: list[tuple[int, ...]] = []
        self._textures = TextureTable()
        self._images = textures
        self._cache = cache
        self._findings = findings
        self._layers = layers
        self._indices: dict[str | None, int] = {}
        self._sources: list[bpy.types.Material | None] = []

    @property
    def textures(self) -> list[Texture]:
        return self._textures.textures

    def index(self, material: bpy.types.Material | None) -> int:
        """The number of a material; None is an empty slot, which Cycles renders as a default Principled BSDF."""
        key = material and material.name_full
        if key not in self._indices:
            self._indices[key] = len(self._sources)
            self._sources.append(material)
        return self._indices[key]

    def read(self, use: UvUse) -> None:
        """Reads all that were numbered. use: what meshes do with their UVs, which textures are baked for."""
        self.tangent_layers[:] = [()] * len(self._sources)
        surfaces = [
            Surface(Material()) if source is None else self._read(source, MaterialUse(use, index))
            for index, source in enumerate(self._sources)
        ]
        self.materials[:] = [surface.material for surface in surfaces]
        for index, surface in enumerate(surfaces):
            self._place(surface, index)

    def mesh_tangents(self, use: UvUse) -> dict[int, int]:
        """Of which UV layer each mesh, by index, needs tangents. Of several the first; the others are named."""
        wanted: dict[int, int] = {}
        for material, layers in enumerate(self.tangent_layers):
            for mesh in use.meshes_of(material) if layers else ():
                if any(layer != wanted.setdefault(mesh, layers[0]) for layer in layers):
                    self._findings.add(
                        self._sources[material],
                        "normal maps on several UV maps of one mesh are not supported yet; all but one have the "
                        "tangents of triangles.",
                    )
        return wanted

    def _read(self, material: bpy.types.Material, use: MaterialUse) -> Surface:
        name = material.name_full
        reading = self._cache.readings.get(name)
        if reading is None or reading.layers != self._layers or not use.answers_like(reading.use):
            self._cache.reads += 1
            context = Context(self._images, TextureTable(), self._layers, use)
            findings = Findings()
            surface, tangent_layers = _surface(material, context, findings)
            surface = replace(surface, material=replace(surface.material, name=material.name))
            reading = _Reading(surface, context.table.textures, tangent_layers, findings, self._layers, use)
            self._cache.readings[name] = reading
        self.tangent_layers[use.index] = reading.tangent_layers
        self._findings.extend(reading.findings)
        return self._numbered(reading.surface, [self._textures.index(texture) for texture in reading.textures])

    def _numbered(self, surface: Surface, numbers: list[int]) -> Surface:
        """With the numbers of the textures in this frame."""
        maps = {name: replace(old, texture=numbers[old.texture]) for name, old in surface.material.maps.items()}
        parts = tuple(self._numbered(part, numbers) for part in surface.parts)
        return Surface(replace(surface.material, maps=maps), parts)

    def _place(self, surface: Surface, index: int) -> None:
        """Gives the parts of a mix their numbers."""
        if not surface.parts:
            return
        numbers = []
        for part in surface.parts:
            numbers.append(len(self.materials))
            self.materials.append(replace(part.material, name=surface.material.name))
            self._place(replace(part, material=self.materials[-1]), numbers[-1])
        self.materials[index] = replace(surface.material, first=numbers[0], second=numbers[1])


def _surface(
    material: bpy.types.Material, context: Context, findings: Findings
) -> tuple[Surface, tuple[int, ...]]:
    """With the UV layers that it needs tangents of."""

    def find(text: str) -> None:
        findings.add(material, text)

    if not has_nodes(material):
        color = tuple(min(max(part, 0.0), 1.0) for part in material.diffuse_color[:3])
        return Surface(Material(kind=MaterialKind.DIFFUSE, base_color=color)), ()
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return Surface(BLACK), ()
    if trace(find_input(output, "Volume")).is_output:
        find("volumes are not supported yet; the inside is empty.")
    values = ValueReader(context.cache, find, findings.add, context.layers.known)
    inputs = InputReader(context, values, material.name, find)
    displacement = _displacement(material, find_input(output, "Displacement"), inputs, find)
    surface = SurfaceReader(inputs, find, displacement).read(find_input(output, "Surface"))
    if not material.use_transparent_shadow and surface.lets_light_through:
        find("opaque shadows of what is transparent are not supported yet; light passes.")
    if surface.has_bumps and not getattr(getattr(material, "cycles", None), "use_bump_map_correction", True):
        find("bumps without Cycles' bump map correction are not supported yet; it is on.")
    return surface, tuple(sorted(inputs.tangent_layers))


def _displacement(material: bpy.types.Material, start: Place, inputs: InputReader, find) -> baking.Bump | None:
    """Displacement as bumps, which is what Blender does unless told otherwise."""
    place = trace(start)
    if not place.is_output:
        return None
    if place.node.type != "DISPLACEMENT":
        find(f"{describe(place.node)} for displacement is not supported yet; the surface stays as it is.")
        return None
    if material.displacement_method != "BUMP":
        find("displacement is not supported yet; it bends the normals alone.")
    return inputs.bump(place, ("Height", None, "Scale"), 1.0)
