"""Evaluate many densities by the needles as measured, and interpolate what moved depths and bevels do.

A density simulates every insertion at 3 to 11 nodes (`likelihood.nodes`): as measured, and with each
uncertain depth and the bevel moved to both sides. How the residuals of the others differ from the first's
varies smoothly with theta. They are simulated at some 100 thetas, and between these interpolated by cubic
radial basis functions.

Of every call some thetas are evaluated exactly as well, more of those with a large density. Where these err
by more than `MAX_RMS_ERROR` they join the points that are interpolated between; where that does not help, all
thetas of the call that matter are evaluated exactly.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from needlefit.arrays import Bools, Floats, Ints
from needlefit.inference.likelihood.observation import append_pose_curves
from needlefit.inference.parameters import HYPERPARAMETERS
from needlefit.inference.problem import SETS_AT_ONCE, Problem

FIRST_POINTS = 100  #: thetas at which all nodes are simulated first
THETAS_PER_CHECK = 32  #: of a call, one in so many is evaluated exactly too
MAX_RMS_ERROR = 0.02  #: largest rms error of the log density of these
MAX_REFINEMENTS = 4  #: times that checked thetas of one call may join the points
#: fall of the log density below the best of a call from which on a theta does not matter
NEGLIGIBLE_FALL = 10.0


class InterpolatedDensity:
    """The log posterior of a problem by interpolated nodes.

    Given the thetas `points` (n, P), it interpolates between these alone, and checks nothing by itself.
    """

    def __init__(self, problem: Problem, jobs: int, points: Floats | None = None) -> None:
        self._problem, self._density, self._jobs = problem, problem.density, jobs
        self._fixed = points is not None
        #: the coordinates that needles depend on
        self._columns = [k for k, name in enumerate(problem.names) if name not in HYPERPARAMETERS]
        self._nodes = [len(one.nodes.insertions) for one in self._density.observations]
        self._points = np.empty((0, len(self._columns)))
        self._moves: list[Floats] = []  # (n, F) of all insertions
        if points is not None:
            self._learn(points, self._evaluate(points)[1])

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (N,) of thetas (N, P) within the bounds; NaN where a solve fails."""
        found, exact = np.full(len(thetas), np.nan), np.zeros(len(thetas), dtype=bool)
        count = 0 if self._fixed else min(max(FIRST_POINTS - len(self._points), 0), len(thetas))
        if count:
            found[:count], moves = self._evaluate(thetas[:count])
            exact[:count] = True
            self._learn(thetas[:count], moves)
        sets = [self._problem.values(theta) for theta in thetas]
        first = list(self._density.whitened_residuals(sets, self._jobs, as_measured=True))
        for _ in range(MAX_REFINEMENTS):
            rest = np.flatnonzero(~exact)
            found[rest] = self._interpolate(
                thetas[rest], [sets[k] for k in rest], [one[rest] for one in first]
            )
            rows = np.arange(0) if self._fixed else self._choose_checks(found, exact)
            if not len(rows):
                return found
            claimed = found[rows]
            found[rows], moves = self._evaluate(thetas[rows])
            exact[rows] = True
            if find_rms(found[rows] - claimed) <= MAX_RMS_ERROR:
                return found
            self._learn(thetas[rows], moves)
        rest = np.flatnonzero(~exact & (found > np.nanmax(found) - NEGLIGIBLE_FALL))
        found[rest] = self._evaluate(thetas[rest])[0]
        return found

    def find_error(self, thetas: Floats) -> float:
        """Return the rms error of the interpolated log densities of thetas (N, P)."""
        return find_rms(self._evaluate(thetas)[0] - self(thetas))

    def _choose_checks(self, found: Floats, exact: Bools) -> Ints:
        """Return the rows to be checked: of those that matter, more of the largest densities."""
        rows = np.flatnonzero(~exact & (found > np.nanmax(found, initial=-np.inf) - NEGLIGIBLE_FALL))
        order = rows[np.argsort(-found[rows], kind="stable")]
        count = math.ceil(len(found) / THETAS_PER_CHECK)
        return order[np.unique((len(order) * (np.arange(count) / count) ** 2).astype(np.intp))[: len(order)]]

    def _evaluate(self, thetas: Floats) -> tuple[Floats, Floats]:
        """Return the exact log densities (N,), and what the moved nodes add to the residuals, (N, F)."""
        densities, moves = [np.empty(0)], list[Floats]()
        for start in range(0, len(thetas), SETS_AT_ONCE):
            sets = [self._problem.values(theta) for theta in thetas[start : start + SETS_AT_ONCE]]
            white = list(self._density.whitened_residuals(sets, self._jobs))
            densities.append(self._density.add_up(white, sets))
            parts = [one[:, 1:nodes] - one[:, :1] for one, nodes in zip(white, self._nodes, strict=True)]
            moves.append(np.concatenate([part.reshape(len(sets), -1) for part in parts], axis=1))
        return np.concatenate(densities), np.concatenate(moves) if moves else np.empty((0, 0))

    def _learn(self, thetas: Floats, moves: Floats) -> None:
        """Interpolate between these points too, where all their nodes have a solution."""
        from scipy.interpolate import RBFInterpolator  # late: it takes 0.3 s to load

        solved = np.isfinite(moves).all(axis=1)
        self._points = np.concatenate([self._points, thetas[solved][:, self._columns]])
        self._moves.append(moves[solved])
        if len(self._points) > len(self._columns):
            self._function = RBFInterpolator(
                self._points, np.concatenate(self._moves), kernel="cubic", degree=1
            )

    def _interpolate(
        self, thetas: Floats, sets: Sequence[Mapping[str, float]], first: Sequence[Floats]
    ) -> Floats:
        """Return the log densities (N,), given the residuals (N, 1, R) of the needles as measured."""
        densities = [np.empty(0)]
        for start in range(0, len(thetas), SETS_AT_ONCE):
            some = slice(start, start + SETS_AT_ONCE)
            moves, white, place = self._function(thetas[some][:, self._columns]), [], 0
            for one, nodes, observation in zip(first, self._nodes, self._density.observations, strict=True):
                shape = len(moves), nodes - 1, observation.rows
                end = place + shape[1] * shape[2]
                moved = one[some] + moves[:, place:end].reshape(shape)
                white.append(append_pose_curves(observation, np.concatenate([one[some], moved], axis=1)))
                place = end
            densities.append(self._density.add_up(white, sets[some]))
        return np.concatenate(densities)


def find_rms(errors: Floats) -> float:
    """Return the root mean square; infinite with an error that is not finite."""
    return float(np.sqrt(np.mean(errors**2))) if np.all(np.isfinite(errors)) else math.inf
