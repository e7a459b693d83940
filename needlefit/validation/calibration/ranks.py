"""Where the truth stands among draws, and how often it stands in the middle of them."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

DRAWS = 79
"""Draws of each posterior: among them the truth has 80 places, of which every level is a whole part."""

LEVELS = (0.50, 0.80, 0.90, 0.95)
"""Central intervals whose coverage is counted."""


def ranks(truth: Floats, draws: Floats, rng: np.random.Generator) -> Counts:
    """Return how many of the draws (L, Q) lie below the truth (Q,); among equal ones it has any place."""
    below = np.sum(draws < truth, axis=0)
    equal = np.sum(draws == truth, axis=0)
    placed: Counts = below + rng.integers(0, equal + 1)
    return placed


def covered(ranks: Counts, level: float) -> int:
    """Return how many ranks (N,) lie in the central interval of a level."""
    outside = round((DRAWS + 1) * (1 - level) / 2)  # places at each end
    return int(np.sum((ranks >= outside) & (ranks < DRAWS + 1 - outside)))
