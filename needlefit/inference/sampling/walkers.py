"""Where the walkers of several ensembles begin: wider than the posterior, so that it tells if they agree."""

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import FitError
from needlefit.inference.sampling.ensembles import State
from needlefit.inference.sampling.evaluator import Evaluator
from needlefit.inference.sampling.laplace import Laplace
from needlefit.schemas.recipe import SampleRecord

Floats = NDArray[np.float64]

APART, WIDE = 2.0, 1.0
"""Standard deviations of the Laplace approximation by which ensembles are scattered about their point, and
the walkers of each about its middle."""

PLAUSIBLE = 10.0
"""No ensemble begins about a point whose log density is this much below the best point's."""

ATTEMPTS = 100
"""Redraws of walkers that begin where the density is 0, each time at half the scatter after ten."""


def begin(
    evaluator: Evaluator, about: Laplace, ends: Floats, settings: SampleRecord, rng: np.random.Generator
) -> State:
    """Return where all walkers begin: each ensemble about one of the points `ends` (M, P), the best first.

    Raises
    ------
    FitError
        If no starting point of positive density is found.
    """
    points = _plausible(evaluator, ends)
    legacy = np.random.RandomState(int(rng.integers(2**32)))  # all that emcee takes
    found = [
        _walkers(evaluator, about, points[e % len(points)], settings.walkers, rng)
        for e in range(settings.ensembles)
    ]
    coordinates, density = (np.stack(part) for part in zip(*found, strict=True))
    return State(coordinates, density, tuple(legacy.get_state()))


def _plausible(evaluator: Evaluator, ends: Floats) -> Floats:
    """Return the points (M, P) that are not far worse than the first one, which stays."""
    found = evaluator(ends)
    good = found >= found[0] - PLAUSIBLE
    good[0] = True
    chosen: Floats = ends[good]
    return chosen


def _walkers(
    evaluator: Evaluator, about: Laplace, point: Floats, count: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return whitened starting points (W, P) of positive density, and its logarithm (W,)."""
    middle = APART * rng.normal(size=len(point))
    chosen, known = np.empty((0, len(point))), np.empty(0)
    for attempt in range(ATTEMPTS):
        shrink = 0.5 ** (attempt // 10)
        z = shrink * (middle + WIDE * rng.normal(size=(count, len(point))))
        thetas = _folded(point + z @ about.axes.T, evaluator.problem.lower, evaluator.problem.upper)
        density = evaluator(thetas)
        good = np.isfinite(density)
        chosen = np.concatenate([chosen, about.whitened(thetas[good])])
        known = np.concatenate([known, density[good]])
        if len(chosen) >= count:
            return chosen[:count], known[:count]
    raise FitError(
        "no starting points of positive density were found around the best fit",
        fix="tune with more evaluations, or widen the bounds",
    )


def _folded(thetas: Floats, lower: Floats, upper: Floats) -> Floats:
    """Return thetas reflected at the bounds: cut off there, many would lie on one bound and span nothing."""
    cube = np.abs((thetas - lower) / (upper - lower)) % 2
    folded: Floats = lower + (1 - np.abs(1 - cube)) * (upper - lower)
    return folded
