"""Parameters that data may not tell from their prior, such as alpha: held in searches, drawn from it.

A search holds each at the centre of its prior. While the central 95 % of its prior move no residual by more
than a tenth of the noise, the data cannot tell it: its posterior is its prior. Else it is searched and
sampled as all others are.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from needlefit.arrays import Floats
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.parameter_names import to_coordinate
from needlefit.inference.parameters import Parameters
from needlefit.inference.predict import draw_from_prior
from needlefit.inference.problem import Problem

MAX_HIDDEN_SHIFT = 0.1  #: standard deviations of the noise by which a held parameter may move a residual


@dataclass(frozen=True)
class PriorShift:
    """How far the central 95 % range of the prior of a parameter moves the needles that are fitted to."""

    tip_mm: float  #: any tip, at most
    in_noise: float  #: any residual, which have unit variance, at most; infinite where a solve fails

    @property
    def is_hidden(self) -> bool:
        """Whether the data cannot tell the parameter from its prior."""
        return self.in_noise < MAX_HIDDEN_SHIFT


def central_range(parameters: Parameters, name: str) -> tuple[float, float]:
    """Return the ends of the central 95 % of the prior of a held parameter, within its bounds."""
    (mean, sd), (low, high) = parameters.prior.marginals[name], parameters.bounds[name]
    reach = NORMAL_95_HALF_WIDTH_SD * sd
    return max(low, mean - reach), min(high, mean + reach)


def measure_shifts(problem: Problem, thetas: Floats) -> dict[str, PriorShift]:
    """Return by how much each held parameter moves the needles, at most over `thetas` (N, P).

    From the centre of its prior to either end, all other parameters as they are. Points that have no solution
    there are left out.
    """
    known, found = problem.parameters, dict[str, PriorShift]()
    for theta in known.extend(known.restrict(thetas)):
        sets = [theta]
        for name in known.held:
            for end in central_range(known, name):
                sets.append(theta.copy())
                sets[-1][known.free.index(name)] = to_coordinate(name, end)
        tips, residuals = _simulate(problem, np.array(sets))
        if not np.all(np.isfinite(residuals[0])):
            continue
        for number, name in enumerate(known.held):
            ends = slice(1 + 2 * number, 3 + 2 * number)
            moved = float(np.max(np.linalg.norm(tips[ends] - tips[0], axis=-1), initial=0.0))
            by_noise = float(np.max(np.abs(residuals[ends] - residuals[0]), initial=0.0))
            before = found.get(name, PriorShift(0.0, 0.0))
            in_noise = by_noise if math.isfinite(by_noise) else math.inf
            found[name] = PriorShift(max(before.tip_mm, moved), max(before.in_noise, in_noise))
    return found


def _simulate(problem: Problem, thetas: Floats) -> tuple[Floats, Floats]:
    """Return the tips (N, I, 2 or 3) of all insertions, mm, and their residuals (N, R)."""
    sets, searched = [problem.values(theta) for theta in thetas], problem.searched
    places = [goal.s[-1:] for goal in problem.compared_points]
    tips = PreparedModel(problem.medium, problem.insertions).read_points(sets, places)
    count = sum(searched.density.residual_counts)
    residuals = [one[:count] for one, _ in searched.density.jacobians(sets)]
    return np.stack([points[:, 0] for points in tips], axis=1), np.array(residuals)


def draw_held(parameters: Parameters, thetas: Floats, rng: np.random.Generator) -> Floats:
    """Return draws (N, P) of all free parameters, from draws (N, S) of those that are searched.

    Those held are independent draws of their prior.
    """
    if not parameters.held:
        return thetas
    columns = [parameters.free.index(name) for name in parameters.held]
    return parameters.extend(thetas, draw_from_prior(parameters, len(thetas), rng)[:, columns])


def log_prior_integral(parameters: Parameters) -> float:
    """Return the logarithm of the integral of the prior of all held parameters, 1 at its centre."""
    total, marginals = 0.0, parameters.prior.marginals
    for name in parameters.held:
        (mean, sd), bounds = marginals[name], parameters.bounds[name]
        low, high = ((to_coordinate(name, end) - mean) / sd for end in bounds)
        total += math.log(math.sqrt(2 * math.pi) * sd * (ndtr(high) - ndtr(low)))
    return total


def describe_shift(shifts: Mapping[str, PriorShift], name: str) -> str:
    """Return in words that the data cannot tell a parameter."""
    return f"the prior: moves tips by at most {shifts[name].tip_mm:.2g} mm"
