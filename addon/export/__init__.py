# SPDX-License-Identifier: GPL-3.0-or-later
"""From Blender to svgf: the evaluated dependency graph, or a .blend file, becomes ``svgf.scene.Scene``.

One module per kind of data-block, each of which names in a warning what svgf does not simulate yet.
"""

from .exporter import Exporter, export_scene
from .file import export_file
from .frames import export_frame

__all__ = ["Exporter", "export_file", "export_frame", "export_scene"]
