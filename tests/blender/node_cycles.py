# SPDX-License-Identifier: Apache-2.0
"""Cycles' own values of a node, texel by texel over the unit square of UVs, to compare an evaluation with."""

from __future__ import annotations

import bpy
import numpy as np
from blend import link

SIDE = 24


class NodeBench:
    """A plane whose material emits what a socket computes."""

    def __init__(self) -> None:
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.cycles.samples = 1
        scene.cycles.device = "CPU"
        mesh = bpy.data.meshes.new("Plane")
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
        self.object = link("Plane", mesh)
        self.material = bpy.data.materials.new("Bench")
        if bpy.app.version < (5, 0, 0):
            self.material.use_nodes = True
        mesh.materials.append(self.material)
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.output = self.add("ShaderNodeOutputMaterial")
        self.emission = self.add("ShaderNodeEmission")
        self._target = self.add("ShaderNodeTexImage")
        self._target.image = bpy.data.images.new("Target", SIDE, SIDE, float_buffer=True)
        self._target.image.colorspace_settings.name = "Non-Color"
        coordinates = self.add("ShaderNodeTexCoord")
        self.uv = coordinates.outputs["UV"]
        split = self.add("ShaderNodeSeparateXYZ")
        self.link(self.uv, split.inputs[0])
        self.u, self.v = split.outputs["X"], split.outputs["Y"]
        # As Cycles interpolates them, a few parts in 100,000 off the texels' centres.
        self.points = self.cycles(self.uv)

    def add(self, kind: str, **settings) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        return node

    def link(self, start: bpy.types.NodeSocket, end: bpy.types.NodeSocket) -> None:
        self.tree.links.new(start, end)

    def spread(self, source: bpy.types.NodeSocket, low: float, high: float) -> bpy.types.NodeSocket:
        """A number in [0, 1] over another range."""
        node = self.add("ShaderNodeMath", operation="MULTIPLY_ADD")
        self.link(source, node.inputs[0])
        node.inputs[1].default_value, node.inputs[2].default_value = high - low, low
        return node.outputs[0]

    def vector(self, *parts: bpy.types.NodeSocket | float) -> bpy.types.NodeSocket:
        node = self.add("ShaderNodeCombineXYZ")
        for socket, part in zip(node.inputs, parts, strict=True):
            if isinstance(part, float):
                socket.default_value = part
            else:
                self.link(part, socket)
        return node.outputs[0]

    def cycles(self, socket: bpy.types.NodeSocket) -> np.ndarray:
        """float32 [n, 3] of a socket at the texels' centres, the bottom row first."""
        self.link(socket, self.emission.inputs["Color"])
        self.link(self.emission.outputs[0], self.output.inputs["Surface"])
        return self._bake("EMIT")

    def cycles_normals(self, shader: bpy.types.NodeSocket) -> np.ndarray:
        """float32 [n, 3] normals in tangent space, as Cycles has them for a closure."""
        self.link(shader, self.output.inputs["Surface"])
        return self._bake("NORMAL") * 2 - 1

    def _bake(self, kind: str) -> np.ndarray:
        self.tree.nodes.active = self._target
        bpy.context.view_layer.objects.active = self.object
        self.object.select_set(True)
        bpy.ops.object.bake(type=kind, margin=0)
        pixels = np.empty(SIDE * SIDE * 4, np.float32)
        self._target.image.pixels.foreach_get(pixels)
        return pixels.reshape(-1, 4)[:, :3]

    def evaluated(self, socket: bpy.types.NodeSocket) -> tuple[np.ndarray, list[str]]:
        """The same by the exporter, and what it had to name."""
        from svgf_blender.export.evaluation.expression import evaluate
        from svgf_blender.export.node_values import UV, ValueReader
        from svgf_blender.export.nodes import Place
        from svgf_blender.export.textures import TextureCache

        self.link(socket, self.emission.inputs["Color"])
        found: list[str] = []
        reader = ValueReader(TextureCache(), found.append, lambda image, text: found.append(text))
        expression = reader.read(Place(self.emission.inputs["Color"]))
        return evaluate(expression, {UV: self.points}), found
