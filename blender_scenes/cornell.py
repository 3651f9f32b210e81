# SPDX-License-Identifier: Apache-2.0
"""Cornell: a box with coloured walls, lit by an emissive panel; glass, gold and steel inside, a steel ball that rolls.

About 5,000 triangles. The camera stands still, so that only the ball and its light move: what is static must converge
while the rest must not smear.
"""

from __future__ import annotations

import geometry
import numpy as np
import studio
from geometry import join, lathe, rounded_box, sphere, torus

_WIDTH, _DEPTH, _HEIGHT = 3.0, 2.0, 2.0  # of the box, metres; as wide as the picture's format
_BALL_RADIUS = 0.18


def _walls() -> geometry.Shape:
    """Floor, ceiling and back wall (slot 0), left (1), right (2); the front is open."""
    floor, back = geometry.quad(_WIDTH, _DEPTH), geometry.quad(_WIDTH, _HEIGHT).rotated("x", 90)
    side = geometry.quad(_HEIGHT, _DEPTH).rotated("y", 90)
    return join(
        floor,
        floor.rotated("x", 180).moved(z=_HEIGHT),
        back.moved(y=_DEPTH / 2, z=_HEIGHT / 2),
        side.moved(x=-_WIDTH / 2, z=_HEIGHT / 2).with_slot(1),
        side.rotated("z", 180).moved(x=_WIDTH / 2, z=_HEIGHT / 2).with_slot(2),
    )


def _vase() -> geometry.Shape:
    """A thick-walled glass vase: outside up, inside down."""
    outside = [(0.0, 0.0), (0.085, 0.0), (0.10, 0.012), (0.125, 0.07), (0.15, 0.15), (0.155, 0.22), (0.14, 0.30),
               (0.105, 0.38), (0.078, 0.44), (0.072, 0.49), (0.085, 0.54), (0.10, 0.565)]
    inside = [(0.092, 0.572), (0.074, 0.54), (0.060, 0.49), (0.066, 0.44), (0.093, 0.375), (0.127, 0.30),
              (0.141, 0.22), (0.136, 0.155), (0.108, 0.08), (0.06, 0.045), (0.0, 0.04)]
    return lathe(outside + inside, 36)


def _ball_path(frame: int) -> tuple[float, float]:
    """Place and roll (radians) of the ball along its line: there and half-way back, slowing at the turn."""
    travel = 0.72 * np.sin(2 * np.pi * (frame - 8) / 96)
    return travel, travel / _BALL_RADIUS


def build() -> None:
    """Replace the open file by the scene."""
    studio.new_scene("cornell", bounces=6, world=(0.0, 0.0, 0.0))
    white = studio.material("White", (0.74, 0.72, 0.68), 0.6)
    red = studio.material("Terracotta", (0.62, 0.10, 0.05), 0.6)
    teal = studio.material("Teal", (0.05, 0.30, 0.30), 0.6)
    gold = studio.material("Gold", (0.94, 0.66, 0.26), 0.22, metallic=1.0)
    steel = studio.material("Brushed steel", (0.62, 0.64, 0.66), 0.28, metallic=1.0)
    copper = studio.material("Copper", (0.86, 0.42, 0.26), 0.3, metallic=1.0)
    glass = studio.material("Glass", (0.93, 0.98, 0.96), 0.0, transmission=1.0, ior=1.5)
    lacquer = studio.material("Lacquer", (0.03, 0.05, 0.12), 0.12)
    lamp = studio.material("Lamp", (1.0, 0.86, 0.68), emission=16.0)

    studio.place(studio.mesh("Walls", _walls(), [white, red, teal]))
    panel = geometry.quad(0.80, 0.62).rotated("x", 180)
    studio.place(studio.mesh("Lamp", panel, [lamp]), y=0.12, z=_HEIGHT - 0.002)

    studio.place(studio.mesh("Tall block", rounded_box(0.50, 0.50, 0.98, 0.018, 2), [white]), -0.66, 0.36, 0, 21)
    studio.place(studio.mesh("Ring", torus(0.215, 0.078, 48, 18).rotated("x", 90), [gold]), -0.66, 0.36, 1.271, -26)
    studio.place(studio.mesh("Low block", rounded_box(0.54, 0.54, 0.34, 0.018, 2), [lacquer]), 0.68, 0.18, 0, -23)
    studio.place(studio.mesh("Vase", _vase(), [glass]), 0.68, 0.18, 0.3405, scale=1.15)

    ball = studio.mesh("Ball", sphere(_BALL_RADIUS, 36, 18), [steel])
    band = studio.mesh("Band", torus(_BALL_RADIUS, 0.012, 36, 6).rotated("y", 90), [copper])
    # The ball and its inlaid band roll as one along a line from the front left to the right.
    heading = np.radians(6.0)
    parts = [studio.place(ball, turn=np.degrees(heading)), studio.place(band, turn=np.degrees(heading))]
    for part in parts:
        part.rotation_mode = "ZYX"
        poses = [_ball_path(frame) for frame in studio.animated_frames()]
        studio.animate(part, "location", [
            (-0.12 + travel * np.cos(heading), -0.22 + travel * np.sin(heading), _BALL_RADIUS) for travel, _ in poses])
        studio.animate(part, "rotation_euler", [(0.0, roll, heading) for _, roll in poses])

    studio.camera(38.0, lambda frame: ((0.0, -4.10, 1.06), (0.0, 0.0, 0.985)))
