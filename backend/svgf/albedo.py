# SPDX-License-Identifier: Apache-2.0
"""Directional albedos of lobes, which no closed form gives, as tables that every device reads.

``python -m svgf.reference.albedo`` computes those of GGX. Axes are those of Cycles' tables, so that what lies between
two entries comes out alike: roughness, cosine of the view, and sqrt((ior - 1) / (ior + 1)), each in even steps over [0,
1].
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

FILE = Path(__file__).parent / "albedo_tables.npy"

# Number of entries along IOR, cosine and roughness, in the order in which the tables lie in the file.
#
# energy: share of light that a lobe without Fresnel term reflects once, so that 1 - energy is what it loses.
# mean_energy: the same for light from everywhere.
# schlick: s, where the mean of Schlick's Fresnel term over the lobe is f0 + (f90 - f0) s.
# dielectric: s, where the mean Fresnel reflectance over the lobe is f0 + (1 - f0) s.
# dielectric_leaving: the same of an interface to a less dense side, a mirror beyond its critical angle. That angle lies
# in the middle of its axis of cosines, whose steps are fine there: else what is missed between entries is 0.25.
# glass_entering, glass_leaving: energy of reflection and refraction together, into and out of the denser side.
# mean_glass_entering, mean_glass_leaving: the same for light from everywhere.
# sheen: of the lobe of Blender's sheen [Zeltner22]. Measured in Cycles 5.0, whose samples of it all weigh the same in a
# white world, at its own entries; there is no model but data behind it.
SHAPES = {
    "energy": (1, 32, 32),
    "mean_energy": (1, 1, 32),
    "schlick": (1, 16, 16),
    "dielectric": (16, 16, 16),
    "dielectric_leaving": (16, 17, 16),
    "glass_entering": (16, 16, 16),
    "glass_leaving": (16, 16, 16),
    "mean_glass_entering": (16, 1, 16),
    "mean_glass_leaving": (16, 1, 16),
    "sheen": (1, 32, 32),
}


@cache
def albedo_tables() -> np.ndarray:
    """float32, all tables one after the other, read-only."""
    tables = np.load(FILE)
    tables.flags.writeable = False
    return tables
