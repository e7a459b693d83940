"""A fit as an optimisation problem: theta in; metric objective, residuals or log posterior out."""

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.datasets.select import list_bevels
from needlefit.errors import ConfigError
from needlefit.inference.fit import ObjectiveFunction
from needlefit.inference.forward_model import PreparedModel, predict, respond_to_moves
from needlefit.inference.likelihood.compared_points import (
    ComparedPoints,
    align,
    align_points,
    differentiate_align,
)
from needlefit.inference.likelihood.observations import (
    ScoredObservation,
    SimulatedCurve,
    list_scored,
    make_observation,
)
from needlefit.inference.likelihood.stated_errors import PLAIN_LIKELIHOOD, Discrepancy
from needlefit.inference.metric_objective import WeightedDistances, metric_misfits, weigh_stations
from needlefit.inference.parameter_names import BEVEL_SPREAD
from needlefit.inference.parameters import Parameters, Theta, Values
from needlefit.inference.posterior_density import PosteriorDensity
from needlefit.inference.side_by_side import evaluate
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, ObjectiveName, WeightsRecord

GUIDE_DISTANCE = "guide_distance_mm"


class MetricGoal(NamedTuple):
    """Something that was measured of an insertion, as the metric objective compares it."""

    insertion: Insertion
    part: ScoredObservation
    points: ComparedPoints
    weights: Floats  #: (K,) of the distance at each station


@dataclass(frozen=True)
class Problem:
    """Some insertions of one dataset, the model of a medium, and the parameters that are searched."""

    dataset: Dataset  #: for its noise and how its shapes are compared
    insertions: tuple[Insertion, ...]  #: the ones fitted to
    medium: MediumRecord
    parameters: Parameters
    weights: WeightsRecord  #: of the objective
    noise: Noise | None = None  #: replaces what the dataset states, where it states none
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD  #: what is made of noise and uncertain depths
    model_error: Discrepancy | None = None  #: a misfit of the model that is allowed for beside the noise
    #: whether b is the mean of these insertions' own; else of others, from which all may differ
    centred_bevels: bool = True
    #: values at which the response to moves of a guide is computed; None: those expected before any data
    response_at: Values | None = None
    #: these responses, by insertion, places and values; problems made of one another share them
    responses: dict[object, Floats] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.insertions:
            raise ConfigError("no insertion is selected to fit to", expected="at least one")
        if (
            any(insertion.guided for insertion in self.insertions)
            and GUIDE_DISTANCE not in self.parameters.names
        ):
            raise ConfigError(
                "the tissue model does not state the guide's distance",
                expected=f"{GUIDE_DISTANCE}: from the guide to the skin, free or fixed",
                key="parameters",
            )

    def __reduce__(self) -> tuple[type["Problem"], tuple[object, ...]]:
        # what is computed once is computed anew elsewhere: it refers to objects of this process
        return type(self), tuple(getattr(self, one.name) for one in fields(self))

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return self.parameters.lower

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return self.parameters.upper

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of theta."""
        return self.parameters.free

    def values(self, theta: Theta) -> dict[str, float]:
        """Return every parameter's value (Pa, mm)."""
        return self.parameters.values(theta)

    def tabulate_values(self, thetas: Floats) -> Floats:
        """Return the values (..., P) of the free parameters (Pa, mm) of thetas (..., P)."""
        sets = map(self.values, thetas.reshape(-1, len(self.names)))
        return np.array([[values[name] for name in self.names] for values in sets]).reshape(thetas.shape)

    def points(self, theta: Theta) -> tuple[tuple[Floats, Floats], ...]:
        """Return the simulated and the measured points (K, 3) compared in each insertion, mm."""
        values, pairs = self.values(theta), []
        for goal in self.goals:
            shape = predict(values, self.medium, goal.insertion)
            pairs.append(align_points(goal.points, SimulatedCurve(shape, goal.insertion)))
        return tuple(pairs)

    def objective(self, theta: Theta) -> float:
        """Return the mean of `metric_misfits` over insertions, mm; infinite if any solve fails."""
        return evaluate(self._objectives, np.asarray(theta))

    def objective_gradient(self, theta: Theta) -> tuple[float, Floats]:
        """Return `objective` and its exact gradient (P,); NaN where a solve fails."""
        distances = self.distances(theta)
        return distances.total, distances.differentiate()

    def objectives(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return `objective` (B,) of many thetas (B, P) at once, on `jobs` threads."""
        return np.array(self._objectives(thetas, jobs))

    def _objectives(self, thetas: Floats, jobs: int) -> list[float]:
        total = np.zeros(len(thetas))
        points = self._model.read_points(self._list_values(thetas), self._stations, jobs)
        for (*_, goal, weights), simulated in zip(self.goals, points, strict=True):
            aligned = align(goal.pose, goal.select(simulated), goal.target)
            total += metric_misfits(aligned - goal.target, weights)
        return [
            math.inf if math.isnan(total_of_set) else float(total_of_set) / len(self.insertions)
            for total_of_set in total
        ]

    def distances(self, theta: Theta) -> WeightedDistances:
        """Return the distances whose weighted sum is `objective`, with exact derivatives."""
        return evaluate(self._distances, np.asarray(theta))

    def _distances(self, thetas: Floats, jobs: int) -> list[WeightedDistances]:
        distances = []
        points = self._model.differentiate(self._list_values(thetas), self.parameters, self._stations, jobs)
        for (*_, goal, _), (simulated, by) in zip(self.goals, points, strict=True):
            measured, simulated, by = goal.target, goal.select(simulated), goal.select(by, axis=-2)
            slopes = differentiate_align(goal.pose, simulated, measured, by)
            distances.append((align(goal.pose, simulated, measured) - measured, slopes))
        off, slopes = (np.concatenate(part, axis=1) for part in zip(*distances, strict=True))
        weights = np.concatenate([goal.weights for goal in self.goals]) / len(self.insertions)
        return [WeightedDistances(weights, *pair) for pair in zip(off, slopes, strict=True)]

    @property
    def _stations(self) -> list[Floats]:
        return [goal.points.s for goal in self.goals]

    def _list_values(self, thetas: Floats) -> list[dict[str, float]]:
        return [self.values(theta) for theta in thetas]

    @cached_property
    def _model(self) -> PreparedModel:
        return PreparedModel(self.medium, [goal.insertion for goal in self.goals])

    def compute_misfits(self, theta: Theta) -> Floats:
        """Return those of the residuals (R,) that are of the insertions."""
        return self.jacobian(theta)[0][: sum(self.density.residual_counts)]

    def jacobian(self, theta: Theta) -> tuple[Floats, Floats]:
        """Return residuals (R,) and their exact derivatives (R, P) by theta; NaN where a solve fails.

        First stand the whitened residuals of all insertions in turn, then what normalises the density, where
        that depends on theta, and the prior's. log_posterior = constant - |residuals|^2 / 2 in the bounds.
        """
        return evaluate(self._jacobians, np.asarray(theta))

    def log_posterior(self, theta: Theta) -> float:
        """Return the log of the unnormalised posterior density in theta.

        The prior is flat in theta within the bounds (moduli and lengths are log-uniform), times what the
        medium states. -inf outside, NaN where a solve fails: the density is not known there.
        """
        point = np.asarray(theta)
        inside = np.all(point >= self.lower) and np.all(point <= self.upper)
        return evaluate(self._log_densities, point) if inside else float("-inf")

    def log_posteriors(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return `log_posterior` (W,) of many thetas (W, P) at once, on `jobs` threads."""
        density = np.full(len(thetas), -np.inf)
        inside = np.flatnonzero(np.all((thetas >= self.lower) & (thetas <= self.upper), axis=1))
        if len(inside):
            density[inside] = self._log_densities(thetas[inside], jobs)
        return density

    def log_predictive(self, thetas: Floats, parts: Sequence[Collection[int]], jobs: int = 1) -> Floats:
        """Return the log densities (W, G) of what was measured in each of G parts, given all the rest.

        A part is some of the insertions, by their place; see `PosteriorDensity.log_predictive`.
        """
        return self.density.log_predictive(self._list_values(thetas), parts, jobs)

    def _log_densities(self, thetas: Floats, jobs: int) -> list[float]:
        return list(map(float, self.density.log_densities(self._list_values(thetas), jobs)))

    def _jacobians(self, thetas: Floats, jobs: int) -> list[tuple[Floats, Floats]]:
        return self.density.jacobians(self._list_values(thetas), jobs)

    def near(self, theta: Theta) -> "Problem":
        """Return the same problem with a Jacobian that is exact at theta (P,): see `PosteriorDensity`."""
        if all(len(observation.nodes.insertions) == 1 for observation in self.density.observations):
            return self
        other = replace(self)
        other.__dict__["density"] = self.density.near(self.values(theta))
        return other

    @cached_property
    def plain(self) -> "Problem | None":
        """The posterior with depths and bevel as stated: one needle instead of 2 d + 1 or more.

        None where nothing else is known of them. It is made once: searches that use it evaluate it together.
        """
        if all(len(observation.nodes.insertions) == 1 for observation in self.density.observations):
            return None
        tracks = self.likelihood.tip_tracks.model_copy(update={"roll_sd_deg": 0.0})
        plain = {"depths": "fixed", "bevel_spread": 0.0, "tip_tracks": tracks}
        return replace(self, likelihood=self.likelihood.model_copy(update=plain))

    def with_parameters(self, parameters: Parameters) -> "Problem":
        """Return the same problem searched over other parameters, e.g. the bevel alone."""
        other = replace(self, parameters=parameters)
        guided = any(insertion.guided for insertion in self.insertions)  # their response is by parameters
        if not guided and (BEVEL_SPREAD in parameters.names) == (BEVEL_SPREAD in self.parameters.names):
            other.__dict__["_origin"] = self._like
        return other

    @property
    def _like(self) -> "Problem":
        """The problem whose density differs in its parameters alone: itself, or what it was made of."""
        origin: Problem = self.__dict__.get("_origin", self)
        return origin

    @cached_property
    def searched(self) -> "Problem":
        """The problem of a search: parameters that are held are fixed at the centre of their prior."""
        return self.with_parameters(self.parameters.searched) if self.parameters.held else self

    def holding(self, names: Collection[str]) -> "Problem":
        """Return the same problem with `names` held alone, among the parameters that are."""
        parameters = self.parameters.holding(names)
        return self if parameters.held == self.parameters.held else self.with_parameters(parameters)

    @cached_property
    def goals(self) -> tuple[MetricGoal, ...]:
        """The measured places that simulated needles are compared with, insertion by insertion."""
        goals = list[MetricGoal]()
        for insertion in self.insertions:
            parts = list_scored(self.dataset, insertion)
            pairs = [(part, one) for part in parts for one in part.kind.compare(part.dataset, part.insertion)]
            pairs = [(part, one) for part, one in pairs if one.quantity == "places"] or pairs[:1]
            all_weights = weigh_stations([one.target for _, one in pairs], self.weights)
            for pair, weights in zip(pairs, all_weights, strict=True):
                goals.append(MetricGoal(insertion, *pair, weights))
        return tuple(goals)

    @cached_property
    def density(self) -> PosteriorDensity:
        """The posterior density of all values; computed once."""
        if self._like is not self:
            return self._like.density.with_parameters(self.parameters)
        likelihood, bevels = self.likelihood, list_bevels(self.dataset, self.insertions)
        # of one centred bevel no deviation is left
        one_bevel = self.bevels_differ and self.centred_bevels and len(set(bevels)) == 1
        if one_bevel or BEVEL_SPREAD not in self.parameters.names:
            likelihood = likelihood.model_copy(update={"bevel_spread": 0.0})
        observations = [
            make_observation(
                self.dataset, insertion, self.noise, likelihood, len(self.insertions), self.model_error,
                self.respond,
            )
            for insertion in self.insertions
        ]  # fmt: skip
        if self.bevels_differ and not one_bevel:
            pairs = zip(observations, bevels, strict=True)
            observations = [
                replace(observation, nodes=observation.nodes.share_bevel(bevel))
                for observation, bevel in pairs
            ]
        scale = 1.0 if likelihood.noise_scale == "estimated" else likelihood.noise_scale
        return PosteriorDensity(self.parameters, self.medium, tuple(observations), scale, self.centred_bevels)

    def respond(self, insertion: Insertion, s: Floats) -> Floats:
        """Return `respond_to_moves` of an insertion at `response_at`."""
        values = self.response_at or self.parameters.values(self.parameters.expected)
        key = insertion, s.tobytes(), tuple(values.items())
        if key not in self.responses:
            self.responses[key] = respond_to_moves(values, self.medium, insertion, s)
        return self.responses[key]

    @property
    def bevels_differ(self) -> bool:
        """Whether bevels differ between insertions."""
        return BEVEL_SPREAD in self.parameters.names and self.likelihood.bevel_spread > 0

    @property
    def new_bevel_sd(self) -> float:
        """By how many SDs between insertions the bevel of a further one deviates, as an SD."""
        centred = self.bevels_differ and self.centred_bevels
        return find_new_bevel_sd(self.dataset, self.insertions) if centred else 1.0


def find_new_bevel_sd(
    dataset: Dataset, insertions: Sequence[Insertion], *, new_specimen: bool = False
) -> float:
    """Return by how many SDs between insertions a further bevel deviates from the mean of these n, as an SD.

    That is sqrt(1 + 1 / n): their mean is random too. In a new specimen b is drawn as others have it, as the
    mean of their n bevels each: then it is sqrt(1 - 1 / n), with the mean of 1 / n over specimens.
    """
    bevels = list_bevels(dataset, insertions)
    if not new_specimen:
        return math.sqrt(1 + 1 / len(set(bevels)))
    counts = Counter(insertion.specimen for insertion in dict(zip(bevels, insertions, strict=True)).values())
    return math.sqrt(1 - sum(1 / n for n in counts.values()) / len(counts))


POSTERIOR_TOLERANCE = 1e-9  #: change of the log posterior under which a search for its peak ends
#: change of the log posterior under which the way to the beginning of a search ends: small enough to see
#: which starts met
APPROACH_TOLERANCE = 1e-6


def make_objective(problem: Problem, minimized: ObjectiveName) -> ObjectiveFunction:
    """Return the objective function that a recipe's `minimize` names, with an easier one to start from."""
    if minimized == "metric":
        box = (problem.lower, problem.upper, problem.objective)
        by_distances = ObjectiveFunction(*box, distances=problem.distances)
        return ObjectiveFunction(*box, problem.objective_gradient, approach=by_distances)
    objective, easier = make_posterior_objective(problem), problem.plain
    if easier is None:
        return objective
    return replace(objective, approach=make_posterior_objective(easier, APPROACH_TOLERANCE))


def make_posterior_objective(
    problem: Problem, absolute_tolerance: float = POSTERIOR_TOLERANCE
) -> ObjectiveFunction:
    """Return the negative log posterior density in theta as an objective function."""
    return ObjectiveFunction(
        problem.lower,
        problem.upper,
        lambda theta: -problem.log_posterior(theta),
        jacobian=problem.jacobian,
        misfits=problem.compute_misfits,
        absolute_tolerance=absolute_tolerance,
    )
