"""Draw initial walkers, wider than the posterior, and decide when their proposals are adapted.

Adaptation of the proposals:

Each learns from its own steps alone, and only after a few fixed ones. Between these it walks by fixed rules,
which have the density as their stationary one; what was walked before the last of them is burn-in. What an
ensemble knows follows from the steps that are kept, so that a run that goes on knows the same.
"""

from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import FitError
from needlefit.inference.sampling.ensembles import INDEPENDENT, WalkerState, parse_moves
from needlefit.inference.sampling.log_density import Evaluator, LaplaceApproximation
from needlefit.inference.sampling.proposal_density import ProposalDensity, fit_proposal, make_initial_proposal
from needlefit.schemas.recipe import SampleRecord

ENSEMBLE_SCATTER_SD, WALKER_SCATTER_SD = 2.0, 1.0
"""Standard deviations of the Laplace approximation by which ensembles are scattered about their point, and
the walkers of each about its middle."""

MAX_LOG_DENSITY_GAP = 10.0
"""No ensemble begins about a point whose log density is this much below the best point's."""

MAX_ATTEMPTS = 100
"""Redraws of walkers that begin where the density is 0, each time at half the scatter after ten."""


def initialize_walkers(
    evaluator: Evaluator,
    approximation: LaplaceApproximation,
    ends: Floats,
    settings: SampleRecord,
    rng: np.random.Generator,
) -> WalkerState:
    """Return the initial walkers: each ensemble about one of the points `ends` (M, P), the best first.

    Raises
    ------
    FitError
        If no starting point of positive density is found.
    """
    points = _select_plausible(evaluator, ends)
    legacy = np.random.RandomState(int(rng.integers(2**32)))  # all that emcee takes
    found = [
        _draw_walkers(evaluator, approximation, points[e % len(points)], settings.walkers, rng)
        for e in range(settings.ensembles)
    ]
    coordinates, density = (np.stack(part) for part in zip(*found, strict=True))
    return WalkerState(coordinates, density, tuple(legacy.get_state()))


def _select_plausible(evaluator: Evaluator, ends: Floats) -> Floats:
    """Return the points (M, P) that are not far worse than the first one, which stays."""
    found = evaluator(ends)
    good = found >= found[0] - MAX_LOG_DENSITY_GAP
    good[0] = True
    chosen: Floats = ends[good]
    return chosen


def _draw_walkers(
    evaluator: Evaluator,
    approximation: LaplaceApproximation,
    point: Floats,
    count: int,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return whitened starting points (W, P) of positive density, and its logarithm (W,)."""
    middle = ENSEMBLE_SCATTER_SD * rng.normal(size=len(point))
    chosen, known = np.empty((0, len(point))), np.empty(0)
    for attempt in range(MAX_ATTEMPTS):
        # the scatter is halved after every ten attempts without enough points
        shrink = 0.5 ** (attempt // 10)
        z = shrink * (middle + WALKER_SCATTER_SD * rng.normal(size=(count, len(point))))
        thetas = _reflect_at_bounds(
            point + z @ approximation.axes.T, evaluator.problem.lower, evaluator.problem.upper
        )
        density = evaluator(thetas)
        good = np.isfinite(density)
        chosen = np.concatenate([chosen, approximation.whitened(thetas[good])])
        known = np.concatenate([known, density[good]])
        if len(chosen) >= count:
            return chosen[:count], known[:count]
    raise FitError(
        "no starting points of positive density were found around the best fit",
        fix="tune with more evaluations, or widen the bounds",
    )


def _reflect_at_bounds(thetas: Floats, lower: Floats, upper: Floats) -> Floats:
    """Return thetas reflected at the bounds: cut off there, many would lie on one bound and span nothing."""
    # a triangle wave of period 2 in units of the range: reflection at both bounds, any number of times
    cube = np.abs((thetas - lower) / (upper - lower)) % 2
    folded: Floats = lower + (1 - np.abs(1 - cube)) * (upper - lower)
    return folded


ADAPTATION_STEPS = (50, 150, 500, 1200, 3000)
"""Steps after which proposals are fitted anew, to the second half of them."""


def list_adaptation_steps(settings: SampleRecord) -> tuple[int, ...]:
    """Return the steps after which proposals are adapted, each within the first half of the budget."""
    if INDEPENDENT not in parse_moves(settings.moves):
        return ()
    return tuple(step for step in ADAPTATION_STEPS if 2 * step <= settings.steps)


def last_adaptation_step(settings: SampleRecord, done: int) -> int:
    """Return the last of the first `done` steps after which proposals were adapted; 0 if there was none."""
    return max((step for step in list_adaptation_steps(settings) if step <= done), default=0)


def block_length(settings: SampleRecord, done: int) -> int:
    """Return the number of steps to the next snapshot; an adaptation or the budget ends a block."""
    remaining = settings.steps - done
    return min(
        settings.check_interval,
        remaining,
        *(step - done for step in list_adaptation_steps(settings) if step > done),
    )


def make_proposal_densities(settings: SampleRecord, coordinates: Floats) -> Sequence[ProposalDensity]:
    """Return the independent proposals of each ensemble after the steps (E, S, W, P)."""
    ensembles, done, _, dimensions = coordinates.shape
    last = last_adaptation_step(settings, done)
    if not last:
        return [make_initial_proposal(dimensions)] * ensembles
    return [fit_proposal(visited.reshape(-1, dimensions)) for visited in coordinates[:, last // 2 : last]]
