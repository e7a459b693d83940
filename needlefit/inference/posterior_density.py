"""The posterior density of one fit, its exact gradient, and its residuals for least squares."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.likelihood.marginal import (
    count_residuals,
    linear_residuals,
    linearize_residuals,
    log_marginals,
    mixing_matrices,
    solve_shared,
)
from needlefit.inference.likelihood.nodes import BEVEL, NodeGroup, Nodes, group_nodes
from needlefit.inference.likelihood.observation import Observation, whiten_derivatives, whiten_residuals
from needlefit.inference.parameters import (
    BEVEL_SPREAD,
    BEVEL_SPREAD_BOUNDS,
    NOISE_SCALE,
    NOISE_SCALE_BOUNDS,
    Parameters,
)
from needlefit.mechanics.needle import Needle
from needlefit.schemas.medium import MediumRecord

Values = Mapping[str, float]


SETS_AT_ONCE = 256  #: sets of values whose needles are held at once: those of thousands would take gigabytes


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

    def log_densities(self, sets: Sequence[Values], jobs: int = 1) -> Floats:
        """Return the log of likelihood and stated prior (B,) of sets of values; NaN where a solve fails."""
        parts = [sets[start : start + SETS_AT_ONCE] for start in range(0, len(sets), SETS_AT_ONCE)]
        return np.concatenate(
            [self._add_up(list(self.whitened_residuals(part, jobs)), part) for part in parts]
        )

    def _add_up(self, white: Sequence[Floats], sets: Sequence[Values]) -> Floats:
        """Return the log densities (B,), given the whitened residuals (B, m, R) of every insertion."""
        scale, spread = self._scales(sets)
        total = np.array([self._log_prior(values) for values in sets])
        for members, group in self._nodes.groups:
            total += sum(self.observations[k].log_norm for k in members)
            total += log_marginals([white[k] for k in members], group, scale, spread)
        return total

    def whitened_residuals(self, sets: Sequence[Values], jobs: int) -> Iterator[Floats]:
        """Yield of each insertion the whitened residuals (B, m, R) of many sets of values at its m nodes."""
        return self._whiten(self._nodes, sets, jobs)

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

    def gradients(self, sets: Sequence[Values], jobs: int = 1) -> list[tuple[float, Floats]]:
        """Return `log_densities`, and the derivatives (P,) of each by theta; NaN where a solve fails."""
        pairs = self._differentiate(self._nodes, sets, jobs)
        totals = self._add_up([white for white, _ in pairs], sets)
        return [
            (float(totals[b]), self._slope(values, [(white[b], by[b]) for white, by in pairs]))
            for b, values in enumerate(sets)
        ]

    def _slope(self, values: Values, pairs: Sequence[tuple[Floats, Floats]]) -> Floats:
        """Return the derivatives (P,) of the log density, given those of white (m, R), (m, R, P)."""
        scale, spread = values.get(NOISE_SCALE, self.scale), values.get(BEVEL_SPREAD, 0.0)
        stated, names = self.parameters.prior.residuals(values), self.parameters.free
        slope = -(stated @ self.parameters.prior.slopes(names))
        slope = slope + self._by_half_normal * (1 - self._spread_in_sd(values) ** 2)
        for members, group in self._nodes.groups:
            found, by_spread = mixing_matrices([pairs[k][0] for k in members], group, scale, spread)
            slope = slope + self._by_spread * by_spread
            for k, mixed in zip(members, found, strict=True):
                white, by = pairs[k]
                slope = slope - (mixed @ white).reshape(-1) @ by.reshape(-1, by.shape[-1])
                # d/d(ln scale) of the log density: |residual|^2 of the mixture, minus one per row for the
                # normalising factor
                more = np.sum(mixed * (white @ white.T)) - self.observations[k].rows
                slope = slope + self._by_scale * more
        return slope

    def residuals(self, values: Values) -> Floats:
        """Return residuals (R,): of the insertions, of the normalising factor, and of the prior."""
        scale, spread = self._scales([values])
        white = list(self._whiten(self._linear_nodes, [values], 1))
        pairs = [
            linear_residuals([white[k] for k in members], group, scale, spread)
            for members, group in self._linear_nodes.groups
        ]
        parts = [part[0] for part in self._in_order(part for part, _ in pairs)]
        normal = self._normal(values, sum(float(log_det[0]) for _, log_det in pairs))
        return np.concatenate([*parts, normal, self._prior_residuals(values)])

    def jacobians(self, sets: Sequence[Values], jobs: int = 1) -> list[tuple[Floats, Floats]]:
        """Return of each set `residuals` and their derivatives (R, P) by theta; NaN where a solve fails."""
        at = self._scales(sets)
        log_det, by_det = np.zeros(len(sets)), np.zeros((len(sets), len(self.parameters.free)))
        parts, slopes = [], []
        pairs = self._differentiate(self._linear_nodes, sets, jobs)
        for members, group in self._linear_nodes.groups:
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
        for members, group in self._linear_nodes.groups:
            rows = [self.observations[k].rows for k in members]
            for k, count in zip(members, count_residuals(group, rows), strict=True):
                counts[k] = count
        return tuple(counts)

    def _in_order(self, parts: Iterable[Floats]) -> list[Floats]:
        """Return the residuals of groups, (B, R) or (B, R, P) each, insertion by insertion."""
        found: dict[int, Floats] = {}
        for (members, _), part in zip(self._linear_nodes.groups, parts, strict=True):
            ends = np.cumsum([self.residual_counts[k] for k in members])[:-1]
            found |= dict(zip(members, np.split(part, ends, axis=1), strict=True))
        return [found[k] for k in sorted(found)]

    @cached_property
    def _nodes(self) -> "_ModelledNodes":
        """The nodes of all insertions."""
        return self._prepare([one.nodes for one in self.observations])

    @cached_property
    def _linear_nodes(self) -> "_ModelledNodes":
        """Those that linear effects need."""
        return self._prepare([one.nodes.linear_only for one in self.observations])

    def _prepare(self, nodes: Sequence[Nodes]) -> "_ModelledNodes":
        every = [insertion for some in nodes for insertion in some.insertions]
        model = PreparedModel(self.medium, self.needle, every)
        return _ModelledNodes(tuple(nodes), model, group_nodes(tuple(nodes), self.centred_bevels))

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

    def _whiten(self, nodes: "_ModelledNodes", sets: Sequence[Values], jobs: int) -> Iterator[Floats]:
        """Yield the whitened residuals (B, m + c, R) of each insertion, the c curves of the pose last."""
        points = iter(nodes.model.read_points(sets, nodes.places, jobs))
        for one, some in zip(self.observations, nodes.nodes, strict=True):
            stacked = np.stack([next(points) for _ in some.s], axis=1)  # (B, m, K, 2)
            yield _append_curves(one, whiten_residuals(one, stacked))

    def _differentiate(
        self, nodes: "_ModelledNodes", sets: Sequence[Values], jobs: int
    ) -> list[tuple[Floats, Floats]]:
        """Return of each insertion the same, and the derivatives (B, m + c, R, P) by theta."""
        found = []
        points, slopes = map(iter, nodes.model.differentiate(sets, self.parameters, nodes.places, jobs))
        for one, some in zip(self.observations, nodes.nodes, strict=True):
            stacked, by = (np.stack([next(part) for _ in some.s], axis=1) for part in (points, slopes))
            white = _append_curves(one, whiten_residuals(one, stacked))
            by_white = np.zeros((*white.shape, by.shape[-1]))
            by_white[:, : len(some.s)] = whiten_derivatives(one, stacked, by)
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


def _append_curves(observation: Observation, white: Floats) -> Floats:
    """Return whitened residuals (B, m, R) with the curves of the pose behind them."""
    curves = np.broadcast_to(observation.pose_curves, (len(white), *observation.pose_curves.shape))
    return np.concatenate([white, curves], axis=1)
