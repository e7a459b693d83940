"""Parameters whose posterior may be their prior, such as alpha: held in searches, drawn from the prior.

A search holds each at the centre of its prior. While the central 95 % of the prior move no measured point
by a tenth of the standard deviation of its error, the posterior of the parameter is its prior. Else it is
searched and sampled as all others are.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from needlefit.arrays import Floats
from needlefit.inference.draws import draw_from_prior
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.likelihood.observations import OBSERVATIONS, make_observation
from needlefit.inference.parameter_names import NOISE_SCALE, to_coordinate
from needlefit.inference.parameters import Parameters, Values
from needlefit.inference.problem import Problem

#: shift of a point by a held parameter, in SDs of the point's error, below which the data show nothing of it
MAX_HIDDEN_SHIFT = 0.1
#: likelihood of points as they are stored, of needles as deep and bevels as large as stated
POINTS_AS_STORED = {"depths": "fixed", "bevel_spread": 0.0, "measurement": "points"}


@dataclass(frozen=True)
class PriorShift:
    """How far the central 95 % of the prior of a parameter move the needles that are fitted to, at most."""

    tip_mm: float  #: any tip
    in_noise: float  #: any point, in standard deviations of its error; infinite where a solve fails

    @property
    def is_hidden(self) -> bool:
        """Whether the posterior of the parameter is its prior."""
        return self.in_noise < MAX_HIDDEN_SHIFT


def central_range(parameters: Parameters, name: str) -> tuple[float, float]:
    """Return the ends of the central 95 % of the prior of a held parameter, within its bounds."""
    (mean, sd), (low, high) = parameters.prior.marginals[name], parameters.bounds[name]
    reach = NORMAL_95_HALF_WIDTH_SD * sd
    return max(low, mean - reach), min(high, mean + reach)


def measure_shifts(problem: Problem, thetas: Floats) -> dict[str, PriorShift]:
    """Return by how much each held parameter moves the needles, at most over `thetas` (N, P).

    From the centre of its prior to either end, all other parameters as they are. A theta without a solution
    at the centre is left out.
    """
    parameters, sets = problem.parameters, list[Values]()
    for theta in parameters.extend(parameters.restrict(thetas)):
        centre = problem.values(theta)
        sets.append(centre)
        for name in parameters.held:
            for end in central_range(parameters, name):
                moved = theta.copy()
                moved[parameters.free.index(name)] = to_coordinate(name, end)
                sets.append(problem.values(moved))
    tips, by_noise = _compare_ends(problem, sets, 1 + 2 * len(parameters.held))  # (N, H, 2) each
    solved = np.isfinite(by_noise).any(axis=(1, 2))
    shifts = {}
    for number, name in enumerate(parameters.held):
        moved_tips, moved = (part[solved, number].ravel() for part in (tips, by_noise))
        in_noise = float(np.max(moved, initial=0.0))  # NaN where a solve fails
        tip_mm = float(np.nanmax(moved_tips, initial=0.0))
        shifts[name] = PriorShift(tip_mm, math.inf if math.isnan(in_noise) else in_noise)
    return shifts


def _compare_ends(problem: Problem, sets: Sequence[Values], size: int) -> tuple[Floats, Floats]:
    """Return how far tips, mm, and points, in SDs of their errors, lie from those of the first set.

    The largest over all insertions, (N, H, 2): of N times `size` sets, in which the ends of H parameters
    follow the centre. NaN where a solve fails.
    """
    scales = np.array([values.get(NOISE_SCALE, problem.density.scale) for values in sets[::size]])
    likelihood = problem.likelihood.model_copy(update=POINTS_AS_STORED)
    observations = []
    for insertion in problem.insertions:
        data, alone = OBSERVATIONS[insertion.observation].take_alone(problem.dataset, insertion)
        observations.append(make_observation(data, alone, problem.noise, likelihood, respond=problem.respond))
    model = PreparedModel(problem.medium, problem.insertions)
    ends = model.read_points(
        sets, [np.append(observation.nodes.s[0], observation.insertion.depth) for observation in observations]
    )
    tips, by_noise = [], []
    for observation, points in zip(observations, ends, strict=True):
        groups = points.reshape(-1, size, *points.shape[1:])  # (N, 1 + 2 H, K, 3)
        away = groups[:, 1:] - groups[:, :1]
        tips.append(np.linalg.norm(away[..., -1, :], axis=-1))
        shifts = observation.read(away[..., :-1, :])  # (N, 2 H, K), in space (N, 2 H, 2 K)
        sds = np.sqrt([np.diag(observation.covariance(scale)) for scale in scales])[:, None]
        relative = np.divide(shifts, sds, out=np.zeros_like(shifts), where=shifts != 0)
        by_noise.append(np.max(np.abs(relative), axis=-1))
    shape = (len(scales), -1, 2)
    return np.max(tips, axis=0).reshape(shape), np.max(by_noise, axis=0).reshape(shape)


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
