"""Find under which assumptions a parameter is determined: with ties loosened, and with an error of the model.

The information at the optimum is computed again, with one Jacobian each, first with the ties loosened
(`loosen_ties`), then with a model error added to that. Errors that insertions share are in the likelihood
already.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.identifiability.precision import (
    is_determined_by_data,
    linearize,
    posterior_sds,
)
from needlefit.inference.likelihood.operators import Discrepancy
from needlefit.inference.parameters import MATERIAL_SPREAD, Parameters, is_logarithmic, loosen_ties
from needlefit.inference.problem import Problem

MODEL_ERROR_LENGTH_MM = 15.0
"""Length over which the model's error fades along the needle: about that of a layer."""

MIN_MODEL_ERROR = 0.01
"""Standard deviation of the model's error, as part of the rms deflection of the tips, at least: a fit takes
up much of what its model misses, so that its residuals are too small to say."""

STATED_TIES = "determined only under the stated ties"
NO_MODEL_ERROR = "determined only if the model has no error"
"""Assumptions without which a parameter is not determined."""

LOOSENED = "ties loosened and a model error"


@dataclass(frozen=True)
class Loosened:
    """Standard deviations of theta with an assumption loosened, by parameter; the earlier ones are too."""

    condition: str
    sds: Mapping[str, float]


def loosen(problem: Problem, theta: Floats, sds: Mapping[str, float] | None = None) -> tuple[Loosened, ...]:
    """Return the standard deviations at `theta` (P,) with ties loosened, and then with a model error.

    By `sds`, the standard deviations before, or by default those of the information: loosening adds to their
    squares what it adds by the information.
    """
    stated = posterior_sds(problem, theta)
    known = stated if sds is None else sds
    found = []
    for condition, one in _list_loosened(problem, theta):
        loose = posterior_sds(one, one.parameters.theta(problem.values(theta)))
        added = {name: math.sqrt(max(0.0, sd**2 - stated.get(name, 0.0) ** 2)) for name, sd in loose.items()}
        found.append(
            Loosened(condition, {n: math.hypot(known.get(n, 0.0), more) for n, more in added.items()})
        )
    return tuple(found)


def find_condition(name: str, prior_sd: float, loosened: Sequence[Loosened]) -> str:
    """Return the condition under which alone a parameter is determined; empty if there is none."""
    for one in loosened:
        if not is_determined_by_data(name, one.sds[name], prior_sd):
            return one.condition
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
    found = {}
    for name, (_, source) in parameters.ties.items():
        if determined.get(source, False) and is_logarithmic(name):  # the tie alone gives it its spread
            found[name] = find_condition(name, math.log(MATERIAL_SPREAD), loosened)
        else:
            found[name] = conditions.get(source, "")
    return found


def estimate_model_error(problem: Problem, theta: Floats) -> Discrepancy:
    """Return a model error of the size of the residuals beyond the noise, `MIN_MODEL_ERROR` at least.

    By moments: chi^2 exceeds the degrees of freedom by the sum of the variances that the error adds to the
    whitened residuals.
    """
    unit = Discrepancy(1.0, MODEL_ERROR_LENGTH_MM)
    residuals, _, chi_square = linearize(problem, theta)
    squares = float(residuals @ residuals)
    excess = squares * (1.0 - 1.0 / chi_square) if chi_square > 1 else 0.0
    added = sum(
        float(np.sum((one.whitening @ unit.covariance(s)) * one.whitening))
        for one in problem.density.observations
        for s in one.nodes.s[:1]
    )
    tips = [one.deflection for one in problem.insertions]
    least = MIN_MODEL_ERROR * math.sqrt(float(np.mean(np.square(tips))))
    return Discrepancy(max(math.sqrt(excess / added), least), MODEL_ERROR_LENGTH_MM)


def _list_loosened(problem: Problem, theta: Floats) -> Iterator[tuple[str, Problem]]:
    loose = loosen_ties(problem.parameters)
    if loose != problem.parameters:
        problem, values = problem.with_parameters(loose), problem.values(theta)
        theta = loose.theta(values)
        yield STATED_TIES, problem
    yield NO_MODEL_ERROR, replace(problem, model_error=estimate_model_error(problem, theta))
