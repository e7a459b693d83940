"""Standard deviations of theta with assumptions loosened: exact ties, one b, a model without error.

The assumptions are those of docs/fitting.md, "Assumptions loosened".
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from needlefit.arrays import Floats
from needlefit.inference.identifiability.directions import is_determined_by_data
from needlefit.inference.identifiability.information import (
    Linearized,
    add_estimated_noise,
    linearize,
    posterior_sds,
    prior_and_noise_information,
)
from needlefit.inference.likelihood.stated_errors import Discrepancy
from needlefit.inference.parameter_names import is_logarithmic
from needlefit.inference.parameters import MATERIAL_SPREAD, Parameters, loosen_ties
from needlefit.inference.problem import Problem

#: length (mm) over which the model's error fades along the needle: about that of a layer
MODEL_ERROR_LENGTH_MM = 15.0
#: smallest SD of the model's error, as a fraction of the rms deflection of the tips: a fit takes up much of
#: what its model misses, so that its residuals are too small to show it
MIN_MODEL_ERROR = 0.01

#: words for assumptions without which a parameter is not determined
MEAN_OF_SPECIMENS = "determined only as the mean of specimens, which differ"
STATED_TIES = "determined only under the stated ties"
NO_MODEL_ERROR = "determined only if the model has no error"

LOOSENED = "ties loosened and a model error"  #: words for the analysis with loosened ties and a model error


@dataclass(frozen=True)
class Loosened:
    """Standard deviations of theta with an assumption loosened, by parameter; the earlier ones are too."""

    condition: str
    sds: Mapping[str, float]


def loosen(
    problem: Problem,
    theta: Floats,
    sds: Mapping[str, float] | None = None,
    linearized: Linearized | None = None,
) -> tuple[Loosened, ...]:
    """Return the standard deviations at `theta` (P,) with ties loosened, and then with a model error.

    By `sds`, the standard deviations before, or by default those of the information: loosening adds to their
    squares what it adds by the information.
    """
    linearized = linearized or linearize(problem, theta)
    stated = posterior_sds(problem, theta, linearized)
    sds_before = stated if sds is None else sds
    values, parameters = problem.values(theta), loosen_ties(problem.parameters)
    loosened, problems = list[Loosened](), list[tuple[str, Problem, Linearized]]()
    if parameters != problem.parameters:
        problem, theta = problem.with_parameters(parameters), parameters.theta(values)
        linearized = linearize(problem, theta)
        problems.append((STATED_TIES, problem, linearized))
    allowing = replace(problem, model_error=estimate_model_error(problem, linearized))
    problems.append((NO_MODEL_ERROR, allowing, linearize(allowing, theta, linearized.points)))
    for condition, loosened_problem, there in problems:
        loose = posterior_sds(loosened_problem, theta, there)
        added = {name: math.sqrt(max(0.0, sd**2 - stated.get(name, 0.0) ** 2)) for name, sd in loose.items()}
        loosened.append(
            Loosened(condition, {n: math.hypot(sds_before.get(n, 0.0), more) for n, more in added.items()})
        )
    return tuple(loosened)


def find_condition(name: str, prior_sd: float, loosened: Sequence[Loosened]) -> str:
    """Return the condition under which alone a parameter is determined; empty if there is none."""
    for condition in loosened:
        if not is_determined_by_data(name, condition.sds[name], prior_sd):
            return condition.condition
    return ""


def find_tie_conditions(
    parameters: Parameters,
    determined: Mapping[str, bool],
    conditions: Mapping[str, str],
    loosened: Sequence[Loosened],
) -> dict[str, str]:
    """Return the conditions of exactly tied parameters: their source's, else that of the tie.

    Where the source is not determined, what is tied to it is neither. `determined` and `conditions` are of
    free parameters.
    """
    tie_conditions = {}
    for name, (_, source) in parameters.ties.items():
        if determined.get(source, False) and is_logarithmic(name):  # the tie alone gives it its spread
            tie_conditions[name] = find_condition(name, math.log(MATERIAL_SPREAD), loosened)
        else:
            tie_conditions[name] = conditions.get(source, "")
    return tie_conditions


def find_model_error(problem: Problem, theta: Floats) -> dict[str, float]:
    """Return the standard deviation that a model error adds to each free parameter, by its name."""
    noisy = add_estimated_noise(problem, theta)
    added = add_model_error(noisy, theta, linearize(noisy, theta))
    return dict(zip(problem.names, np.sqrt(np.diag(added)).tolist(), strict=True))


def add_model_error(problem: Problem, theta: Floats, linearized: Linearized) -> Floats:
    """Return the covariance (P, P) that a model error adds to that of theta, by the information there."""
    allowing = replace(problem, model_error=estimate_model_error(problem, linearized))
    covariances = [
        np.linalg.pinv(slope.T @ slope + prior_and_noise_information(variant), hermitian=True)
        for variant, slope in (
            (problem, linearized.slope),
            (allowing, linearize(allowing, theta, linearized.points).slope),
        )
    ]
    # the allowance adds variance in every direction; rounding may say otherwise where it adds none
    added, vectors = np.linalg.eigh(covariances[1] - covariances[0])
    return vectors * np.maximum(added, 0.0) @ vectors.T


def estimate_model_error(problem: Problem, linearized: Linearized) -> Discrepancy:
    """Return a model error of the size of the residuals beyond the noise, `MIN_MODEL_ERROR` at least.

    By moments: chi^2 exceeds the degrees of freedom by the sum of the variances that the error adds to the
    whitened residuals.
    """
    unit = Discrepancy(1.0, MODEL_ERROR_LENGTH_MM)
    squares = float(linearized.residuals @ linearized.residuals)
    excess = squares * (1.0 - 1.0 / linearized.chi_square) if linearized.chi_square > 1 else 0.0
    added = sum(
        float(
            np.sum(
                (observation.whitening @ block_diag(*[unit.covariance(s)] * observation.directions))
                * observation.whitening
            )
        )
        for observation in problem.density.observations
        for s in observation.nodes.s[:1]
    )
    tips = [insertion.deflection for insertion in problem.insertions]
    least = MIN_MODEL_ERROR * math.sqrt(float(np.mean(np.square(tips))))
    return Discrepancy(max(math.sqrt(excess / added), least), MODEL_ERROR_LENGTH_MM)
