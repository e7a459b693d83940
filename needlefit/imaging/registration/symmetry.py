"""Whether a layout of markers can be taken for itself the wrong way round, under the noise of its markers.

A permutation of the known markers has a misfit m^2: the chi-squared that its best rigid motion leaves when
there is no noise. With noise, the wrong pairing's chi-squared exceeds the right one's by a Gaussian number of
mean m^2 and deviation 2 m. A wrong pairing is noticed in 99 % only if that exceeds `pairing.GAP` in 99 %,
which asks for m >= z + sqrt(z^2 + GAP), z = 2.33. Permutations below that are the layout's symmetries.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import norm

from needlefit.geometry.frames import Floats
from needlefit.imaging.registration.marker_sets import marker_sets
from needlefit.imaging.registration.pairing import GAP, search
from needlefit.imaging.registration.rigid import kabsch

NOTICED = 0.99
"""Share of wrong pairings that must be noticed."""

_Z = float(norm.ppf(NOTICED))
CLEAR = (_Z + np.sqrt(_Z**2 + GAP)) ** 2
"""Misfit m^2 from which on a permutation is told from the right pairing."""


def symmetries(known: ArrayLike, sd: ArrayLike) -> NDArray[np.int64]:
    """Return the permutations (S, N) that lay `known` (N, 3) on itself within the noise; the identity first.

    `sd` is the deviation of a pair, found and known together, per direction, mm: a number or one per marker.
    Only turns count: a layout that is merely its own mirror image has the identity alone.
    """
    sets = marker_sets(known, known, sd, 0.0)
    points, variance = sets.known, sets.bound
    pair = np.maximum(variance, variance.T)  # the noisier of the two: no symmetry is missed
    rows = search(points, points, pair, len(points), CLEAR)
    moved = np.count_nonzero(rows != np.arange(len(points)), axis=1)
    ordered: NDArray[np.int64] = rows[np.argsort(moved, kind="stable")]
    return ordered


def interchangeable(permutations: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    """Return the groups of markers that the permutations (S, N) carry into each other; singles left out."""
    count = permutations.shape[1]
    carried = np.zeros((count, count))
    carried[np.tile(np.arange(count), len(permutations)), permutations.ravel()] = 1
    groups, group = connected_components(csr_array(carried), directed=False)
    names = [tuple(np.flatnonzero(group == g).tolist()) for g in range(groups)]
    return tuple(name for name in names if len(name) > 1)


def turn_of(known: Floats, permutation: NDArray[np.int64]) -> tuple[float, Floats]:
    """Return angle (degrees) and axis (3,) of the turn that carries each marker to its permuted one."""
    rotation = kabsch(known, known[permutation], np.ones(len(known))).rotation
    angle = float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
    values, vectors = np.linalg.eigh((rotation + rotation.T) / 2)
    axis: Floats = vectors[:, np.argmax(values)]
    return angle, axis * np.sign(axis[np.argmax(np.abs(axis))])
