"""Fit one candidate to some insertions, and compute the predictive density of another insertion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.inference.baseline_fit import CurveDensity
from needlefit.inference.identifiability.gauss_newton import minimize_squares
from needlefit.inference.parameters import (
    NOISE_SCALE,
    Parameters,
    dimension,
    is_shape_parameter,
    with_hyperparameters,
)
from needlefit.inference.planned_layers import with_planned_layers
from needlefit.inference.sampling.importance import (
    ZERO_DENSITY,
    PredictiveDensity,
    WeightedDraws,
    compute_predictive_density,
    escalate_effort,
    find_modes,
    sample_about_modes,
    sample_by_importance,
    select_distinct,
)
from needlefit.inference.sampling.log_density import approximate_by_laplace
from needlefit.mechanics.laws import LAWS
from needlefit.project.random_streams import random_stream
from needlefit.schemas.medium import MediumRecord, ParameterRecord, use_path_angle
from needlefit.studies.folds import Fold
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.comparison.schema import PATH_ANGLE
from needlefit.studies.posterior_fit import find_fit
from needlefit.studies.score import Predictor, curve_predictor, model_predictor

MAX_NOISE_FACTOR = 1000.0
"""Largest noise factor: a candidate that misses by millimetres where points err by hundredths needs it."""


@dataclass(frozen=True)
class ModelCandidate:
    """A fitted candidate: its parameters, its curve and its posterior.

    Attributes
    ----------
    values : mapping
        Its parameters at its greatest density (Pa, mm; curves: mm^-(k + 1)), the noise factor among them.
    predictor : Predictor
        The curve of these.
    known : WeightedDraws
        Its posterior.
    after : callable
        Insertion -> its posterior after this one too; None where it has no simulated needle.
    """

    values: Mapping[str, float]
    predictor: Predictor
    known: WeightedDraws
    after: Callable[[Insertion], WeightedDraws | None]

    def predict_density(self, insertion: Insertion) -> PredictiveDensity:
        """Return the predictive density of all points of an insertion together."""
        both = self.after(insertion)
        return ZERO_DENSITY if both is None else compute_predictive_density(both, self.known)


def fit_candidate(name: str, job: Job, fold: Fold, settings: Settings) -> ModelCandidate | None:
    """Fit the candidate `name` to the insertions of a fold; None after a stop."""
    simulated = name in LAWS or name == PATH_ANGLE
    return _fit_law(job, fold, settings) if simulated else _fit_curve(name, job, fold)


def candidate_job(name: str, job: Job) -> Job:
    """Return the job of one candidate: with its law or rule, if it is one, and an estimated noise factor."""
    medium = _with_law(job.medium, name) if name in LAWS else job.medium
    medium = use_path_angle(medium) if name == PATH_ANGLE else medium
    # empirical curves are given from the entry on, so all candidates are compared by the stored points
    likelihood = job.recipe.likelihood.model_copy(
        update={"noise_scale": "estimated", "measurement": "points"}
    )
    return replace(
        job,
        name=f"{job.name} {name}",
        medium=medium,
        parameters=with_hyperparameters(Parameters.from_record(medium), likelihood, MAX_NOISE_FACTOR),
        recipe=job.recipe.model_copy(update={"likelihood": likelihood}),
        hand_tuned=None,
    )


def _with_law(medium: MediumRecord, law: str) -> MediumRecord:
    """Return the medium of another law: its shape parameters are kept to what that law is meant for.

    Those that the other law does not have are left out; those that only it has are free.
    """
    names = LAWS[law].shape_names or ("alpha",)
    changed = {
        name: _keep_within(name, parameter, law) if is_shape_parameter(name) else parameter
        for name, parameter in medium.parameters.items()
        if not is_shape_parameter(name) or dimension(name) in names
    }
    return medium.model_copy(update={"law": law, "parameters": changed})


def _keep_within(name: str, parameter: ParameterRecord, law: str) -> ParameterRecord:
    """Return a shape parameter within the law's bounds, or fixed where the law has none."""
    if not LAWS[law].parameters:
        return ParameterRecord(fixed=1.0)
    low, high = next(one.bounds for one in LAWS[law].parameters if one.name == dimension(name))
    if parameter.bounds is not None:
        bounds = max(parameter.bounds[0], low), min(parameter.bounds[1], high)
        return parameter.model_copy(update={"bounds": bounds})
    fixed = None if parameter.fixed is None else min(max(parameter.fixed, low), high)
    return parameter.model_copy(update={"fixed": fixed})


def _fit_law(job: Job, fold: Fold, settings: Settings) -> ModelCandidate | None:
    problem, seed, needle = job.problem(fold), job.recipe.seed, job.dataset.needle
    fit = find_fit(job, problem, (fold.name,), settings)
    if settings.stop():
        return None
    width = problem.upper - problem.lower
    ends = find_modes(fit, width)

    def after(insertion: Insertion) -> WeightedDraws | None:
        met = with_planned_layers(insertion, fit.values, job.medium, needle)
        if met is None:
            return None
        both = replace(problem, insertions=(*problem.insertions, met))
        # the modes move when an insertion is added: importance sampling starts from those of the larger
        # problem
        settled = [minimize_squares(both, end) for end in ends]
        peaks = select_distinct((one.theta for one in settled if np.isfinite(one.value)), width)
        if not len(peaks):
            return None
        rng = random_stream(seed, job.name, fold.name, "weighed", insertion.id)
        return escalate_effort(lambda effort: sample_about_modes(both, peaks, rng, settings.jobs, effort))

    rng = random_stream(seed, job.name, fold.name, "weighed")
    known = escalate_effort(lambda effort: sample_about_modes(problem, ends, rng, settings.jobs, effort))
    return ModelCandidate(fit.values, model_predictor(fit.values, job.medium, job.dataset), known, after)


def _fit_curve(name: str, job: Job, fold: Fold) -> ModelCandidate:
    density = CurveDensity(name, job.dataset, fold.tune, job.recipe.likelihood, MAX_NOISE_FACTOR)

    def after(*insertions: Insertion) -> WeightedDraws:
        both = replace(density, insertions=(*fold.tune, *insertions))
        about = [approximate_by_laplace(both, both.peak, both.lower, both.upper)]
        keys = (one.id for one in insertions)
        rng = random_stream(job.recipe.seed, job.name, fold.name, "weighed", *keys)
        return escalate_effort(
            lambda effort: sample_by_importance(both, about, (both.lower, both.upper), rng, effort)
        )

    best = density.curve(density.peak)
    coefficients = {f"c{k}": value for k, value in enumerate(best.coefficients)}
    values = {**coefficients, NOISE_SCALE: float(np.exp(density.peak[-1]))}
    return ModelCandidate(values, curve_predictor(best.curve), after(), after)
