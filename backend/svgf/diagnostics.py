# SPDX-License-Identifier: Apache-2.0
"""What a denoiser can tell of a frame beside the result. Made only where it is asked for; else it costs nothing."""

from __future__ import annotations

from enum import IntEnum


class ResetReason(IntEnum):
    """Why a pixel has no history, as the kernel that looked for it found: of the nearest of the pixels in which its
    surface was a frame ago. The same list as in backend/native/denoise/denoiser.h."""

    KEPT = 0  # it has
    BACKGROUND = 1  # there is no surface
    RESTARTED = 2  # nothing has: the first frame, or one after a reset
    BAD_MOTION = 3  # its motion is not a number
    OUTSIDE = 4  # it was outside of the frame
    OTHER_OBJECT = 5  # another object was there
    OTHER_DEPTH = 6  # a surface nearer or farther than its own was there
    OTHER_NORMAL = 7  # a surface that faces elsewhere was there
    LIGHT_CHANGED = 8  # svgf+: its history was given up, as the light on it has changed


# Images [H, W] by name, float32: unit and meaning.
DIAGNOSTICS = {
    "motion_error": (
        "px",
        "how far the motion misses where the surface was: difference from the depth that history holds of the same "
        "object, over the surface's depth per pixel; 0 where there is none",
    ),
    "reset_reason": ("1", "why there is no history: " + ", ".join(f"{each.value} {each.name}" for each in ResetReason)),
    "repaired_values": ("1", "values of the pixel's inputs that were not numbers or out of range"),
    "suppressed_light": ("1", "svgf+: luminance over albedo that the firefly limit cut, summed over the signals"),
}
