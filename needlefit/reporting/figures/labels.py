"""Names over lines that may stand close together."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LETTER, SPACE = 1.3, 1.5
"""Width of a letter of 7 points and least space between two names, mm on paper."""


def spread(places: Sequence[float], names: Sequence[str], scale: float) -> Floats:
    """Return where names stand so that none touches the next: over their places, or as near as may be.

    Parameters
    ----------
    places : sequence of float
        What the names are of, increasing, in the panel's units.
    names : sequence of str
    scale : float
        mm on paper per unit.
    """
    widths = LETTER * np.array([len(name) for name in names])
    gaps = (widths[1:] + widths[:-1]) / 2 + SPACE
    offsets = np.concatenate([[0.0], np.cumsum(gaps)])
    return apart(np.asarray(places) * scale, offsets) / scale


def apart(places: Sequence[float] | Floats, offsets: Floats) -> Floats:
    """Return the places nearest to increasing `places` (N,) at least as far apart as `offsets` (N,)."""
    # with the least distances taken off, names may coincide but not change places: means of runs that did
    runs: list[tuple[float, int]] = []
    for wish in np.asarray(places) - offsets:
        mean, count = float(wish), 1
        while runs and runs[-1][0] > mean:
            before, more = runs.pop()
            mean, count = (mean * count + before * more) / (count + more), count + more
        runs.append((mean, count))
    at: Floats = np.repeat([mean for mean, _ in runs], [count for _, count in runs]) + offsets
    return at
