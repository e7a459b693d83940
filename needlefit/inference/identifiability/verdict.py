"""Which parameters the data determine, and which only in combination: the rules of docs/fitting.md.

The information at the optimum is local, profile likelihoods are not: what a profile leaves open is not
determined.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.error_fit import find_search_tolerance
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.directions import (
    MAX_LOG_SD,
    MAX_SD_RATIO,
    MAX_SHAPE_SD,
    Direction,
    is_determined_by_data,
    principal_directions,
)
from needlefit.inference.identifiability.information import (
    add_estimated_noise,
    compute_sds,
    find_bounds,
    linearize,
    prior_information,
)
from needlefit.inference.identifiability.loosened_assumptions import (
    LOOSENED,
    MEAN_OF_SPECIMENS,
    Loosened,
    add_model_error,
    find_condition,
    find_tie_conditions,
    loosen,
)
from needlefit.inference.parameter_names import is_logarithmic
from needlefit.inference.problem import Problem

#: largest range among equal starts, in posterior standard deviations, of a parameter called determined
MAX_RANGE_SD = 4.0
#: largest difference of a start's log posterior from the best one's that is within tolerance
LOG_POSTERIOR_TOLERANCE = 0.1
MIN_NAMED_WEIGHT = 0.1  #: smallest weight of a direction that the note of a parameter names


@dataclass(frozen=True)
class Identifiability:
    """Which free parameters the data determine, and how well; mappings are keyed by parameter name."""

    sds: Mapping[str, float]  #: posterior standard deviation, of the logarithm (of a shape parameter itself)
    determined: Mapping[str, bool]  #: whether the data determine it by itself
    at_bound: Mapping[str, str]  #: "lower" or "upper" where the best point lies at a bound, else ""
    #: spread_low, spread_high: its range among the starts within tolerance of the best (Pa, mm)
    spread_low: Mapping[str, float]
    spread_high: Mapping[str, float]
    directions: tuple[Direction, ...]  #: principal directions of the information, best known first
    notes: Mapping[str, str]  #: one sentence for a person
    together: Mapping[str, bool] = field(default_factory=dict)  #: the same while all others are held
    #: under which assumption alone the data determine it, "" otherwise
    conditions: Mapping[str, str] = field(default_factory=dict)
    #: the standard deviations with assumptions loosened; none where nothing is determined anyway
    loosened: tuple[Loosened, ...] = ()
    #: by how much an error of the model lets each parameter vary beside the posterior: SD, as `sds`
    model_error: Mapping[str, float] = field(default_factory=dict)


def identify(
    problem: Problem, fit: Fit, draws: Floats | None = None, further: Floats | None = None
) -> Identifiability:
    """Return what the data determine at the best point of a fit, given `draws` (B, P) of its posterior.

    Where several specimens were fitted these are of their mean, and `further` (B, P) are in another specimen.
    Of parameters that are held nothing is returned.
    """
    restrict = problem.parameters.restrict
    ends = [s.theta for s in fit.starts if within_tolerance(s, fit)] or [fit.theta]
    equal = restrict(np.array(ends, dtype=np.float64).reshape(len(ends), len(problem.names)))
    theta, problem = restrict(np.array(fit.theta)), problem.searched
    draws, further = (None if some is None else restrict(some) for some in (draws, further))
    names = problem.names
    noisy = add_estimated_noise(problem, theta)
    linearized = linearize(noisy, theta)
    computed_sds, information = compute_sds(noisy, theta, draws, linearized)
    sds, before = dict(zip(names, computed_sds.tolist(), strict=True)), prior_information(noisy)
    added = add_model_error(noisy, theta, linearized)
    # pinv: a direction without information has no variance to add to
    wider = np.linalg.pinv(np.linalg.pinv(information, hermitian=True) + added, hermitian=True)
    directions = principal_directions(wider.astype(np.float64), names, before)
    together = find_together(names, information, before)
    bounds = dict(zip(names, find_bounds(problem, theta), strict=True))
    ranges = dict(zip(names, np.ptp(equal, axis=0).tolist(), strict=True))
    prior = problem.parameters.prior
    informed = {n: not bounds[n] and sds[n] < MAX_SD_RATIO * prior.sd(n) for n in names}
    limits = {n: MAX_LOG_SD if is_logarithmic(n) else MAX_SHAPE_SD for n in names}
    nominally = {
        n: informed[n] and sds[n] < limits[n] and ranges[n] < MAX_RANGE_SD * limits[n] for n in names
    }
    loosened = loosen(noisy, theta, sds, linearized) if any(nominally.values()) else ()
    if loosened and further is not None:
        apart = dict(zip(names, np.std(further, axis=0).tolist(), strict=True))
        apart |= {name: apart.get(source, 0.0) for name, (_, source) in problem.parameters.ties.items()}
        loosened = (Loosened(MEAN_OF_SPECIMENS, apart), *loosened)
    conditions = {n: find_condition(n, prior.sd(n), loosened) if nominally[n] else "" for n in names}
    determined = {n: nominally[n] and not conditions[n] for n in names}
    conditions |= find_tie_conditions(problem.parameters, determined, conditions, loosened)
    low, high = (problem.values(end(equal, axis=0)) for end in (np.min, np.max))
    notes = {}
    for k, n in enumerate(names):
        if bounds[n]:
            note = f"not determined: it lies at its {bounds[n]} bound"
        elif determined[n]:
            note = f"determined, also with {LOOSENED}"
        elif conditions[n]:
            note = conditions[n]
        else:
            # the best-known combination that the parameter is part of, if any is known
            combinations = [
                direction.words
                for direction in directions
                if abs(direction.weights[k]) >= MIN_NAMED_WEIGHT
                and direction.sd < MAX_LOG_SD
                and direction.is_informed
            ]
            note = "not determined" + (" alone" if combinations else "")
            if is_logarithmic(n):
                note += ": equally good starts disagree" if sds[n] < MAX_LOG_SD else ""
            note = "; ".join([note, *combinations[:1]])
        notes[n] = note
    return Identifiability(
        sds=sds,
        determined=determined,
        together=together,
        conditions=conditions,
        loosened=loosened,
        model_error=dict(zip(names, np.sqrt(np.diag(added)).tolist(), strict=True)),
        at_bound=bounds,
        spread_low={n: low[n] for n in names},
        spread_high={n: high[n] for n in names},
        directions=directions,
        notes=notes,
    )


def find_together(names: Sequence[str], information: Floats, prior: Floats) -> dict[str, bool]:
    """Return which parameters the data determine while all others are held, by information (P, P)."""
    # the diagonal of the information is that on each parameter given all others
    held = zip(names, *(1 / np.sqrt(np.diag(matrix)) for matrix in (information, prior)), strict=True)
    return {name: is_determined_by_data(name, sd, prior_sd) for name, sd, prior_sd in held}


def within_tolerance(start: Start, fit: Fit) -> bool:
    """Return whether the objective of a start is within tolerance of the best start's."""
    return objective_excess(start, fit) <= 1.0


def objective_excess(start: Start, fit: Fit) -> float:
    """Return the objective of a start minus the best one, in units of the tolerance."""
    tolerance = LOG_POSTERIOR_TOLERANCE
    if fit.minimized != "posterior":
        tolerance = find_search_tolerance(fit.objective)
    return (start.objective - fit.objective) / tolerance if math.isfinite(fit.objective) else math.inf
