"""The insertion that the solver's benchmarks share: 55 steps, a 150 mm needle of 18G solid wire, four layers.

Parameter sets are drawn within 30 % of the nominal ones, evenly, from a fixed seed.
"""

import numpy as np

from needlefit.mechanics.batch import Batch
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue

DEPTH = 55.0
NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
TISSUE = Tissue(
    mu=np.array([0.2, 33.0, 0.2, 33.0]),
    alpha=np.array([1.0, -1.0, 1.0, -1.0]),
    boundaries=np.array([20.0, 28.0, 45.0]),
)
BEVEL = Bevel(0.085)
SPREAD = 0.3


def batch(count: int, tolerance: float, depth: float = DEPTH, tissue: Tissue = TISSUE) -> Batch:
    """Return the insertion with `count` parameter sets: mu and alpha of every layer, and the offset.

    The first sets of a longer batch are those of a shorter one.
    """
    n = tissue.layers
    spread = np.random.default_rng(1).uniform(1.0 - SPREAD, 1.0 + SPREAD, (count, 2 * n + 1))
    return Batch(
        NEEDLE, tissue, (Step(depth, BEVEL),), ModelOptions(tolerance=tolerance),
        mu=tissue.mu * spread[:, :n], shape=(tissue.alpha * spread[:, n:-1])[:, None],
        offset=BEVEL.offset * spread[:, -1],
    )  # fmt: skip
