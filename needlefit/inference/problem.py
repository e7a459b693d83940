"""A fit as an optimisation problem: theta in; metric objective, residuals or log posterior out.

The metric objective is how far one simulated needle lies from the measured one, in the paper's own errors,

    ipe * mean_j IPE_j  +  te * TE  +  edp * TE / max(|measured deflection|, edp_floor_mm)            (mm)

with the recipe's weights; edp_floor_mm is about the noise of a tip: a deflection below it says nothing.
A distance |d| has a kink at 0, where it has no gradient; here it is sqrt(d^2 + e^2) - e with e =
`SMOOTHING_MM`, which is smooth and at most e shorter.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, Noise, TipTrack
from needlefit.datasets.select import list_bevels
from needlefit.errors import ConfigError
from needlefit.geometry.curves import ComparedCurves, compare_curves
from needlefit.inference.compared_points import (
    ComparedPoints,
    align,
    align_points,
    differentiate_align,
    make_curve,
    select_points,
)
from needlefit.inference.forward_model import PreparedModel, make_batch, predict
from needlefit.inference.likelihood.observation import PLAIN_LIKELIHOOD, Discrepancy, make_observation
from needlefit.inference.objective import EVALUATION_ERRORS, ObjectiveFunction
from needlefit.inference.parameters import BEVEL_SPREAD, Parameters, Theta, with_hyperparameters
from needlefit.inference.posterior_density import PosteriorDensity
from needlefit.inference.side_by_side import evaluate
from needlefit.mechanics.batch import simulate_batches
from needlefit.mechanics.shape import NeedleShape
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, ObjectiveName, WeightsRecord

#: distance below which a distance counts as squared, mm: less than any measured centreline is known to
SMOOTHING_MM = 1e-4


def metric_misfit(simulated: Floats, measured: Floats, weights: WeightsRecord) -> float:
    """Return the metric misfit of one insertion, mm; points (K, 2) run from the entry to the tip."""
    off = simulated - measured  # (K, 2)
    distances = np.sqrt(np.sum(off**2, axis=1) + SMOOTHING_MM**2) - SMOOTHING_MM  # (K,)
    return float(_station_weights(measured, weights) @ distances)


def metric_misfit_gradient(
    simulated: Floats, measured: Floats, weights: WeightsRecord, slopes: Floats
) -> Floats:
    """Return the derivatives (P,) of `metric_misfit`, given those of the simulated points, (K, 2, P)."""
    off = simulated - measured
    along = off / np.sqrt(np.sum(off**2, axis=1) + SMOOTHING_MM**2)[:, None]  # (K, 2)
    return np.einsum("k,ki,kip->p", _station_weights(measured, weights), along, slopes)


def _station_weights(measured: Floats, weights: WeightsRecord) -> Floats:
    """Return the weight (K,) of the distance at each station."""
    deflection = abs(float(measured[-1, 1] - measured[0, 1]))
    station_weights = np.full(len(measured), weights.ipe / len(measured))
    # the tip error and EDP count the last station alone, on top of its share of IPE
    station_weights[-1] += weights.te + weights.edp / max(deflection, weights.edp_floor_mm)
    return station_weights


GUIDE_DISTANCE = "guide_distance_mm"

#: noise with the same deviation at all points, mm; its size hardly matters
UNIFORM_NOISE = Noise(point_sd=0.1)


@dataclass(frozen=True)
class Problem:
    """Some insertions of one dataset, the model of a medium, and the parameters that are searched."""

    dataset: Dataset  #: for its needle, its noise and how its shapes are compared
    insertions: tuple[Insertion, ...]  #: the ones fitted to
    medium: MediumRecord
    parameters: Parameters
    weights: WeightsRecord  #: of the objective
    noise: Noise | None = None  #: replaces what the dataset states, where it states none
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD  #: what is made of noise and uncertain depths
    model_error: Discrepancy | None = None  #: a misfit of the model that is allowed for beside the noise
    #: whether b is the mean of these insertions' own; else of others, from which all may differ
    centred_bevels: bool = True

    def __post_init__(self) -> None:
        if not self.insertions:
            raise ConfigError("no insertion is selected to fit to", expected="at least one")
        tracked = any(isinstance(one, TipTrack) for one in self.insertions)
        if tracked and GUIDE_DISTANCE not in self.parameters.names:
            raise ConfigError(
                "the tissue model does not state the guide's distance",
                key="parameters",
                expected=f"{GUIDE_DISTANCE}: from the guide to the skin, free or fixed",
            )

    def __reduce__(self) -> tuple[type["Problem"], tuple[object, ...]]:
        # what is computed once is computed anew elsewhere: it refers to objects of this process
        return type(self), tuple(getattr(self, field.name) for field in fields(self))

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return self.parameters.lower

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return self.parameters.upper

    @property
    def squares(self) -> bool:
        """Whether the log posterior is a constant minus half the residuals' squares."""
        return self.likelihood.depths != "quadrature"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of theta."""
        return self.parameters.free

    def values(self, theta: Theta) -> dict[str, float]:
        """Return every parameter's value (Pa, mm)."""
        return self.parameters.values(theta)

    def shapes(self, theta: Theta) -> tuple[NeedleShape, ...]:
        """Return the simulated needle of each insertion."""
        values = self.values(theta)
        return tuple(predict(values, self.medium, self.dataset.needle, i) for i in self.insertions)

    def points(self, theta: Theta) -> tuple[tuple[Floats, Floats], ...]:
        """Return the simulated and the measured points (K, 2) compared in each insertion, mm."""
        trios = zip(self.insertions, self.compared_points, self.shapes(theta), strict=True)
        return tuple(align_points(goal, make_curve(shape, one)) for one, goal, shape in trios)

    def compare(self, theta: Theta) -> tuple[ComparedCurves, ...]:
        """Return each simulated needle beside the measured one."""
        return tuple(compare_curves(*pair) for pair in self.points(theta))

    def objective(self, theta: Theta) -> float:
        """Return the mean of `metric_misfit` over insertions, mm; infinite if any solve fails."""
        return evaluate(self._objectives, np.asarray(theta))

    def objective_gradient(self, theta: Theta) -> tuple[float, Floats]:
        """Return `objective` and its exact gradient (P,); NaN where a solve fails."""
        return evaluate(self._objective_gradients, np.asarray(theta))

    def _objectives(self, thetas: Floats, jobs: int) -> list[float]:
        goals, total = self.compared_points, np.zeros(len(thetas))
        points = self._model.read_points(self._list_values(thetas), [goal.s for goal in goals], jobs)
        for goal, simulated in zip(goals, points, strict=True):
            aligned = align(goal.pose, simulated, goal.measured)
            total += [metric_misfit(one, goal.measured, self.weights) for one in aligned]
        return [math.inf if math.isnan(one) else float(one) / len(goals) for one in total]

    def _objective_gradients(self, thetas: Floats, jobs: int) -> list[tuple[float, Floats]]:
        goals, sets = self.compared_points, self._list_values(thetas)
        total, slope = np.zeros(len(sets)), np.zeros((len(sets), len(self.names)))
        pairs = self._model.differentiate(sets, self.parameters, [goal.s for goal in goals], jobs)
        for goal, simulated, by in zip(goals, *pairs, strict=True):
            slopes = differentiate_align(goal.pose, simulated, goal.measured, by)
            aligned = align(goal.pose, simulated, goal.measured)
            for b in range(len(sets)):
                total[b] += metric_misfit(aligned[b], goal.measured, self.weights)
                slope[b] += metric_misfit_gradient(aligned[b], goal.measured, self.weights, slopes[b])
        return [(float(total[b]) / len(goals), slope[b] / len(goals)) for b in range(len(sets))]

    def _list_values(self, thetas: Floats) -> list[dict[str, float]]:
        return [self.values(theta) for theta in thetas]

    @cached_property
    def _model(self) -> PreparedModel:
        """The forward model of the insertions as measured."""
        return PreparedModel(self.medium, self.dataset.needle, self.insertions)

    def residuals(self, theta: Theta) -> Floats:
        """Return the whitened residuals (R,) of all insertions in turn; NaN where a solve fails.

        Behind them stand what normalises the density, where that depends on theta, and the prior's residuals.
        log_posterior = constant - |residuals|^2 / 2 within the bounds; where depths are integrated by
        quadrature the density is no Gaussian, and the residuals are those of their linear effect.
        """
        return self.density.residuals(self.values(theta))

    def jacobian(self, theta: Theta) -> tuple[Floats, Floats]:
        """Return the residuals (R,) and their exact derivatives (R, P) by theta; NaN where a solve fails."""
        return evaluate(self._jacobians, np.asarray(theta))

    def gradient(self, theta: Theta) -> tuple[float, Floats]:
        """Return `log_posterior` and its exact gradient (P,); NaN where a solve fails or theta is outside."""
        if not self._inside(theta):
            return float("-inf"), np.full(len(self.names), np.nan)
        return evaluate(self._gradients, np.asarray(theta))

    def log_posterior(self, theta: Theta) -> float:
        """Return the log of the unnormalised posterior density in theta.

        The prior is flat in theta within the bounds (moduli and lengths are log-uniform), times what the
        medium states. -inf outside, NaN where a solve fails: the density is not known there.
        """
        return evaluate(self._log_densities, np.asarray(theta)) if self._inside(theta) else float("-inf")

    def log_posteriors(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return `log_posterior` (W,) of many thetas (W, P) at once, on `jobs` threads."""
        density = np.full(len(thetas), -np.inf)
        inside = np.flatnonzero(np.all((thetas >= self.lower) & (thetas <= self.upper), axis=1))
        if len(inside):
            density[inside] = self._log_densities(thetas[inside], jobs)
        return density

    def _log_densities(self, thetas: Floats, jobs: int) -> list[float]:
        return list(map(float, self.density.log_densities(self._list_values(thetas), jobs)))

    def _gradients(self, thetas: Floats, jobs: int) -> list[tuple[float, Floats]]:
        return self.density.gradients(self._list_values(thetas), jobs)

    def _jacobians(self, thetas: Floats, jobs: int) -> list[tuple[Floats, Floats]]:
        return self.density.jacobians(self._list_values(thetas), jobs)

    def _inside(self, theta: Theta) -> bool:
        at = np.asarray(theta)
        return bool(np.all(at >= self.lower) and np.all(at <= self.upper))

    def approach(self, minimized: ObjectiveName) -> "Problem | None":
        """Return a cheaper or smoother problem whose minima lie close to those of this one; None if there is
        none.

        Each is made once, so that searches that use it evaluate it together.
        """
        return self._squares if minimized == "metric" else self._plain

    @cached_property
    def _squares(self) -> "Problem":
        """The plain squares of the deflections' errors."""
        squares = LikelihoodRecord(noise="independent", depths="fixed", bevel_spread=0.0)
        return replace(self, likelihood=squares, noise=UNIFORM_NOISE)

    @cached_property
    def _plain(self) -> "Problem | None":
        """The posterior with depths and bevel as stated: one needle instead of 2 d + 1 or more."""
        if all(len(known.nodes.insertions) == 1 for known in self.density.observations):
            return None
        plain = {"depths": "fixed", "bevel_spread": 0.0}
        return replace(self, likelihood=self.likelihood.model_copy(update=plain))

    def with_parameters(self, parameters: Parameters) -> "Problem":
        """Return the same problem searched over other parameters, e.g. the bevel alone."""
        return replace(self, parameters=parameters)

    @cached_property
    def compared_points(self) -> tuple[ComparedPoints, ...]:
        """The measured points that each simulated needle is compared with; computed once."""
        pose, drop = self.dataset.pose, self.dataset.drop_proximal
        return tuple(select_points(pose, drop, insertion) for insertion in self.insertions)

    @cached_property
    def density(self) -> PosteriorDensity:
        """The posterior density of all values; computed once."""
        likelihood, bevels = self.likelihood, list_bevels(self.dataset, self.insertions)
        # of one centred bevel no deviation is left
        one_bevel = self.linear_bevels and self.centred_bevels and len(set(bevels)) == 1
        if one_bevel or BEVEL_SPREAD not in self.parameters.names:
            likelihood = likelihood.model_copy(update={"bevel_spread": 0.0})
        known = [
            make_observation(
                self.dataset, insertion, self.noise, likelihood, len(self.insertions), self.model_error
            )
            for insertion in self.insertions
        ]
        if self.linear_bevels and not one_bevel:
            pairs = zip(known, bevels, strict=True)
            known = [replace(one, nodes=one.nodes.share_bevel(bevel)) for one, bevel in pairs]
        scale = 1.0 if likelihood.noise_scale == "estimated" else likelihood.noise_scale
        needle, centred = self.dataset.needle, self.centred_bevels
        return PosteriorDensity(self.parameters, self.medium, needle, tuple(known), scale, centred)

    @property
    def linear_bevels(self) -> bool:
        """Whether bevels differ between insertions, with a linear effect."""
        varies = BEVEL_SPREAD in self.parameters.names and self.likelihood.bevel_spread > 0
        return varies and self.likelihood.depths != "quadrature"

    @property
    def new_bevel_sd(self) -> float:
        """By how many SDs between insertions the bevel of a further one deviates, as an SD."""
        centred = self.linear_bevels and self.centred_bevels
        return find_new_bevel_sd(self.dataset, self.insertions) if centred else 1.0


def find_new_bevel_sd(dataset: Dataset, insertions: Sequence[Insertion]) -> float:
    """Return by how many SDs between insertions a further bevel deviates from the mean of these n, as an SD.

    That is sqrt(1 + 1 / n): their mean is random too.
    """
    return math.sqrt(1 + 1 / len(set(list_bevels(dataset, insertions))))


def make_problem(
    dataset: Dataset,
    insertions: Sequence[Insertion],
    medium: MediumRecord,
    weights: WeightsRecord,
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD,
) -> Problem:
    """Return the problem of fitting `medium` to `insertions`; what the medium frees is searched."""
    parameters = with_hyperparameters(Parameters.from_record(medium), likelihood)
    return Problem(dataset, tuple(insertions), medium, parameters, weights, likelihood=likelihood)


POSTERIOR_TOLERANCE = 1e-9  #: change of the log posterior under which a search for its peak ends
#: the same on the way to where a search begins, by what it minimises. For a posterior it is small enough to
#: see which starts met. The minima of a metric objective lie elsewhere, so that a closer approach is lost
#: work.
APPROACH_TOLERANCES: dict[ObjectiveName, float] = {"posterior": 1e-6, "metric": 1e-3}


def make_objective(problem: Problem, minimized: ObjectiveName) -> ObjectiveFunction:
    """Return the objective function that a recipe's `minimize` names, with an easier one to start from."""
    if minimized == "posterior":
        found = make_posterior_objective(problem)
    else:
        found = ObjectiveFunction(problem.lower, problem.upper, problem.objective, problem.objective_gradient)
    easier = problem.approach(minimized)
    if easier is None:
        return found
    return replace(found, approach=make_posterior_objective(easier, APPROACH_TOLERANCES[minimized]))


def make_posterior_objective(
    problem: Problem, absolute_tolerance: float = POSTERIOR_TOLERANCE
) -> ObjectiveFunction:
    """Return the negative log posterior density in theta as an objective function."""

    def value(theta: Floats) -> float:
        return -problem.log_posterior(theta)

    def gradient(theta: Floats) -> tuple[float, Floats]:
        density, slope = problem.gradient(theta)
        return -density, -slope

    residuals, jacobian = (problem.residuals, problem.jacobian) if problem.squares else (None, None)
    return ObjectiveFunction(
        problem.lower, problem.upper, value, gradient, residuals, jacobian, absolute_tolerance
    )


@dataclass(frozen=True)
class EvaluationFailure:
    """Why one evaluation failed, and at which insertion."""

    insertion: str  #: the first one without a solution; empty if all have one
    #: the status of its shape; or the error that was raised, `ModelError: ...`; or "value not finite", if
    #: every simulation converged
    reason: str


def explain_failure(problem: Problem, theta: Theta) -> EvaluationFailure:
    """Return why a theta cannot be evaluated: the first insertion that fails, and how."""
    values = problem.values(theta)
    for insertion in problem.insertions:
        try:
            shape = predict(values, problem.medium, problem.dataset.needle, insertion)
        except EVALUATION_ERRORS as error:
            # the error's kind and the first line of its text, which says what is wrong
            parts = (type(error).__name__, str(error).partition("\n")[0])
            return EvaluationFailure(insertion.id, ": ".join(filter(None, parts)))
        if not shape.converged:
            return EvaluationFailure(insertion.id, shape.status)
    return EvaluationFailure("", "value not finite")


def find_outside_validity(
    problem: Problem, thetas: Sequence[Theta] | Floats, jobs: int = 1
) -> NDArray[np.bool_]:
    """Return a mask (B,): the `thetas` (B, P) that simulate any insertion outside the model's validity.

    A solve that fails is none of these: it is counted as failed.
    """
    found = np.zeros(len(thetas), dtype=bool)
    if not len(thetas):
        return found
    sets = [problem.values(theta) for theta in thetas]
    batches = [make_batch(sets, problem.medium, problem.dataset.needle, one) for one in problem.insertions]
    for shapes in simulate_batches(batches, jobs):
        found |= shapes.converged & ~shapes.validity.ok
    return found
