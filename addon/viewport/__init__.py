# SPDX-License-Identifier: GPL-3.0-or-later
"""The path traced viewport.

Blender's main thread exports what changed and draws the newest picture (views, session, camera, draw); a worker thread
for each view renders (worker, follow, picture). Neither waits for the other.
"""
