"""The posterior density of one fit, its exact gradient, and the residuals it is made of."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.likelihood.depths import Nodes
from needlefit.inference.likelihood.evidence import (
    Evidence,
    whitened,
    whitened_deflections,
    whitened_slopes,
)
from needlefit.inference.likelihood.marginal import (
    log_marginals,
    mixing,
    residual_slopes,
    residuals,
)
from needlefit.inference.parameters import SCALES, Parameters
from needlefit.inference.predict import predict, predict_each
from needlefit.inference.slopes import predict_with_slopes
from needlefit.inference.ties import NOISE_SCALE
from needlefit.mechanics.batch import NeedleShapes, compute_batch_deflections, compute_batch_positions
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.medium import MediumRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Density:
    """What is known of the parameters of a medium from some insertions; functions of all values (Pa, mm).

    Attributes
    ----------
    parameters : Parameters
        Theta's; with their prior.
    medium : MediumRecord
    needle : Needle
    evidence : tuple of Evidence
        One of each insertion.
    scale : float
        What the deviations of noise and pose are multiplied by, where no parameter says it.
    """

    parameters: Parameters
    medium: MediumRecord
    needle: Needle
    evidence: tuple[Evidence, ...]
    scale: float = 1.0

    def log(self, values: Mapping[str, float]) -> float:
        """Return the logarithm of likelihood and stated prior; NaN where a solve fails."""
        scale = np.array([self._scale(values)])
        total = self.parameters.prior.log_density(values)
        for known in self.evidence:
            white = self._white(known, known.nodes, values)
            total += known.log_norm + float(log_marginals(white[None], known.nodes, scale)[0])
        return total

    def logs(self, sets: Sequence[Mapping[str, float]], jobs: int) -> Floats:
        """Return `log` (B,) of many sets of values at once, on `jobs` threads."""
        scales = np.array([self._scale(values) for values in sets])
        total = np.array([self.parameters.prior.log_density(values) for values in sets])
        for known, white in zip(self.evidence, self.whites(sets, jobs), strict=True):
            total += known.log_norm + log_marginals(white, known.nodes, scales)
        return total

    def whites(self, sets: Sequence[Mapping[str, float]], jobs: int) -> Iterator[Floats]:
        """Yield of each insertion the whitened residuals (B, m, R) of many sets of values at its m nodes."""
        batches = [
            predict_each(sets, self.medium, self.needle, insertion)
            for known in self.evidence
            for insertion in known.nodes.insertions
        ]
        shapes = iter(simulate_batches(batches, jobs))
        for known in self.evidence:
            yield _white_each(known, [next(shapes) for _ in known.nodes.s])

    def gradient(self, values: Mapping[str, float]) -> tuple[float, Floats]:
        """Return `log` and its derivatives (P,) by theta; NaN where a solve fails."""
        prior, scale = self.parameters.prior, self._scale(values)
        stated, names = prior.residuals(values), self.parameters.free
        total, slope = -0.5 * float(stated @ stated), -(stated @ prior.slopes(names))
        for known in self.evidence:
            white, by = self._white_and_slopes(known, known.nodes, values)
            mixed = mixing(white, known.nodes, scale)
            total += known.log_norm
            total += float(log_marginals(white[None], known.nodes, np.array([scale]))[0])
            slope = slope - np.einsum("mr,mrp->p", mixed @ white, by)
            slope = slope + self._by_scale * (np.sum(mixed * (white @ white.T)) - known.rows)
        return total, slope

    def residuals(self, values: Mapping[str, float]) -> Floats:
        """Return residuals (R,): of the insertions, of what normalises their density, and of the prior."""
        scale = self._scale(values)
        straight = [(known, known.nodes.straight) for known in self.evidence]
        pairs = [residuals(self._white(known, nodes, values), nodes, scale) for known, nodes in straight]
        normal = self._normal(scale, sum(log_det for _, log_det in pairs))
        return np.concatenate([*(r for r, _ in pairs), normal, self.parameters.prior.residuals(values)])

    def jacobian(self, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Return `residuals` and their derivatives (R, P) by theta; NaN where a solve fails."""
        scale, parts, slopes = self._scale(values), [], []
        log_det, by_det = 0.0, np.zeros(len(self.parameters.free))
        for known in self.evidence:
            nodes = known.nodes.straight
            white, by = self._white_and_slopes(known, nodes, values)
            # a larger scale shrinks residuals as a whole
            by = by - white[..., None] * self._by_scale
            part, more = residuals(white, nodes, scale)
            part_slopes, more_slopes = residual_slopes(white, by, nodes, scale)
            log_det, by_det = log_det + more, by_det + more_slopes
            parts.append(part)
            slopes.append(part_slopes)
        normal, prior = self._normal(scale, log_det), self.parameters.prior
        by_normal = 0.5 * by_det + self._rows * self._by_scale
        parts += [normal, prior.residuals(values)]
        slopes += [by_normal / normal[:, None], prior.slopes(self.parameters.free)]
        return np.concatenate(parts), np.concatenate(slopes)

    @property
    def told(self) -> tuple[int, ...]:
        """How many of `residuals` each insertion has; the normalising one and the prior's follow."""
        return tuple(known.rows + known.nodes.axes for known in self.evidence)

    @property
    def _rows(self) -> int:
        return sum(known.rows for known in self.evidence)

    @property
    def _by_scale(self) -> Floats:
        """Derivatives (P,) of the logarithm of the scale."""
        return np.array([float(name == NOISE_SCALE) for name in self.parameters.free])

    def _scale(self, values: Mapping[str, float]) -> float:
        return values.get(NOISE_SCALE, self.scale)

    def _normal(self, scale: float, log_det: float) -> Floats:
        """Return the residual (1,) whose square is the normalising factor; none if that is constant."""
        moving = NOISE_SCALE in self.parameters.free
        if not moving and not any(known.nodes.axes for known in self.evidence):
            return np.empty(0)
        # 1 keeps it from 0, where its derivative would be infinite
        grown = 2 * self._rows * np.log(scale / SCALES[0]) if moving else 0.0
        return np.array([np.sqrt(1.0 + grown + log_det)])

    def _white(self, known: Evidence, nodes: Nodes, values: Mapping[str, float]) -> Floats:
        """Return the whitened residuals (m, R) at some nodes of one insertion."""
        points = []
        for insertion, s in zip(nodes.insertions, nodes.s, strict=True):
            shape = predict(values, self.medium, self.needle, insertion)
            points.append(compute_positions(shape, s) if shape.converged else np.full((len(s), 2), np.nan))
        return whitened(known, np.array(points))

    def _white_and_slopes(
        self, known: Evidence, nodes: Nodes, values: Mapping[str, float]
    ) -> tuple[Floats, Floats]:
        """Return the same and the derivatives (m, R, P) by theta."""
        white, by = [], []
        for insertion, s in zip(nodes.insertions, nodes.s, strict=True):
            points, slopes = predict_with_slopes(
                values, self.parameters, self.medium, self.needle, insertion, s
            )
            white.append(whitened(known, points))
            by.append(whitened_slopes(known, points, slopes))
        return np.array(white), np.array(by)


def _white_each(known: Evidence, shapes: Sequence[NeedleShapes]) -> Floats:
    """Return the whitened residuals (B, m, R) of B needles at the m nodes; NaN where a solve failed."""
    pairs = list(zip(shapes, known.nodes.s, strict=True))
    if known.pose == "known":  # what is not aligned is compared in its deflection alone
        return whitened_deflections(
            known, np.stack([compute_batch_deflections(*pair) for pair in pairs], axis=1)
        )
    return whitened(known, np.stack([compute_batch_positions(*pair) for pair in pairs], axis=1))
