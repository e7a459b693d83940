"""A fit as an optimisation problem: theta in; metric objective, residuals or log posterior out.

The metric objective is how far one simulated needle lies from the measured one, in the paper's own errors,

    ipe * mean_j IPE_j  +  te * TE  +  edp * TE / max(|measured deflection|, edp_floor_mm)            (mm)

with the recipe's weights; edp_floor_mm is about the noise of a tip: a deflection below it says nothing.
A distance |d| has a kink at 0, where it has no gradient; here it is sqrt(d^2 + e^2) - e with e =
`SMOOTHING_MM`, which is smooth and at most e shorter.

`PosteriorDensity` is the posterior density of one fit, and its residuals for least squares.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.datasets.insertion import Dataset, Insertion, Noise, TipTrack
from needlefit.datasets.select import list_bevels
from needlefit.errors import ConfigError
from needlefit.inference.compared_points import (
    ComparedPoints,
    SimulatedCurve,
    align,
    align_points,
    differentiate_align,
    pad_planes,
    select_points,
)
from needlefit.inference.fit import ObjectiveFunction
from needlefit.inference.forward_model import PreparedModel, predict
from needlefit.inference.likelihood.marginal import (
    count_residuals,
    linearize_residuals,
    log_marginals,
    solve_shared,
)
from needlefit.inference.likelihood.nodes import BEVEL, NodeGroup, Nodes, group_nodes
from needlefit.inference.likelihood.observation import (
    PLAIN_LIKELIHOOD,
    Discrepancy,
    Observation,
    append_pose_curves,
    make_observation,
    whiten_derivatives,
    whiten_residuals,
)
from needlefit.inference.parameters import (
    BEVEL_SPREAD,
    BEVEL_SPREAD_BOUNDS,
    NOISE_SCALE,
    NOISE_SCALE_BOUNDS,
    Parameters,
    Theta,
    with_hyperparameters,
)
from needlefit.inference.side_by_side import evaluate
from needlefit.mechanics.needle import Needle
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, ObjectiveName, WeightsRecord

Values = Mapping[str, float]


NEEDLES_AT_ONCE = 25_000  #: needles of sets of values that are held at once: each takes 6 kB


@dataclass(frozen=True)
class PosteriorDensity:
    """The posterior of a medium's parameters, given some insertions; functions of all values (Pa, mm)."""

    parameters: Parameters  #: Theta's; with their prior
    medium: MediumRecord
    needle: Needle
    observations: tuple[Observation, ...]  #: one of each insertion
    #: what the deviations of the points' noise are multiplied by, where it is no parameter
    scale: float = 1.0
    #: whether b is the mean of the insertions' own, from which their deviations sum to zero
    centred_bevels: bool = False
    #: of each insertion (m + c, R, P), how derivatives at its nodes differ from those as measured: see `near`
    node_slopes: tuple[Floats, ...] = ()

    def log_densities(self, sets: Sequence[Values], jobs: int = 1) -> Floats:
        """Return the log of likelihood and stated prior (B,) of sets of values; NaN where a solve fails."""
        parts = [sets[some] for some in self.split(len(sets))]
        return np.concatenate(
            [self.add_up(list(self.whitened_residuals(part, jobs)), part) for part in parts]
        )

    def split(self, count: int) -> list[slice]:
        """Return the parts of so many sets of values whose needles are held at once."""
        most = max(1, NEEDLES_AT_ONCE // sum(len(one.nodes.insertions) for one in self.observations))
        return [slice(start, start + most) for start in range(0, count, most)]

    def add_up(self, white: Sequence[Floats], sets: Sequence[Values]) -> Floats:
        """Return the log densities (B,), given the whitened residuals (B, m, R) of every insertion."""
        scale, spread = self._scales(sets)
        total = np.array([self._log_prior(values) for values in sets])
        for members, group in self._nodes.groups:
            total += sum(self.observations[k].log_norm for k in members)
            total += log_marginals([white[k] for k in members], group, scale, spread)
        return total

    def whitened_residuals(
        self, sets: Sequence[Values], jobs: int, *, as_measured: bool = False
    ) -> Iterator[Floats]:
        """Yield the whitened residuals (B, m + c, R) of each insertion, the c curves of the pose last.

        Of the nodes `as_measured` alone there are (B, 1, R), without curves.
        """
        nodes = self._first_nodes if as_measured else self._nodes
        points = iter(nodes.model.read_points(sets, nodes.places, jobs))
        for one, some in zip(self.observations, nodes.nodes, strict=True):
            planar = (pad_planes(next(points), one.planes) for _ in some.s)
            stacked = np.stack([*planar], axis=1)  # (B, m, K, 2), in space (B, m, K, 3)
            white = whiten_residuals(one, stacked)
            yield white if as_measured else append_pose_curves(one, white)

    def estimate_bevel(
        self, sets: Sequence[Values], insertion: tuple[str, int], jobs: int
    ) -> tuple[Floats, Floats]:
        """Return means (B,) and deviations (B,) of the bevel of one insertion, given what was measured of it.

        In standard deviations of b between insertions, for many sets of values; 0 and 1 where nothing was
        measured. The insertion is its specimen and number in it, as `find_repeats` names it.
        """
        surface = (insertion[0], BEVEL, insertion[1])
        known = tuple(
            one for one in self.observations if surface in {axis.surface for axis in one.nodes.axes}
        )
        if not known:
            return np.zeros(len(sets)), np.ones(len(sets))
        white = list(replace(self, observations=known).whitened_residuals(sets, jobs))
        scale, spread = self._scales(sets)
        group = NodeGroup(tuple(one.nodes for one in known), (surface,))
        mean, covariance = solve_shared(white, group, scale, spread)
        return mean[:, 0], np.sqrt(covariance[:, 0, 0])

    def jacobians(self, sets: Sequence[Values], jobs: int = 1) -> list[tuple[Floats, Floats]]:
        """Return of each set residuals (R,) and their derivatives (R, P) by theta; NaN where a solve fails.

        The residuals are of the insertions, of the normalising factor, and of the prior.
        """
        pairs, at = self._differentiate(sets, jobs), self._scales(sets)
        log_det, by_det = np.zeros(len(sets)), np.zeros((len(sets), len(self.parameters.free)))
        parts, slopes = [], []
        for members, group in self._nodes.groups:
            white = [pairs[k][0] for k in members]
            # residuals are white / scale: d/d(ln scale) is minus the residual
            by = [pairs[k][1] - pairs[k][0][..., None] * self._by_scale for k in members]
            part, more, part_slopes, more_slopes = linearize_residuals(white, by, group, at, self._by_spread)
            log_det, by_det = log_det + more, by_det + more_slopes
            parts.append(part)
            slopes.append(part_slopes)
        whole, by_whole = (np.concatenate(self._in_order(some), axis=1) for some in (parts, slopes))
        found = []
        for b, values in enumerate(sets):
            normal = self._normal(values, float(log_det[b]))
            # derivative of normal^2 / 2; divided by normal below, since d(normal) = d(normal^2 / 2) / normal
            by_normal = 0.5 * by_det[b] + self._rows * self._by_scale - self._by_half_normal
            stated = [self.parameters.prior.slopes(self.parameters.free)]
            if self._by_half_normal.any():
                stated.append(self._spread_in_sd(values) * self._by_half_normal[None])
            residuals = np.concatenate([whole[b], normal, self._prior_residuals(values)])
            found.append((residuals, np.concatenate([by_whole[b], by_normal / normal[:, None], *stated])))
        return found

    @cached_property
    def residual_counts(self) -> tuple[int, ...]:
        """Number of residuals of each insertion; the normalising one and the prior's come after them."""
        counts = [0] * len(self.observations)
        for members, group in self._nodes.groups:
            rows = [self.observations[k].rows for k in members]
            for k, count in zip(members, count_residuals(group, rows), strict=True):
                counts[k] = count
        return tuple(counts)

    def _in_order(self, parts: Iterable[Floats]) -> list[Floats]:
        """Return the residuals of groups, (B, R) or (B, R, P) each, insertion by insertion."""
        found: dict[int, Floats] = {}
        for (members, _), part in zip(self._nodes.groups, parts, strict=True):
            ends = np.cumsum([self.residual_counts[k] for k in members])[:-1]
            found |= dict(zip(members, np.split(part, ends, axis=1), strict=True))
        return [found[k] for k in sorted(found)]

    @cached_property
    def _nodes(self) -> "_ModelledNodes":
        return self._model_nodes(tuple(one.nodes for one in self.observations))

    @cached_property
    def _first_nodes(self) -> "_ModelledNodes":
        return self._model_nodes(
            tuple(
                replace(one.nodes, insertions=one.nodes.insertions[:1], s=one.nodes.s[:1])
                for one in self.observations
            )
        )

    def _model_nodes(self, nodes: tuple[Nodes, ...]) -> "_ModelledNodes":
        every = [insertion for some in nodes for insertion in some.insertions]
        model = PreparedModel(self.medium, self.needle, every)
        return _ModelledNodes(nodes, model, group_nodes(nodes, self.centred_bevels))

    @property
    def _rows(self) -> int:
        return sum(observation.rows for observation in self.observations)

    @property
    def _by_scale(self) -> Floats:
        """Derivatives (P,) of the logarithm of the scale."""
        return np.array([float(name == NOISE_SCALE) for name in self.parameters.free])

    @property
    def _by_spread(self) -> Floats:
        """Derivatives (P,) of the logarithm of the bevel's spread."""
        return np.array([float(name == BEVEL_SPREAD) for name in self.parameters.free])

    @property
    def _by_half_normal(self) -> Floats:
        """The same, where the spread has its half-normal prior; else zeros."""
        return self._by_spread * (BEVEL_SPREAD in self.parameters.half_normal)

    def _scales(self, sets: Sequence[Values]) -> tuple[Floats, Floats]:
        """Return the scales of the noise and the bevel's spreads, (B,) each."""
        pairs = [(values.get(NOISE_SCALE, self.scale), values.get(BEVEL_SPREAD, 0.0)) for values in sets]
        scale, spread = np.array(pairs).T.copy()
        return scale, spread

    def _spread_in_sd(self, values: Values) -> float:
        """Return the bevel's spread in standard deviations of its half-normal prior; 0 if it has none."""
        sd = self.parameters.half_normal.get(BEVEL_SPREAD)
        return values.get(BEVEL_SPREAD, 0.0) / sd if sd and BEVEL_SPREAD in self.parameters.free else 0.0

    def _log_prior(self, values: Values) -> float:
        """Return the log density of what is stated; a half-normal spread is searched in its logarithm."""
        total, spread = self.parameters.prior.log_density(values), self._spread_in_sd(values)
        return total - 0.5 * spread**2 + np.log(spread) if spread else total

    def _prior_residuals(self, values: Values) -> Floats:
        stated, spread = self.parameters.prior.residuals(values), self._spread_in_sd(values)
        return np.append(stated, spread) if spread else stated

    def _normal(self, values: Values, log_det: float) -> Floats:
        """Return the residual (1,) whose square is the normalising factor; none if that is constant."""
        scale, spread = values.get(NOISE_SCALE, self.scale), self._spread_in_sd(values)
        moving = NOISE_SCALE in self.parameters.free
        # depths or bevel enter a group's log det; that of a pose is constant
        spreads, every = values.get(BEVEL_SPREAD, 0.0) > 0, (one.nodes for one in self.observations)
        if not moving and not spread and not any(one.axes or (one.bevel and spreads) for one in every):
            return np.empty(0)
        # 1 keeps it from 0, where its derivative would be infinite
        grown = 2 * self._rows * np.log(scale / NOISE_SCALE_BOUNDS[0]) if moving else 0.0
        less = 2 * np.log(BEVEL_SPREAD_BOUNDS[1] / spread) if spread else 0.0
        return np.array([np.sqrt(1.0 + grown + less + log_det)])

    def near(self, values: Values) -> "PosteriorDensity":
        """Return the same density with `jacobians` that are exact at these values, approximate elsewhere.

        Residuals stay exact. Needles with moved depths or bevels are differentiated here alone: elsewhere
        their derivatives differ from those of the needle as measured by as much as here.
        """
        slopes = (by[0] - by[0, :1] for _, by in self._differentiate([values], 1))
        return replace(self, node_slopes=tuple(slopes))

    def _differentiate(self, sets: Sequence[Values], jobs: int) -> list[tuple[Floats, Floats]]:
        """Return of each insertion `whitened_residuals`, and the derivatives (B, m + c, R, P) by theta."""
        found, nodes = [], self._first_nodes if self.node_slopes else self._nodes
        points, slopes = map(iter, nodes.model.differentiate(sets, self.parameters, nodes.places, jobs))
        exact = iter(self.whitened_residuals(sets, jobs)) if self.node_slopes else None
        for k, (one, some) in enumerate(zip(self.observations, nodes.nodes, strict=True)):
            stacked, by = (
                np.stack([pad_planes(next(part), one.planes, axis=axis) for _ in some.s], axis=1)
                for part, axis in ((points, -1), (slopes, -2))
            )
            white = next(exact) if exact else append_pose_curves(one, whiten_residuals(one, stacked))
            by_white, moved = np.zeros((*white.shape, by.shape[-1])), len(one.nodes.s)
            by_white[:, :moved] = whiten_derivatives(one, stacked, by)  # of one node, or of all
            if exact:
                by_white[:, :moved] += self.node_slopes[k][:moved]
            found.append((white, by_white))
        return found


@dataclass(frozen=True)
class _ModelledNodes:
    """The nodes of all insertions, the forward model of them, and the insertions that share conditions."""

    nodes: tuple[Nodes, ...]
    model: PreparedModel
    groups: tuple[tuple[tuple[int, ...], NodeGroup], ...]

    @property
    def places(self) -> list[Floats]:
        """Where the points of all nodes lie on the beam, (K,) mm each."""
        return [s for some in self.nodes for s in some.s]


#: distance below which a distance counts as squared, mm: less than any measured centreline is known to
SMOOTHING_MM = 1e-4


def metric_misfits(off: Floats, weights: Floats) -> Floats:
    """Return the metric misfits (B,) of one insertion, mm, given the stations' weights (K,).

    `off` (B, K, 2 or 3) are simulated minus measured points, which run from the entry to the tip.
    """
    distances = np.sqrt(np.sum(off**2, axis=-1) + SMOOTHING_MM**2) - SMOOTHING_MM  # (B, K)
    return np.asarray(distances @ weights)


def metric_misfit_gradients(off: Floats, weights: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (B, P) of `metric_misfits`, given those of the simulated points (B, K, D, P)."""
    along = off * (weights / np.sqrt(np.sum(off**2, axis=-1) + SMOOTHING_MM**2))[..., None]
    flat = along.reshape(len(off), 1, math.prod(off.shape[1:]))
    return (flat @ slopes.reshape(len(off), flat.shape[2], slopes.shape[-1]))[:, 0]


def station_weights(measured: Floats, weights: WeightsRecord) -> Floats:
    """Return the weight (K,) of the distance at each station."""
    deflection = float(np.linalg.norm((measured[-1] - measured[0])[1:]))
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
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of theta."""
        return self.parameters.free

    def values(self, theta: Theta) -> dict[str, float]:
        """Return every parameter's value (Pa, mm)."""
        return self.parameters.values(theta)

    def tabulate_values(self, thetas: Floats) -> Floats:
        """Return the values (..., P) of the free parameters (Pa, mm) of thetas (..., P)."""
        sets = map(self.values, thetas.reshape(-1, len(self.names)))
        return np.array([[one[name] for name in self.names] for one in sets]).reshape(thetas.shape)

    def points(self, theta: Theta) -> tuple[tuple[Floats, Floats], ...]:
        """Return the simulated and the measured points (K, 3) compared in each insertion, mm."""
        values, found = self.values(theta), []
        for one, goal in zip(self.insertions, self.compared_points, strict=True):
            shape = predict(values, self.medium, self.dataset.needle, one)
            found.append(align_points(goal, SimulatedCurve(shape, one)))
        return tuple(found)

    def objective(self, theta: Theta) -> float:
        """Return the mean of `metric_misfits` over insertions, mm; infinite if any solve fails."""
        return evaluate(self._objectives, np.asarray(theta))

    def objective_gradient(self, theta: Theta) -> tuple[float, Floats]:
        """Return `objective` and its exact gradient (P,); NaN where a solve fails."""
        return evaluate(self._objective_gradients, np.asarray(theta))

    def _objectives(self, thetas: Floats, jobs: int) -> list[float]:
        goals, total, planes = self.compared_points, np.zeros(len(thetas)), self.dataset.planes
        points = self._model.read_points(self._list_values(thetas), [goal.s for goal in goals], jobs)
        for goal, simulated, weights in zip(goals, points, self._station_weights, strict=True):
            measured = goal.measured_in(planes)
            total += metric_misfits(
                align(goal.pose, pad_planes(simulated, planes), measured) - measured, weights
            )
        return [math.inf if math.isnan(one) else float(one) / len(goals) for one in total]

    def _objective_gradients(self, thetas: Floats, jobs: int) -> list[tuple[float, Floats]]:
        goals, sets, planes = self.compared_points, self._list_values(thetas), self.dataset.planes
        total, slope = np.zeros(len(sets)), np.zeros((len(sets), len(self.names)))
        found = self._model.differentiate(sets, self.parameters, [goal.s for goal in goals], jobs)
        for goal, simulated, by, weights in zip(goals, *found, self._station_weights, strict=True):
            measured, simulated = goal.measured_in(planes), pad_planes(simulated, planes)
            slopes = differentiate_align(goal.pose, simulated, measured, pad_planes(by, planes, axis=-2))
            off = align(goal.pose, simulated, measured) - measured
            total += metric_misfits(off, weights)
            slope += metric_misfit_gradients(off, weights, slopes)
        return list(zip((total / len(goals)).tolist(), slope / len(goals), strict=True))

    @cached_property
    def _station_weights(self) -> list[Floats]:
        """The weight (K,) of the distance at each station of each insertion."""
        planes, weights = self.dataset.planes, self.weights
        return [station_weights(goal.measured_in(planes), weights) for goal in self.compared_points]

    def _list_values(self, thetas: Floats) -> list[dict[str, float]]:
        return [self.values(theta) for theta in thetas]

    @cached_property
    def _model(self) -> PreparedModel:
        return PreparedModel(self.medium, self.dataset.needle, self.insertions)

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
        at = np.asarray(theta)
        inside = np.all(at >= self.lower) and np.all(at <= self.upper)
        return evaluate(self._log_densities, at) if inside else float("-inf")

    def log_posteriors(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return `log_posterior` (W,) of many thetas (W, P) at once, on `jobs` threads."""
        density = np.full(len(thetas), -np.inf)
        inside = np.flatnonzero(np.all((thetas >= self.lower) & (thetas <= self.upper), axis=1))
        if len(inside):
            density[inside] = self._log_densities(thetas[inside], jobs)
        return density

    def _log_densities(self, thetas: Floats, jobs: int) -> list[float]:
        return list(map(float, self.density.log_densities(self._list_values(thetas), jobs)))

    def _jacobians(self, thetas: Floats, jobs: int) -> list[tuple[Floats, Floats]]:
        return self.density.jacobians(self._list_values(thetas), jobs)

    def near(self, theta: Theta) -> "Problem":
        """Return the same problem with a Jacobian that is exact at theta (P,): see `PosteriorDensity`."""
        if all(len(one.nodes.insertions) == 1 for one in self.density.observations):
            return self
        other = replace(self)
        other.__dict__["density"] = self.density.near(self.values(theta))
        return other

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
        tracks = self.likelihood.tip_tracks.model_copy(update={"gain_sd": 0.0, "roll_sd_deg": 0.0})
        plain = {"depths": "fixed", "bevel_spread": 0.0, "tip_tracks": tracks}
        return replace(self, likelihood=self.likelihood.model_copy(update=plain))

    def with_parameters(self, parameters: Parameters) -> "Problem":
        """Return the same problem searched over other parameters, e.g. the bevel alone."""
        return replace(self, parameters=parameters)

    @cached_property
    def compared_points(self) -> tuple[ComparedPoints, ...]:
        """The measured points that each simulated needle is compared with; computed once."""
        pose, drop = self.dataset.pose, self.dataset.drop_proximal
        return tuple(
            select_points(pose, drop, insertion, planes=self.dataset.planes) for insertion in self.insertions
        )

    @cached_property
    def density(self) -> PosteriorDensity:
        """The posterior density of all values; computed once."""
        likelihood, bevels = self.likelihood, list_bevels(self.dataset, self.insertions)
        # of one centred bevel no deviation is left
        one_bevel = self.bevels_differ and self.centred_bevels and len(set(bevels)) == 1
        if one_bevel or BEVEL_SPREAD not in self.parameters.names:
            likelihood = likelihood.model_copy(update={"bevel_spread": 0.0})
        known = [
            make_observation(
                self.dataset, insertion, self.noise, likelihood, len(self.insertions), self.model_error
            )
            for insertion in self.insertions
        ]
        if self.bevels_differ and not one_bevel:
            pairs = zip(known, bevels, strict=True)
            known = [replace(one, nodes=one.nodes.share_bevel(bevel)) for one, bevel in pairs]
        scale = 1.0 if likelihood.noise_scale == "estimated" else likelihood.noise_scale
        needle, centred = self.dataset.needle, self.centred_bevels
        return PosteriorDensity(self.parameters, self.medium, needle, tuple(known), scale, centred)

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
    counts = Counter(one.specimen for one in dict(zip(bevels, insertions, strict=True)).values())
    return math.sqrt(1 - sum(1 / n for n in counts.values()) / len(counts))


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
    return ObjectiveFunction(
        problem.lower,
        problem.upper,
        lambda theta: -problem.log_posterior(theta),
        jacobian=problem.jacobian,
        misfits=problem.compute_misfits,
        absolute_tolerance=absolute_tolerance,
    )


def find_outside_validity(problem: Problem, thetas: Sequence[Theta] | Floats) -> Bools:
    """Return a mask (B,): the `thetas` (B, P) that simulate any insertion outside the model's validity.

    A solve that fails is none of these: it is counted as failed.
    """
    found = np.zeros(len(thetas), dtype=bool)
    if not len(thetas):
        return found
    sets = [problem.values(theta) for theta in thetas]
    model = PreparedModel(problem.medium, problem.dataset.needle, problem.insertions)
    for shapes in model.simulate(sets):
        found |= shapes.converged & ~shapes.validity.ok
    return found
