"""Iterated closest points, from a rough pose: what is near enough to begin with ends in the nearest minimum.

P. J. Besl, N. D. McKay, IEEE Trans. Pattern Anal. 14 (1992) 239. Closest is asked of both sides, so that
spurious and missing markers find no partner. From a poor beginning it ends in a wrong pairing without a
word; `register` therefore never trusts it alone.
"""

import numpy as np
from scipy.spatial import cKDTree

from needlefit.geometry.frames import Floats, Frame
from needlefit.imaging.registration.marker_sets import FEWEST, MarkerSets
from needlefit.imaging.registration.rigid import Pairs, kabsch

ROUNDS = 100
"""Rounds at most; a handful is taken."""

APART = 4.0
"""Deviations of a length, beyond which a final pair is none."""


def icp(sets: MarkerSets, rough: Frame) -> Pairs:
    """Return the pairs (P, 2) in which closest points end from the `rough` frame of the scan in the world.

    Pairs that stay further apart than `APART` deviations are left out, the worst first, as long as three
    remain.
    """
    frame, pairs = rough, np.empty((0, 2), dtype=np.int64)
    for _ in range(ROUNDS):
        closest = _mutual(frame.to_world(sets.found), sets.known)
        if len(closest) < FEWEST or np.array_equal(closest, pairs):
            break
        pairs = closest
        frame = _fit(sets, pairs)
    while len(pairs) > FEWEST:
        away = np.linalg.norm(frame.to_world(sets.found[pairs[:, 0]]) - sets.known[pairs[:, 1]], axis=1)
        sd = np.sqrt(3 * sets.bound[pairs[:, 0], pairs[:, 1]])
        worst = int(np.argmax(away / sd))
        if away[worst] <= APART * sd[worst]:
            break
        pairs = np.delete(pairs, worst, axis=0)
        frame = _fit(sets, pairs)
    return pairs


def _fit(sets: MarkerSets, pairs: Pairs) -> Frame:
    weights = 1 / sets.bound[pairs[:, 0], pairs[:, 1]]
    return kabsch(sets.found[pairs[:, 0]], sets.known[pairs[:, 1]], weights)


def _mutual(here: Floats, there: Floats) -> Pairs:
    to_known = np.asarray(cKDTree(there).query(here)[1], dtype=np.int64)
    to_found = np.asarray(cKDTree(here).query(there)[1], dtype=np.int64)
    both = np.flatnonzero(to_found[to_known] == np.arange(len(here)))
    return np.column_stack([both, to_known[both]])
