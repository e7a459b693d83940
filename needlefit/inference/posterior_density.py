"""The posterior density of one fit, its exact gradient, and its residuals for least squares."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.forward_model import make_batch, predict, predict_with_derivatives
from needlefit.inference.likelihood.depths import Nodes
from needlefit.inference.likelihood.marginal import (
    linear_residual_derivatives,
    linear_residuals,
    log_marginals,
    mixing_matrix,
)
from needlefit.inference.likelihood.observation import (
    Observation,
    whiten_deflections,
    whiten_derivatives,
    whiten_residuals,
)
from needlefit.inference.parameters import NOISE_SCALE_BOUNDS, Parameters
from needlefit.inference.ties import NOISE_SCALE
from needlefit.mechanics.batch import NeedleShapes, compute_batch_deflections, compute_batch_positions
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.medium import MediumRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PosteriorDensity:
    """The posterior of a medium's parameters, given some insertions; functions of all values (Pa, mm).

    Attributes
    ----------
    parameters : Parameters
        Theta's; with their prior.
    medium : MediumRecord
    needle : Needle
    observations : tuple of Observation
        One of each insertion.
    scale : float
        What the deviations of noise and pose are multiplied by, where it is no parameter.
    """

    parameters: Parameters
    medium: MediumRecord
    needle: Needle
    observations: tuple[Observation, ...]
    scale: float = 1.0

    def log_density(self, values: Mapping[str, float]) -> float:
        """Return the logarithm of likelihood and stated prior; NaN where a solve fails."""
        scale = np.array([self._scale(values)])
        total = self.parameters.prior.log_density(values)
        for observation in self.observations:
            white = self._white(observation, observation.nodes, values)
            total += observation.log_norm + float(log_marginals(white[None], observation.nodes, scale)[0])
        return total

    def log_densities(self, sets: Sequence[Mapping[str, float]], jobs: int) -> Floats:
        """Return `log_density` (B,) of many sets of values at once, on `jobs` threads."""
        scales = np.array([self._scale(values) for values in sets])
        total = np.array([self.parameters.prior.log_density(values) for values in sets])
        for observation, white in zip(self.observations, self.whitened_residuals(sets, jobs), strict=True):
            total += observation.log_norm + log_marginals(white, observation.nodes, scales)
        return total

    def whitened_residuals(self, sets: Sequence[Mapping[str, float]], jobs: int) -> Iterator[Floats]:
        """Yield of each insertion the whitened residuals (B, m, R) of many sets of values at its m nodes."""
        batches = [
            make_batch(sets, self.medium, self.needle, insertion)
            for observation in self.observations
            for insertion in observation.nodes.insertions
        ]
        # all nodes of all insertions go into one call, so that threads stay busy; they come back in this
        # order
        shapes = iter(simulate_batches(batches, jobs))
        for observation in self.observations:
            yield _white_each(observation, [next(shapes) for _ in observation.nodes.s])

    def gradient(self, values: Mapping[str, float]) -> tuple[float, Floats]:
        """Return `log_density` and its derivatives (P,) by theta; NaN where a solve fails."""
        prior, scale = self.parameters.prior, self._scale(values)
        stated, names = prior.residuals(values), self.parameters.free
        total, slope = -0.5 * float(stated @ stated), -(stated @ prior.slopes(names))
        for observation in self.observations:
            white, by = self._white_and_slopes(observation, observation.nodes, values)
            mixed = mixing_matrix(white, observation.nodes, scale)
            total += observation.log_norm
            total += float(log_marginals(white[None], observation.nodes, np.array([scale]))[0])
            slope = slope - np.einsum("mr,mrp->p", mixed @ white, by)
            # d/d(ln scale) of the log density: |residual|^2 of the mixture, minus one per row for the
            # normalising factor
            slope = slope + self._by_scale * (np.sum(mixed * (white @ white.T)) - observation.rows)
        return total, slope

    def residuals(self, values: Mapping[str, float]) -> Floats:
        """Return residuals (R,): of the insertions, of the normalising factor, and of the prior."""
        scale = self._scale(values)
        linear_only = [(observation, observation.nodes.linear_only) for observation in self.observations]
        pairs = [
            linear_residuals(self._white(observation, nodes, values), nodes, scale)
            for observation, nodes in linear_only
        ]
        normal = self._normal(scale, sum(log_det for _, log_det in pairs))
        return np.concatenate([*(r for r, _ in pairs), normal, self.parameters.prior.residuals(values)])

    def jacobian(self, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Return `residuals` and their derivatives (R, P) by theta; NaN where a solve fails."""
        scale, parts, slopes = self._scale(values), [], []
        log_det, by_det = 0.0, np.zeros(len(self.parameters.free))
        for observation in self.observations:
            nodes = observation.nodes.linear_only
            white, by = self._white_and_slopes(observation, nodes, values)
            # residuals are white / scale: d/d(ln scale) is minus the residual
            by = by - white[..., None] * self._by_scale
            part, more = linear_residuals(white, nodes, scale)
            part_slopes, more_slopes = linear_residual_derivatives(white, by, nodes, scale)
            log_det, by_det = log_det + more, by_det + more_slopes
            parts.append(part)
            slopes.append(part_slopes)
        normal, prior = self._normal(scale, log_det), self.parameters.prior
        # derivative of normal^2 / 2; divided by normal below, since d(normal) = d(normal^2 / 2) / normal
        by_normal = 0.5 * by_det + self._rows * self._by_scale
        parts += [normal, prior.residuals(values)]
        slopes += [by_normal / normal[:, None], prior.slopes(self.parameters.free)]
        return np.concatenate(parts), np.concatenate(slopes)

    @property
    def residual_counts(self) -> tuple[int, ...]:
        """Number of residuals of each insertion; the normalising one and the prior's come after them."""
        return tuple(observation.rows + observation.nodes.axes for observation in self.observations)

    @property
    def _rows(self) -> int:
        return sum(observation.rows for observation in self.observations)

    @property
    def _by_scale(self) -> Floats:
        """Derivatives (P,) of the logarithm of the scale."""
        return np.array([float(name == NOISE_SCALE) for name in self.parameters.free])

    def _scale(self, values: Mapping[str, float]) -> float:
        return values.get(NOISE_SCALE, self.scale)

    def _normal(self, scale: float, log_det: float) -> Floats:
        """Return the residual (1,) whose square is the normalising factor; none if that is constant."""
        moving = NOISE_SCALE in self.parameters.free
        if not moving and not any(observation.nodes.axes for observation in self.observations):
            return np.empty(0)
        # 1 keeps it from 0, where its derivative would be infinite
        grown = 2 * self._rows * np.log(scale / NOISE_SCALE_BOUNDS[0]) if moving else 0.0
        return np.array([np.sqrt(1.0 + grown + log_det)])

    def _white(self, observation: Observation, nodes: Nodes, values: Mapping[str, float]) -> Floats:
        """Return the whitened residuals (m, R) at some nodes of one insertion."""
        points = []
        for insertion, s in zip(nodes.insertions, nodes.s, strict=True):
            shape = predict(values, self.medium, self.needle, insertion)
            points.append(compute_positions(shape, s) if shape.converged else np.full((len(s), 2), np.nan))
        return whiten_residuals(observation, np.array(points))

    def _white_and_slopes(
        self, observation: Observation, nodes: Nodes, values: Mapping[str, float]
    ) -> tuple[Floats, Floats]:
        """Return the same and the derivatives (m, R, P) by theta."""
        white, by = [], []
        for insertion, s in zip(nodes.insertions, nodes.s, strict=True):
            points, slopes = predict_with_derivatives(
                values, self.parameters, self.medium, self.needle, insertion, s
            )
            white.append(whiten_residuals(observation, points))
            by.append(whiten_derivatives(observation, points, slopes))
        return np.array(white), np.array(by)


def _white_each(observation: Observation, shapes: Sequence[NeedleShapes]) -> Floats:
    """Return the whitened residuals (B, m, R) of B needles at the m nodes; NaN where a solve failed."""
    pairs = list(zip(shapes, observation.nodes.s, strict=True))
    if observation.pose == "known":  # what is not aligned is compared in its deflection alone
        return whiten_deflections(
            observation, np.stack([compute_batch_deflections(*pair) for pair in pairs], axis=1)
        )
    return whiten_residuals(observation, np.stack([compute_batch_positions(*pair) for pair in pairs], axis=1))
