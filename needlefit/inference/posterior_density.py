"""The posterior density of one fit, its exact gradient, and its residuals for least squares."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.forward_model import (
    LinearizedInsertion,
    linearize_insertion,
    predict,
    simulate_each,
)
from needlefit.inference.likelihood.marginal import (
    count_residuals,
    linear_residuals,
    linearize_residuals,
    log_marginals,
    mixing_matrices,
    solve_shared,
)
from needlefit.inference.likelihood.nodes import BEVEL, NodeGroup, Nodes, group_nodes
from needlefit.inference.likelihood.observation import (
    Observation,
    whiten_deflections,
    whiten_derivatives,
    whiten_residuals,
)
from needlefit.inference.parameters import BEVEL_SPREAD_BOUNDS, NOISE_SCALE_BOUNDS, Parameters
from needlefit.inference.simulated_points import (
    read_batch_deflections,
    read_batch_points,
    read_points,
    share_simulations,
)
from needlefit.inference.ties import BEVEL_SPREAD, NOISE_SCALE
from needlefit.mechanics.batch import NeedleShapes
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape
from needlefit.schemas.medium import MediumRecord

Values = Mapping[str, float]
Simulate = Callable[[Insertion], NeedleShape]
T = TypeVar("T")
Linearize = Callable[[Insertion], LinearizedInsertion]


@dataclass(frozen=True)
class PosteriorDensity:
    """The posterior of a medium's parameters, given some insertions; functions of all values (Pa, mm).

    Attributes
    ----------
    parameters : Parameters
        Theta's; with their prior.
    observations : tuple of Observation
        One of each insertion.
    scale : float
        What the deviations of the points' noise are multiplied by, where it is no parameter.
    centred_bevels : bool
        Whether b is the mean of the insertions' own, from which their deviations sum to zero.
    """

    parameters: Parameters
    medium: MediumRecord
    needle: Needle
    observations: tuple[Observation, ...]
    scale: float = 1.0
    centred_bevels: bool = False

    def log_density(self, values: Values) -> float:
        """Return the logarithm of likelihood and stated prior; NaN where a solve fails."""
        simulate = self._simulation(values)
        white = [self._white(one, one.nodes, simulate)[None] for one in self.observations]
        return float(self._add_up(white, [values])[0])

    def log_densities(self, sets: Sequence[Values], jobs: int) -> Floats:
        """Return `log_density` (B,) of many sets of values at once, on `jobs` threads."""
        return self._add_up(list(self.whitened_residuals(sets, jobs)), sets)

    def _add_up(self, white: Sequence[Floats], sets: Sequence[Values]) -> Floats:
        """Return the log densities (B,), given the whitened residuals (B, m, R) of every insertion."""
        scale = np.array([self._scale(values) for values in sets])
        spread = np.array([self._spread(values) for values in sets])
        total = np.array([self._log_prior(values) for values in sets])
        for members, group in self._groups:
            total += sum(self.observations[k].log_norm for k in members)
            total += log_marginals([white[k] for k in members], group, scale, spread)
        return total

    def whitened_residuals(self, sets: Sequence[Values], jobs: int) -> Iterator[Floats]:
        """Yield of each insertion the whitened residuals (B, m, R) of many sets of values at its m nodes."""
        nodes = [insertion for observation in self.observations for insertion in observation.nodes.insertions]
        sources = [self._sources[id(insertion)] for insertion in nodes]
        shapes = iter(simulate_each(sets, self.medium, self.needle, sources, jobs))
        for observation in self.observations:
            yield _white_each(observation, [next(shapes) for _ in observation.nodes.s])

    def estimate_bevel(
        self, sets: Sequence[Values], insertion: tuple[str, int], jobs: int
    ) -> tuple[Floats, Floats]:
        """Return means (B,) and deviations (B,) of the bevel of one insertion, given what was measured of it.

        In standard deviations of b between insertions, for many sets of values; 0 and 1 where nothing was
        measured.

        Parameters
        ----------
        insertion : (str, int)
            Its specimen and number in it, as `find_repeats` names it.
        """
        surface = (insertion[0], BEVEL, insertion[1])
        known = tuple(
            one for one in self.observations if surface in {axis.surface for axis in one.nodes.axes}
        )
        if not known:
            return np.zeros(len(sets)), np.ones(len(sets))
        white = list(replace(self, observations=known).whitened_residuals(sets, jobs))
        scale = np.array([self._scale(values) for values in sets])
        spread = np.array([self._spread(values) for values in sets])
        group = NodeGroup(tuple(one.nodes for one in known), (surface,))
        mean, covariance = solve_shared(white, group, scale, spread)
        return mean[:, 0], np.sqrt(covariance[:, 0, 0])

    def gradient(self, values: Values) -> tuple[float, Floats]:
        """Return `log_density` and its derivatives (P,) by theta; NaN where a solve fails."""
        scale, spread = self._scale(values), self._spread(values)
        stated, names = self.parameters.prior.residuals(values), self.parameters.free
        slope = -(stated @ self.parameters.prior.slopes(names))
        slope = slope + self._by_half_normal * (1 - self._spread_in_sd(values) ** 2)
        linearize = self._linearization(values)
        pairs = [self._white_and_slopes(one, one.nodes, linearize) for one in self.observations]
        total = float(self._add_up([white[None] for white, _ in pairs], [values])[0])
        for members, group in self._groups:
            found, by_spread = mixing_matrices([pairs[k][0] for k in members], group, scale, spread)
            slope = slope + self._by_spread * by_spread
            for k, mixed in zip(members, found, strict=True):
                white, by = pairs[k]
                slope = slope - np.einsum("mr,mrp->p", mixed @ white, by)
                # d/d(ln scale) of the log density: |residual|^2 of the mixture, minus one per row for the
                # normalising factor
                more = np.sum(mixed * (white @ white.T)) - self.observations[k].rows
                slope = slope + self._by_scale * more
        return total, slope

    def residuals(self, values: Values) -> Floats:
        """Return residuals (R,): of the insertions, of the normalising factor, and of the prior."""
        scale, spread, simulate = self._scale(values), self._spread(values), self._simulation(values)
        white = [self._white(one, nodes, simulate) for one, nodes in self._linear]
        pairs = [
            linear_residuals([white[k] for k in members], group, scale, spread)
            for members, group in self._linear_groups
        ]
        normal = self._normal(values, sum(log_det for _, log_det in pairs))
        return np.concatenate([*self._in_order(r for r, _ in pairs), normal, self._prior_residuals(values)])

    def jacobian(self, values: Values) -> tuple[Floats, Floats]:
        """Return `residuals` and their derivatives (R, P) by theta; NaN where a solve fails."""
        scale, spread, linearize = self._scale(values), self._spread(values), self._linearization(values)
        log_det, by_det, parts, slopes = 0.0, np.zeros(len(self.parameters.free)), [], []
        pairs = [self._white_and_slopes(one, nodes, linearize) for one, nodes in self._linear]
        for members, group in self._linear_groups:
            white = [pairs[k][0] for k in members]
            # residuals are white / scale: d/d(ln scale) is minus the residual
            by = [pairs[k][1] - pairs[k][0][..., None] * self._by_scale for k in members]
            part, more, part_slopes, more_slopes = linearize_residuals(
                white, by, group, (scale, spread), self._by_spread
            )
            log_det, by_det = log_det + more, by_det + more_slopes
            parts.append(part)
            slopes.append(part_slopes)
        normal = self._normal(values, log_det)
        # derivative of normal^2 / 2; divided by normal below, since d(normal) = d(normal^2 / 2) / normal
        by_normal = 0.5 * by_det + self._rows * self._by_scale - self._by_half_normal
        stated = [self.parameters.prior.slopes(self.parameters.free)]
        if self._by_half_normal.any():
            stated.append(self._spread_in_sd(values) * self._by_half_normal[None])
        tail = [normal, self._prior_residuals(values)]
        return (
            np.concatenate([*self._in_order(parts), *tail]),
            np.concatenate([*self._in_order(slopes), by_normal / normal[:, None], *stated]),
        )

    @cached_property
    def residual_counts(self) -> tuple[int, ...]:
        """Number of residuals of each insertion; the normalising one and the prior's come after them."""
        counts = [0] * len(self.observations)
        for members, group in self._linear_groups:
            rows = [self.observations[k].rows for k in members]
            for k, count in zip(members, count_residuals(group, rows), strict=True):
                counts[k] = count
        return tuple(counts)

    def _in_order(self, parts: Iterable[Floats]) -> list[Floats]:
        """Return the residuals of groups, (R,) or (R, P) each, insertion by insertion."""
        found: dict[int, Floats] = {}
        for (members, _), part in zip(self._linear_groups, parts, strict=True):
            ends = np.cumsum([self.residual_counts[k] for k in members])[:-1]
            found |= dict(zip(members, np.split(part, ends), strict=True))
        return [found[k] for k in sorted(found)]

    @cached_property
    def _groups(self) -> tuple[tuple[tuple[int, ...], NodeGroup], ...]:
        return group_nodes(tuple(one.nodes for one in self.observations), self.centred_bevels)

    @cached_property
    def _linear(self) -> tuple[tuple[Observation, Nodes], ...]:
        """Every observation with the nodes that linear effects need."""
        return tuple((one, one.nodes.linear_only) for one in self.observations)

    @cached_property
    def _linear_groups(self) -> tuple[tuple[tuple[int, ...], NodeGroup], ...]:
        return group_nodes(tuple(nodes for _, nodes in self._linear), self.centred_bevels)

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

    def _scale(self, values: Values) -> float:
        return values.get(NOISE_SCALE, self.scale)

    def _spread(self, values: Values) -> float:
        return values.get(BEVEL_SPREAD, 0.0)

    def _spread_in_sd(self, values: Values) -> float:
        """Return the bevel's spread in standard deviations of its half-normal prior; 0 if it has none."""
        sd = self.parameters.half_normal.get(BEVEL_SPREAD)
        return self._spread(values) / sd if sd and BEVEL_SPREAD in self.parameters.free else 0.0

    def _log_prior(self, values: Values) -> float:
        """Return the log density of what is stated; a half-normal spread is searched in its logarithm."""
        total, spread = self.parameters.prior.log_density(values), self._spread_in_sd(values)
        return total - 0.5 * spread**2 + np.log(spread) if spread else total

    def _prior_residuals(self, values: Values) -> Floats:
        stated, spread = self.parameters.prior.residuals(values), self._spread_in_sd(values)
        return np.append(stated, spread) if spread else stated

    def _normal(self, values: Values, log_det: float) -> Floats:
        """Return the residual (1,) whose square is the normalising factor; none if that is constant."""
        scale, spread = self._scale(values), self._spread_in_sd(values)
        moving = NOISE_SCALE in self.parameters.free
        varies = any(self._varies_log_det(group, values) for _, group in self._groups)
        if not moving and not spread and not varies:
            return np.empty(0)
        # 1 keeps it from 0, where its derivative would be infinite
        grown = 2 * self._rows * np.log(scale / NOISE_SCALE_BOUNDS[0]) if moving else 0.0
        less = 2 * np.log(BEVEL_SPREAD_BOUNDS[1] / spread) if spread else 0.0
        return np.array([np.sqrt(1.0 + grown + less + log_det)])

    def _varies_log_det(self, group: NodeGroup, values: Values) -> bool:
        """Return whether depths or bevel enter a group's log det; that of a pose is constant."""
        spreads = self._spread(values) > 0
        return any(nodes.axes or (nodes.bevel and spreads) for nodes in group.nodes)

    @cached_property
    def _sources(self) -> dict[int, Insertion]:
        """Which insertion is simulated for that of each node, by its identity."""
        nodes = [insertion for observation in self.observations for insertion in observation.nodes.insertions]
        sources = share_simulations(nodes, self.medium.constraint_spacing_mm)
        return {id(insertion): source for insertion, source in zip(nodes, sources, strict=True)}

    def _once(self, compute: Callable[[Insertion], T]) -> Callable[[Insertion], T]:
        """Return `compute` of an insertion's source; what several observations share is computed once."""
        kept: dict[int, T] = {}

        def computed(insertion: Insertion) -> T:
            source = self._sources[id(insertion)]
            if id(source) not in kept:
                kept[id(source)] = compute(source)
            return kept[id(source)]

        return computed

    def _simulation(self, values: Values) -> Simulate:
        return self._once(lambda insertion: predict(values, self.medium, self.needle, insertion))

    def _linearization(self, values: Values) -> Linearize:
        slopes = self.parameters.slopes(values)
        return self._once(
            lambda insertion: linearize_insertion(
                values, self.parameters, self.medium, self.needle, insertion, slopes
            )
        )

    def _white(self, observation: Observation, nodes: Nodes, simulate: Simulate) -> Floats:
        """Return the whitened residuals (m + c, R) of one insertion at some nodes; the pose's curves last."""
        pairs = zip(nodes.insertions, nodes.s, strict=True)
        points = [read_points(insertion, simulate(insertion), s) for insertion, s in pairs]
        return np.concatenate([whiten_residuals(observation, np.array(points)), observation.pose_curves])

    def _white_and_slopes(
        self, observation: Observation, nodes: Nodes, linearize: Linearize
    ) -> tuple[Floats, Floats]:
        """Return the same and the derivatives (m, R, P) by theta."""
        white, by = [], []
        for insertion, s in zip(nodes.insertions, nodes.s, strict=True):
            points, slopes = linearize(insertion).read(s)
            white.append(whiten_residuals(observation, points))
            by.append(whiten_derivatives(observation, points, slopes))
        by += [np.zeros_like(by[0])] * len(observation.pose_curves)
        return np.array([*white, *observation.pose_curves]), np.array(by)


def _white_each(observation: Observation, shapes: Sequence[NeedleShapes]) -> Floats:
    """Return the whitened residuals (B, m, R) of B needles at the m nodes; NaN where a solve failed."""
    trios = list(zip(observation.nodes.insertions, shapes, observation.nodes.s, strict=True))
    if observation.pose == "free":
        points = np.stack([read_batch_points(*trio) for trio in trios], axis=1)
        return whiten_residuals(observation, points)
    # what is not aligned is compared in its deflection alone
    deflections = np.stack([read_batch_deflections(*trio) for trio in trios], axis=1)
    white = whiten_deflections(observation, deflections)
    constant = np.broadcast_to(observation.pose_curves, (len(white), *observation.pose_curves.shape))
    return np.concatenate([white, constant], axis=1)
