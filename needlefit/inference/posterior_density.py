"""Compute the posterior density of one fit, and its residuals for least squares."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from needlefit.arrays import Floats, pad_axis
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.likelihood.marginal import (
    count_residuals,
    linearize_residuals,
    log_marginals,
    solve_shared,
)
from needlefit.inference.likelihood.nodes import BEVEL, NodeGroup, Nodes, group_nodes
from needlefit.inference.likelihood.observation import (
    Observation,
    append_pose_curves,
    whiten_derivatives,
    whiten_residuals,
)
from needlefit.inference.parameter_names import BEVEL_SPREAD, NOISE_SCALE, NOISE_SCALE_BOUNDS
from needlefit.inference.parameters import Parameters, Values
from needlefit.schemas.medium import MediumRecord

#: of each node of all insertions its points (B, K, 2), in space (B, K, 3), and their derivatives (..., P)
NodePoints = list[tuple[Floats, Floats]]
KnownPoints = dict[tuple[object, ...], NodePoints]  #: by the values, and where the points were read
NEEDLES_AT_ONCE = 100_000  #: number of needles whose residuals are held at once
DERIVATIVES_AT_ONCE = 40_000  #: number of needles whose residuals and derivatives are held at once


@dataclass(frozen=True)
class PosteriorDensity:
    """The posterior of a medium's parameters, given some insertions; functions of all values (Pa, mm)."""

    parameters: Parameters  #: Theta's; with their prior
    medium: MediumRecord
    observations: tuple[Observation, ...]  #: one of each insertion
    #: what the deviations of the points' noise are multiplied by, where it is no parameter
    scale: float = 1.0
    #: whether b is the mean of the insertions' own, from which their deviations sum to zero
    centred_bevels: bool = False
    #: of each insertion how residuals at its m nodes differ from those as measured, where these alone are
    #: simulated (see `near`): at a theta of 0 (m, R), and the derivatives (m, R, P) of that
    moved: tuple[tuple[Floats, Floats], ...] = ()

    def log_densities(self, sets: Sequence[Values], jobs: int = 1) -> Floats:
        """Return the log of likelihood and stated prior (B,) of sets of values; NaN where a solve fails."""
        parts = [sets[some] for some in self.split(len(sets))]
        return np.concatenate(
            [self.add_up(list(self.whitened_residuals(part, jobs)), part) for part in parts]
        )

    def split(self, count: int, needles: int = NEEDLES_AT_ONCE) -> list[slice]:
        """Return the parts of so many sets of values of which so many needles are held at once."""
        most = max(1, needles // sum(len(observation.nodes.insertions) for observation in self.observations))
        return [slice(start, start + most) for start in range(0, count, most)]

    def add_up(self, white: Sequence[Floats], sets: Sequence[Values]) -> Floats:
        """Return the log densities (B,), given the whitened residuals (B, m, R) of every insertion."""
        return self._add_likelihoods(self.parameters.prior.log_density(sets), white, sets)

    def log_predictive(self, sets: Sequence[Values], parts: Sequence[Collection[int]], jobs: int) -> Floats:
        """Return the log densities (B, G) of what was measured in each of G parts, given all the rest.

        A part is some of the insertions, by their place in `observations`. Insertions share bevels, layers
        and frames: given a set of values, what the rest tells of these counts too (P.-C. Buerkner, J. Gabry,
        A. Vehtari, Comput. Stat. 36 (2021) 1243). NaN where a solve fails.
        """
        logs = []
        for some in (sets[part] for part in self.split(len(sets))):
            white, zero = list(self.whitened_residuals(some, jobs)), np.zeros(len(some))
            whole = self._add_likelihoods(zero, white, some)
            rest = np.column_stack([self._add_likelihoods(zero, white, some, part) for part in parts])
            logs.append(whole[:, None] - rest)
        return np.concatenate(logs)

    def _add_likelihoods(
        self, total: Floats, white: Sequence[Floats], sets: Sequence[Values], left_out: Collection[int] = ()
    ) -> Floats:
        """Return `total` (B,) and the log likelihoods of all insertions but those that are left out."""
        scale, spread = self._scales(sets)
        for members, group in self._nodes.groups:
            total = total + sum(self.observations[k].log_norm for k in members if k not in left_out)
            # residuals of 0 under all conditions weigh them alike, as if nothing had been measured; they are
            # normalised by the scale nevertheless
            kept = [np.zeros_like(white[k]) if k in left_out else white[k] for k in members]
            rows = sum(white[k].shape[2] for k in members if k in left_out)
            total = total + (log_marginals(kept, group, scale, spread) + rows * np.log(scale))
        return total

    def whitened_residuals(
        self, sets: Sequence[Values], jobs: int, *, as_measured: bool = False
    ) -> Iterator[Floats]:
        """Yield the whitened residuals (B, m + c, R) of each insertion, the c curves of the pose last.

        Of the nodes `as_measured` alone there are (B, 1, R), without curves.
        """
        nodes = self._first_nodes if as_measured else self._nodes
        points = nodes.model.read_points(sets, nodes.places, jobs)
        for observation, some in zip(self.observations, nodes.nodes, strict=True):
            stacked = np.stack([next(points) for _ in some.s], axis=1)  # (B, m, K, 3)
            white = whiten_residuals(observation, stacked)
            yield white if as_measured else append_pose_curves(observation, white)

    def estimate_bevel(
        self, sets: Sequence[Values], insertion: tuple[str, int], jobs: int
    ) -> tuple[Floats, Floats]:
        """Return means (B,) and deviations (B,) of the bevel of one insertion, given what was measured of it.

        In standard deviations of b between insertions, for many sets of values; 0 and 1 where nothing was
        measured. The insertion is its specimen and number in it, as `find_repeats` names it.
        """
        surface = (insertion[0], BEVEL, insertion[1])
        observations = tuple(
            observation
            for observation in self.observations
            if surface in {axis.surface for axis in observation.nodes.axes}
        )
        if not observations:
            return np.zeros(len(sets)), np.ones(len(sets))
        white = list(replace(self, observations=observations).whitened_residuals(sets, jobs))
        scale, spread = self._scales(sets)
        group = NodeGroup(tuple(observation.nodes for observation in observations), (surface,))
        mean, covariance = solve_shared(white, group, scale, spread)
        return mean[:, 0], np.sqrt(covariance[:, 0, 0])

    def jacobians(
        self, sets: Sequence[Values], jobs: int = 1, points: NodePoints | None = None
    ) -> list[tuple[Floats, Floats]]:
        """Return of each set residuals (R,) and their derivatives (R, P) by theta; NaN where a solve fails.

        The residuals are of the insertions, of the normalising factor, and of the prior. `points` are what
        `differentiate_points` gave of one set, also where the errors of the observations were others.
        """
        parts = (sets[some] for some in self.split(len(sets), DERIVATIVES_AT_ONCE))
        return [pair for part in parts for pair in self._linearize(part, jobs, points)]

    def differentiate_points(self, values: Values, known: KnownPoints | None = None) -> NodePoints:
        """Return the points of all nodes of one set, and their derivatives.

        `known`: those of the same needles, to which these are added.
        """
        nodes, known = self._nodes, {} if known is None else known
        key = (*values.items(), *(s.tobytes() for s in nodes.places))
        if key not in known:
            known[key] = list(nodes.model.differentiate([values], self.parameters, nodes.places))
        return known[key]

    def _linearize(
        self, sets: Sequence[Values], jobs: int, points: NodePoints | None
    ) -> list[tuple[Floats, Floats]]:
        """Return the `jacobians` of sets whose needles are held at once."""
        pairs, scales = list[tuple[Floats, Floats]](), self._scales(sets)
        bare = self._differentiate(sets, jobs, points)
        for observation, (residuals, by_theta) in zip(self.observations, bare, strict=True):
            all_white = append_pose_curves(observation, residuals)
            pairs.append((all_white, pad_axis(by_theta, all_white.shape[1], axis=1)))
        log_det, by_det = np.zeros(len(sets)), np.zeros((len(sets), len(self.parameters.free)))
        parts, slopes = [], []
        for members, group in self._nodes.groups:
            white = [pairs[k][0] for k in members]
            # residuals are white / scale: d/d(ln scale) is minus the residual
            by = [pairs[k][1] - pairs[k][0][..., None] * self._by(NOISE_SCALE) for k in members]
            part, more, part_slopes, more_slopes = linearize_residuals(
                white, by, group, scales, self._by(BEVEL_SPREAD)
            )
            log_det, by_det = log_det + more, by_det + more_slopes
            parts.append(part)
            slopes.append(part_slopes)
        whole, by_whole = (np.concatenate(self._in_order(some), axis=1) for some in (parts, slopes))
        linearized, of_prior = [], self.parameters.prior.residuals(sets)
        for b, values in enumerate(sets):
            normal = self._normal(values, float(log_det[b]))
            # derivative of normal^2 / 2; divided by normal below, since d(normal) = d(normal^2 / 2) / normal
            by_normal = 0.5 * by_det[b] + self._rows * self._by(NOISE_SCALE)
            by_prior = self.parameters.prior.slopes(self.parameters.free, values)
            residuals = np.concatenate([whole[b], normal, of_prior[b]])
            linearized.append(
                (residuals, np.concatenate([by_whole[b], by_normal / normal[:, None], by_prior]))
            )
        return linearized

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
        by_member: dict[int, Floats] = {}
        for (members, _), part in zip(self._nodes.groups, parts, strict=True):
            ends = np.cumsum([self.residual_counts[k] for k in members])[:-1]
            by_member |= dict(zip(members, np.split(part, ends, axis=1), strict=True))
        return [by_member[k] for k in sorted(by_member)]

    @property
    def _nodes(self) -> "_ModelledNodes":
        return self._model_nodes(None)

    @property
    def _first_nodes(self) -> "_ModelledNodes":
        return self._model_nodes(1)

    @cached_property
    def _models(self) -> dict[int | None, "_ModelledNodes"]:
        return {}

    def _model_nodes(self, count: int | None) -> "_ModelledNodes":
        """Return so many nodes of each insertion, or all, and their model: made once."""
        if count not in self._models:
            all_nodes = (observation.nodes for observation in self.observations)
            nodes = tuple(
                replace(some, insertions=some.insertions[:count], s=some.s[:count]) for some in all_nodes
            )
            insertions = [insertion for some in nodes for insertion in some.insertions]
            model = PreparedModel(self.medium, insertions)
            self._models[count] = _ModelledNodes(nodes, model, group_nodes(nodes, self.centred_bevels))
        return self._models[count]

    def with_parameters(
        self, parameters: Parameters, moved: tuple[tuple[Floats, Floats], ...] = ()
    ) -> "PosteriorDensity":
        """Return the density of other parameters, which shares the models of the nodes."""
        other = replace(self, parameters=parameters, moved=moved)
        other.__dict__["_models"] = self._models
        return other

    @property
    def _rows(self) -> int:
        return sum(observation.rows for observation in self.observations)

    def _by(self, parameter: str) -> Floats:
        """Return the derivatives (P,) of the logarithm of a parameter."""
        return np.array([float(name == parameter) for name in self.parameters.free])

    def _scales(self, sets: Sequence[Values]) -> tuple[Floats, Floats]:
        """Return the scales of the noise and the bevel's spreads, (B,) each."""
        pairs = [(values.get(NOISE_SCALE, self.scale), values.get(BEVEL_SPREAD, 0.0)) for values in sets]
        scale, spread = np.array(pairs).T.copy()
        return scale, spread

    def _normal(self, values: Values, log_det: float) -> Floats:
        """Return the residual (1,) whose square is the normalising factor; none if that is constant."""
        scale, spreads = values.get(NOISE_SCALE, self.scale), values.get(BEVEL_SPREAD, 0.0) > 0
        moving = NOISE_SCALE in self.parameters.free
        # depths or bevel enter a group's log det; that of a pose is constant
        all_nodes = (observation.nodes for observation in self.observations)
        if not moving and not any(nodes.axes or (nodes.bevel and spreads) for nodes in all_nodes):
            return np.empty(0)
        # 1 keeps it from 0, where its derivative would be infinite
        grown = 2 * self._rows * np.log(scale / NOISE_SCALE_BOUNDS[0]) if moving else 0.0
        return np.array([np.sqrt(1.0 + grown + log_det)])

    def near(self, values: Values) -> "PosteriorDensity":
        """Return the same density with `jacobians` that are exact at these values, approximate elsewhere.

        Needles with moved depths or bevels are simulated here alone. Elsewhere their residuals differ from
        those of the needle as measured by as much as here, and by what that changes to first order.
        """
        theta, moved = self.parameters.theta(values), []
        for white, by in self._differentiate([values], 1):
            slopes = by[0] - by[0, :1]
            moved.append((white[0] - white[0, :1] - slopes @ theta, slopes))
        return self.with_parameters(self.parameters, tuple(moved))

    def _differentiate(
        self, sets: Sequence[Values], jobs: int, points: NodePoints | None = None
    ) -> Iterator[tuple[Floats, Floats]]:
        """Yield of each insertion the whitened residuals (B, m, R) at its nodes, and the derivatives
        (B, m, R, P) by theta.
        """
        nodes = self._first_nodes if self.moved else self._nodes
        pairs = iter(points or nodes.model.differentiate(sets, self.parameters, nodes.places, jobs))
        thetas = list(map(self.parameters.theta, sets))
        for k, (observation, some) in enumerate(zip(self.observations, nodes.nodes, strict=True)):
            places, slopes = zip(*(next(pairs) for _ in some.s), strict=True)
            stacked, by = np.stack(places, axis=1), np.stack(slopes, axis=1)
            white, by = whiten_residuals(observation, stacked), whiten_derivatives(observation, stacked, by)
            if self.moved:
                apart, by_apart = self.moved[k]
                # a product for each set: one of all rounds a set by where it stands
                white = white + apart + np.stack([by_apart @ theta for theta in thetas])
                by = by + by_apart
            yield white, by


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
