# SPDX-License-Identifier: Apache-2.0
"""Whether a sequence's Vector pass means what Cycles means by it: measured, not believed.

Cycles: X, Y = previous position - this one in pixels, y up. Other writers negate it or let y point down, and files that
were converted to an unsigned type have lost the negative half. Each reading is tried on the pixels where it would lead
elsewhere; the right one leads to the same depth, normal, albedo and object.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from .reprojection import View, agreement, votes

# In pixels: below it, jittered rays blur what a reading leads to.
_TELLING_MOTION = 1.5
_FEWEST_VOTES = 50
# Another reading must win by this factor before svgf takes it: noise, silhouettes and disocclusions vote for either.
_DECISIVE = 2.0
# Cycles' own vectors lead to the same surface for nine pixels of ten; after a cut, or if they mean something else, few.
_LEAST_AGREEMENT = 0.3

# Factors to the components as they were read; what the file's vectors are then.
_OTHERS = {
    (-1.0, -1.0): "this position - the previous one",
    (1.0, -1.0): "with y pointing down",
    (-1.0, 1.0): "this position - the previous one, with y pointing down",
}


def measure_convention(pairs: Sequence[tuple[View, View]], layer: str) -> tuple[tuple[float, float], str]:
    """pairs: frames with the one before each, their motion read as Cycles writes it.

    Returns the factors that motion needs, and a sentence where they are not 1. Raises InputError where negative vectors
    were lost, and where no reading fits; a sequence in which too little moves to tell is taken as it is.
    """
    _refuse_clamped([view for view, _ in pairs], layer)
    best, majority = (1.0, 1.0), _DECISIVE
    for signs in _OTHERS:
        for_cycles, against = 0, 0
        for view, before in pairs:
            flipped = np.where(np.asarray(signs) < 0, np.abs(view.motion), 0.0).max(axis=-1) >= _TELLING_MOTION
            counts = votes(view, before, signs, flipped)
            for_cycles, against = for_cycles + counts[0], against + counts[1]
        if for_cycles + against >= _FEWEST_VOTES and against > majority * for_cycles:
            best, majority = signs, against / max(for_cycles, 1)
    if best in _OTHERS:
        return best, (
            f'Layer "{layer}": Vector is not as Cycles writes it, but {_OTHERS[best]}; svgf reads it so. '
            f"(It then leads {majority:.1f} times more pixels to the same surface in the frame before.)"
        )
    shares = [agreement(view, before) for view, before in pairs]
    # Half of the pairs may be cuts.
    if shares and max(shares) < _LEAST_AGREEMENT:
        raise InputError(
            f'Layer "{layer}": Vector leads to another surface in the frame before for '
            f"{100 * (1 - max(shares)):.0f} % of the pixels.",
            "svgf reads Cycles' Vector: previous position minus this one, in pixels of this image, y up. "
            "Render the frames one after the other without changing the scene between them.",
        )
    return (1.0, 1.0), ""


def _refuse_clamped(views: Sequence[View], layer: str) -> None:
    """Only what cannot be honest: motion along both axes without one negative number, yet with moving pixels that lost
    one axis altogether. Objects may well move to the left only."""
    if not views:
        return
    motion = np.concatenate([view.motion.reshape(-1, 2) for view in views]) * np.float32((1.0, -1.0))  # y up again
    moving = motion[(motion != 0.0).any(axis=-1)]
    if moving.size and (moving >= 0.0).all() and all((moving[:, axis] == 0.0).mean() > 0.02 for axis in (0, 1)):
        raise InputError(
            f'Layer "{layer}": Vector holds no negative number, although things move both ways: they were lost.',
            "Keep Vector as float: render to OpenEXR MultiLayer, Color Depth Float (Full), and do not convert the "
            "files to a format without negative numbers.",
        )
