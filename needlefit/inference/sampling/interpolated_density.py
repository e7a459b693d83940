"""Evaluate many densities, and interpolate between the residuals of those that were simulated.

How the residuals at the nodes (`likelihood.nodes`) differ from those of the needle as measured varies
smoothly with theta; see docs/inference.md, section 8.

Of every call some thetas are evaluated exactly as well, more of those with a large density. Where these err
by more than `MAX_RMS_ERROR` the needles as measured are simulated, and the thetas join the points that are
interpolated between; where that does not help, all thetas of the call that matter are evaluated exactly.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from needlefit.arrays import Bools, Floats, Ints
from needlefit.inference.likelihood.observation import append_pose_curves
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.inference.problem import Problem

FIRST_POINTS = 100  #: number of thetas at which all nodes are simulated first
SIMULATED_POINTS = 300  #: number of thetas at which the needles as measured are simulated first
#: largest depth of all insertions together (mm) at which the needles as measured are always simulated: that
#: costs less than to interpolate
SHALLOW_MM = 40.0
MAX_POINTS = 1000  #: largest number of interpolated points: to solve the system of 3 000 takes half a second
#: largest number of values of all points, and of residuals as measured, that are held at once
MAX_VALUES = 2**23
THETAS_PER_CHECK = 32  #: number of thetas of a call of which one is evaluated exactly too
MAX_RMS_ERROR = 0.02  #: largest rms error of the log density at these
MAX_REFINEMENTS = 4  #: largest number of times that checked thetas of one call join the points
#: difference of the log density from the best of a call beyond which a theta does not matter
NEGLIGIBLE_FALL = 10.0


class InterpolatedDensity:
    """The log posterior of a problem by interpolated residuals."""

    def __init__(self, problem: Problem, jobs: int) -> None:
        self._problem, self._density, self._jobs = problem, problem.density, jobs
        #: the coordinates that needles depend on
        self._columns = [k for k, name in enumerate(problem.names) if name not in HYPERPARAMETERS]
        self._nodes = [len(observation.nodes.insertions) for observation in self._density.observations]
        #: what moved nodes add to the residuals (F,), and the residuals (R,) as measured, of all insertions
        self._moves, self._first = _Interpolation(), _Interpolation()
        self.fixed = False  #: whether nothing is added any more, and calls check nothing

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (N,) of thetas (N, P) within the bounds; NaN where a solve fails."""
        size = max(1, MAX_VALUES // sum(observation.rows for observation in self._density.observations))
        parts = [self._evaluate_some(thetas[n : n + size]) for n in range(0, len(thetas), size)]
        return np.concatenate([np.empty(0), *parts])

    def _evaluate_some(self, thetas: Floats) -> Floats:
        logs, exact = np.full(len(thetas), np.nan), np.zeros(len(thetas), dtype=bool)
        moves_of_one = sum(
            (nodes - 1) * observation.rows
            for nodes, observation in zip(self._nodes, self._density.observations, strict=True)
        )
        first_points = min(FIRST_POINTS, count_points(len(self._columns), moves_of_one))
        count = 0 if self.fixed else min(max(first_points - self._moves.count, 0), len(thetas))
        if count:
            logs[:count], moves = self._evaluate(thetas[:count])
            exact[:count] = True
            self._moves.add(thetas[:count, self._columns], moves)
        sets, columns = [self._problem.values(theta) for theta in thetas], thetas[:, self._columns]
        depth = sum(insertion.depth for insertion in self._problem.insertions)
        simulated = depth <= SHALLOW_MM or self._first.failed or self._first.count < SIMULATED_POINTS
        first = self._simulate(columns, sets) if simulated else self._first(columns)
        for _ in range(MAX_REFINEMENTS):
            rest = np.flatnonzero(~exact)
            logs[rest] = self._add_up(columns[rest], [sets[k] for k in rest], first[rest])
            rows = np.arange(0) if self.fixed else self._choose_checks(logs, exact)
            if not len(rows):
                return logs
            claimed = logs[rows]
            logs[rows], moves = self._evaluate(thetas[rows])
            exact[rows] = True
            if find_rms(logs[rows] - claimed) <= MAX_RMS_ERROR:
                return logs
            self._moves.add(columns[rows], moves)
            if not simulated:
                first, simulated = self._simulate(columns, sets), True
        rest = np.flatnonzero(~exact & (logs > np.nanmax(logs) - NEGLIGIBLE_FALL))
        logs[rest] = self._evaluate(thetas[rest])[0]
        return logs

    def find_error(self, thetas: Floats) -> float:
        """Return the rms error of the interpolated log densities of thetas (N, P)."""
        return find_rms(self._evaluate(thetas)[0] - self(thetas))

    def _choose_checks(self, logs: Floats, exact: Bools) -> Ints:
        """Return the rows to be checked: of those that matter, more of the largest densities."""
        rows = np.flatnonzero(~exact & (logs > np.nanmax(logs, initial=-np.inf) - NEGLIGIBLE_FALL))
        order = rows[np.argsort(-logs[rows], kind="stable")]
        count = math.ceil(len(logs) / THETAS_PER_CHECK)
        return order[np.unique((len(order) * (np.arange(count) / count) ** 2).astype(np.intp))[: len(order)]]

    def _evaluate(self, thetas: Floats) -> tuple[Floats, Floats]:
        """Return the exact log densities (N,), and what the moved nodes add to the residuals, (N, F)."""
        densities, moves = [np.empty(0)], list[Floats]()
        for some in self._density.split(len(thetas)):
            sets = [self._problem.values(theta) for theta in thetas[some]]
            white = list(self._density.whitened_residuals(sets, self._jobs))
            densities.append(self._density.add_up(white, sets))
            parts = [
                whitened[:, 1:nodes] - whitened[:, :1]
                for whitened, nodes in zip(white, self._nodes, strict=True)
            ]
            moves.append(np.concatenate([part.reshape(len(sets), -1) for part in parts], axis=1))
        return np.concatenate(densities), np.concatenate(moves) if moves else np.empty((0, 0))

    def _simulate(self, columns: Floats, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Return the residuals (N, R) of the needles as measured, from simulations; keep them."""
        simulated = []
        for some in self._density.split(len(sets)):
            parts = self._density.whitened_residuals(sets[some], self._jobs, as_measured=True)
            simulated.append(np.concatenate([part[:, 0] for part in parts], axis=1))
        first = np.concatenate(simulated)
        if not self.fixed:
            self._first.add(columns, first)
        return first

    def _add_up(self, columns: Floats, sets: Sequence[Mapping[str, float]], first: Floats) -> Floats:
        """Return the log densities (N,), given the residuals (N, R) of the needles as measured."""
        densities = [np.empty(0)]
        for some in self._density.split(len(columns)):
            moves, white, place, row = self._moves(columns[some]), [], 0, 0
            for nodes, observation in zip(self._nodes, self._density.observations, strict=True):
                rows = observation.rows
                shape, end = (len(moves), nodes - 1, rows), place + (nodes - 1) * rows
                block = first[some, None, row : row + rows]
                moved = block + moves[:, place:end].reshape(shape)
                white.append(append_pose_curves(observation, np.concatenate([block, moved], axis=1)))
                place, row = end, row + rows
            densities.append(self._density.add_up(white, sets[some]))
        return np.concatenate(densities)


def count_points(dimensions: int, values: int) -> int:
    """Return how many points with so many values each are interpolated between.

    These are `MAX_POINTS`, or fewer where more would hold over `MAX_VALUES` numbers.
    """
    return min(MAX_POINTS, max(2 * dimensions + 2, MAX_VALUES // max(1, values)))


class _Interpolation:
    """Values at points, interpolated between the last of those that are finite."""

    def __init__(self) -> None:
        self._known: tuple[Floats, Floats] | None = None
        self._function: Callable[[Floats], Floats] | None = None
        self._by_weights = False  #: whether the function gives the weights of the points, and no values
        self.count = 0  #: points that were added
        self.failed = False  #: whether there were points of other values

    def add(self, points: Floats, values: Floats) -> None:
        """Interpolate between these points (N, P) and values (N, F) too."""
        solved = np.isfinite(values).all(axis=1)
        most = count_points(points.shape[1], values.shape[1])
        new = points[solved][-most:], values[solved][-most:]
        if self._known:
            left_out = max(0, len(self._known[0]) + len(new[0]) - most)
            places, those = (
                np.concatenate([before[left_out:], after])
                for before, after in zip(self._known, new, strict=True)
            )
            new = places, those
        self._known, self._function = new, None
        self.count += int(solved.sum())
        self.failed |= not solved.all()

    def __call__(self, points: Floats) -> Floats:
        """Return the values (N, F) at points (N, P)."""
        assert self._known is not None
        places, values = self._known
        if self._function is None:
            from scipy.interpolate import RBFInterpolator  # late: it takes 0.3 s to load

            # a quadratic has so many terms, and wants as many points again
            smooth = len(places) >= (places.shape[1] + 1) * (places.shape[1] + 2)
            kernel: Literal["quintic", "cubic"] = "quintic" if smooth else "cubic"
            # it keeps what it is given twice: of many values weights take less memory and time
            self._by_weights = values.shape[1] > len(places)
            given = np.eye(len(places)) if self._by_weights else values
            self._function = RBFInterpolator(places, given, kernel=kernel, degree=1 + smooth)
        interpolated = np.asarray(self._function(points), dtype=np.float64)
        return interpolated @ values if self._by_weights else interpolated


def find_rms(errors: Floats) -> float:
    """Return the root mean square; infinite with an error that is not finite."""
    return float(np.sqrt(np.mean(errors**2))) if np.all(np.isfinite(errors)) else math.inf
