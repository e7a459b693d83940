"""What may have happened to all needles alike: they are turned, or shifted, or a boundary lies elsewhere.

A boundary that lies elsewhere changes the model: all needles are fitted again, and it is named only where
errors alone are left, of parameters that a soft tissue and a bevel have. Where the law of the tissue is
another, stiff layers and flat cuts may describe the needles; where the guide, or tissue at the entry, gave
way toward the bevels, another boundary may: that is asked too, and not named.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.compared import MIN_LOG_ODDS, SIGNIFICANT_SD
from needlefit.inference.hypotheses import (
    ASIDE,
    HYPOTHESES,
    IN_PLANE,
    LOG_FITTED,
    SEARCH_STEPS,
    START_SIZES,
    Change,
    Deviation,
    Explanation,
    explain,
    list_boundaries,
    search_sizes,
)
from needlefit.inference.linear_needles import Prediction, fit_quickly, linearize_needles, predict_from, refit
from needlefit.inference.plausible import list_implausible
from needlefit.inference.posterior_density import KnownPoints
from needlefit.inference.problem import Problem
from needlefit.project.unit_warnings import LENGTH_UNITS

#: least shift of a boundary that is named: beside one a needle bends over (EI / mu)^(1/4), 6 to 15 mm, and an
#: error of the model looks like a shift by a part of it
MIN_SHIFT_MM = 5.0


def change_all(problem: Problem, change: Change, size: float) -> Problem:
    """Return the problem with all needles as they may have been."""
    return replace(problem, insertions=tuple(change.apply(one, size) for one in problem.insertions))


def find_common(problem: Problem, theta: Floats) -> Explanation | None:
    """Return what may have happened to all needles alike, if that makes them far more probable.

    `theta` (P,): the fit to them.
    """
    count = sum(problem.density.residual_counts)

    simulated = KnownPoints()  # of these needles: turns and shifts change what was measured alone

    def predict(changed: Problem, fitted: Floats, known: KnownPoints | None = None) -> Prediction:
        uses = np.ones((1, len(changed.insertions)), dtype=bool)
        blocks = linearize_needles(changed, changed.insertions, fitted, known=known)
        return predict_from(changed, blocks, uses, fitted)[0]

    before = predict(problem, theta, simulated)

    def search(change: Change) -> tuple[dict[float, Deviation], float]:
        """Search the size of what happened in turn with the other parameters.

        About a fit needles are linear in both; but for those that are simulated anew, each with its own fit.
        """
        fits, size, changes_model = {0.0: theta}, 0.0, change.row.changes_model
        nearby = simulated  # about the fit in use: of a needle 0.4 MB

        def measure(sizes: Sequence[float]) -> list[Deviation]:
            return [measure_one(size) for size in sizes]

        def measure_one(size: float) -> Deviation:
            changed, fitted = change_all(problem, change, size), fits[min(fits, key=lambda k: abs(k - size))]
            if changes_model:
                fitted = fits[size] = refit(changed, changed.insertions, fitted)
            after = predict(changed, fitted, None if changes_model else nearby)
            is_plausible = not list_implausible(problem.values(fitted), problem.medium.constraint_spacing_mm)
            is_right = not changes_model or (is_plausible and after.describes(count))
            gain = after.log_density - before.log_density
            return Deviation(0.0 if is_right else math.inf, gain, max(1.0, after.chi_square))

        for _ in range(SEARCH_STEPS):
            found, sd = search_sizes(measure, change.starts)
            likeliest = max(found, key=lambda k: found[k].log_density)
            gain, moved = found[likeliest].log_density, abs(likeliest - size)
            if changes_model or gain <= LOG_FITTED or moved < sd / 2:
                break
            # the fit to needles as measured may have ended far away
            fits = {likeliest: fit_quickly(change_all(problem, change, likeliest), fits[size])}
            size, nearby = likeliest, KnownPoints()
        return found, sd

    # of bevels that all face one way an error of the model looks like any change in their plane
    is_one_sided = len({insertion.side for insertion in problem.insertions}) == 1
    in_plane = () if is_one_sided else (*_list_poses(problem, IN_PLANE), *list_boundary_shifts(problem))
    aside = _list_poses(problem, ASIDE) if problem.dataset.directions == 2 else ()
    # of 147 sound sets of benchmarks/mistakes.py none has log odds above 0.7
    found = explain([*in_plane, *aside], search, 0.0, MIN_LOG_ODDS)
    if found is None or not found.is_clear or not found.change.row.is_mistake:
        return None
    stated_sd = max(insertion.boundary_sd for insertion in problem.insertions)
    least = max(MIN_SHIFT_MM, SIGNIFICANT_SD * max(stated_sd, found.sd))
    return found if not found.change.row.changes_model or abs(found.size) >= least else None


def _list_poses(problem: Problem, axis: int) -> Iterator[Change]:
    """Yield turns and shifts of all needles; shapes of unknown pose are aligned: they change nothing."""
    for cause, row in HYPOTHESES.items() if problem.dataset.pose != "free" else ():
        if row.common_sizes and (row.axes or axis == IN_PLANE):
            yield Change(cause, axis, starts=row.common_sizes, cost=LOG_FITTED)


def list_boundary_shifts(problem: Problem) -> Iterator[Change]:
    """Yield for each boundary that it lies elsewhere, between its neighbours, in all needles.

    None where depths are crossings of surfaces; with noise that is estimated any boundary describes needles.
    """
    first, *others = insertions = problem.insertions
    if problem.likelihood.noise_scale == "estimated" or any(insertion.surfaces for insertion in insertions):
        return
    boundaries = list_boundaries(first, others)
    for where, (number, deepest) in boundaries.items():
        ends = np.array([0.0, *deepest.boundaries, max(insertion.depth for insertion in insertions)])
        low, stated, high = ends[number : number + 3]
        # from these a search begins, too: on an even grid alone it ended in a local optimum, 8 mm off
        depths = [factor * stated for factor in LENGTH_UNITS.values()]
        units = {float(depth - stated) for depth in depths if stated < depth < high}
        evenly = np.linspace(low, high, START_SIZES)[1:-1] - stated
        cost = LOG_FITTED + math.log(len(boundaries))
        yield Change(
            "boundary", IN_PLANE, where, (number, deepest), {0.0, *units, *evenly.tolist()}, units, cost
        )
