"""The Gaussian that touches a density at its peak: in its coordinates ridges are round.

Curvatures are differences of the log density over steps that it answers itself: in each parameter the longest
of a ladder over which it falls by no more than `FALL`. What it does not tell, the bounds do.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LogDensity = Callable[[Floats], Floats]
"""Log densities (W,) of thetas (W, P), -inf where there is none."""

FALL = 0.5
"""Of the log density over one step: a standard deviation's worth, if all other parameters are held."""

LADDER = 0.25 * 0.5 ** np.arange(0, 16)
"""Steps that are tried, as parts of the range."""

UNIFORM = 12.0
"""Precision of a uniform distribution, by its width squared."""

INSIDE = 1e-3
"""A point at a bound is taken this part of the range inside: differences need both sides."""


@dataclass(frozen=True)
class Laplace:
    """theta = centre + axes @ z, with z standard normal as far as the density is Gaussian.

    Attributes
    ----------
    centre : (P,) array
    axes : (P, P) array
        Columns: principal directions times their standard deviations, sloppiest first.
    """

    centre: Floats
    axes: Floats

    def thetas(self, z: Floats) -> Floats:
        """Return the thetas (..., P) of whitened coordinates (..., P)."""
        found: Floats = self.centre + z @ self.axes.T
        return found

    def whitened(self, thetas: Floats) -> Floats:
        """Return the whitened coordinates (..., P) of thetas (..., P)."""
        found: Floats = (thetas - self.centre) @ np.linalg.inv(self.axes).T
        return found


def laplace(log_density: LogDensity, centre: Floats, lower: Floats, upper: Floats) -> Laplace:
    """Return the approximation about `centre` (P,), no wider in any direction than the bounds (P,) imply."""
    width = upper - lower
    inner = np.clip((centre - lower) / width, INSIDE, 1 - INSIDE)  # in the unit cube

    def at(points: Floats) -> Floats:
        return log_density(lower + points * width)

    with np.errstate(invalid="ignore"):  # -inf less -inf: nothing is told there
        steps = _steps(at, inner)
        information = _information(at, inner, steps) / np.outer(steps, steps)
    precisions, directions = np.linalg.eigh(information)
    sds = 1.0 / np.sqrt(np.maximum(precisions, 0.0) + UNIFORM)
    return Laplace(lower + inner * width, width[:, None] * directions * sds)


def _steps(at: LogDensity, centre: Floats) -> Floats:
    """Return the step (P,) of each parameter."""
    steps = np.minimum(LADDER[:, None], np.minimum(centre, 1 - centre))  # (L, P), within the cube
    moves = steps[:, :, None] * np.eye(len(centre))  # (L, P, P)
    ends = np.concatenate([[centre], *(centre + sign * moves.reshape(-1, len(centre)) for sign in (1, -1))])
    found = at(ends)
    falls = (found[0] - np.min(found[1:].reshape(2, *steps.shape), axis=0)) <= FALL  # (L, P)
    chosen = np.where(falls.any(axis=0), np.argmax(falls, axis=0), len(LADDER) - 1)
    picked: Floats = steps[chosen, np.arange(len(centre))]
    return picked


def _information(at: LogDensity, centre: Floats, steps: Floats) -> Floats:
    """Return the negative second differences (P, P) over one step of each parameter."""
    moves, dimensions = np.diag(steps), len(steps)
    pairs = list(combinations(range(dimensions), 2))
    signs = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    corners = [a * moves[i] + b * moves[j] for i, j in pairs for a, b in signs]
    found = at(centre + np.array([np.zeros(dimensions), *moves, *-moves, *corners]))
    plus, minus, four = np.split(found[1:], [dimensions, 2 * dimensions])
    information = np.diag(2 * found[0] - plus - minus)
    for (i, j), (pp, mm, pm, mp) in zip(pairs, four.reshape(-1, 4), strict=True):
        information[i, j] = information[j, i] = (pm + mp - pp - mm) / 4
    known: Floats = np.where(np.isfinite(information), information, 0.0)
    return known
