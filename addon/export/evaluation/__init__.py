# SPDX-License-Identifier: GPL-3.0-or-later
"""What shader nodes compute, in numpy and without Blender.

``expression`` holds the graph; the other modules hold its functions, one for each node, with the names and the meaning
that the nodes have in Cycles. All arrays are float32: numbers [n], vectors and colours [n, 3]. Constants have n = 1.
"""
