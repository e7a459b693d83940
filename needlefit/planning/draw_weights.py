"""Draws of the parameters of one insertion, weighted by what is measured of it (importance sampling).

Where the effective number of draws falls below `MIN_EFFECTIVE_DRAWS`, new ones are drawn from a Gaussian
about the weighted ones, and weighted by prior times likelihood over that Gaussian (population Monte Carlo: O.
Cappe et al., J. Comput. Graph. Stat. 13 (2004) 907). The prior then is the Gaussian of the first draws.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.errors import ModelError
from needlefit.inference.forward_model import ParameterDraws

MIN_EFFECTIVE_DRAWS = 200.0  #: smallest effective number of draws, of 500; of fewer draws the same part
MAX_ROUNDS = 6  #: largest number of rounds of new draws after one measurement
INFLATION = 1.3  #: factor on the covariance from which new draws come: their weights then stay bounded
KEPT_VARIANCE = 1e-9  #: variance, as a fraction of the largest one, below which a direction is exact


@dataclass(frozen=True)
class SteeredDraws:
    """B draws of ln mu, ln b, the share that the tissue follows, the base's gain and the axis's slope.

    They are `mean` + `at` @ `axes`, have weights, and the prior of `at` is a standard normal.
    """

    mean: Floats  #: (n + 4,)
    axes: Floats  #: (R, n + 4) of the R directions that are not exact
    at: Floats  #: (B, R)
    shape: Floats  #: (B, p, n) shape parameters of the law, which are not learnt
    log_weights: Floats  #: (B,)

    @classmethod
    def begin(
        cls, draws: ParameterDraws, count: int, gain_sd: float, slope_sd: float, rng: np.random.Generator
    ) -> Self:
        """Return `count` draws, each with effects of this insertion: a gain about 1, a slope about 0.

        Raises ModelError where a modulus or the bevel's strength is not positive.
        """
        if not (np.all(draws.mu > 0) and np.all(draws.bevel > 0)):
            raise ModelError("a draw has no positive modulus or bevel", expected="numbers above 0")
        if count <= len(draws):
            rows = np.linspace(0, len(draws) - 1, count).astype(np.intp)
        else:
            rows = np.arange(count) % len(draws)
        some = draws.only(rows)
        effects = rng.standard_normal((count, 2)) * (gain_sd, slope_sd) + (1.0, 0.0)
        carried = np.zeros(count) if some.carried is None else some.carried
        known = np.column_stack([np.log(some.mu), np.log(some.bevel), carried])
        mean = np.append(known.mean(axis=0), (1.0, 0.0))
        covariance = np.zeros((len(mean), len(mean)))
        covariance[:-2, :-2] = np.cov(known, rowvar=False) if count > 1 else 0.0
        covariance[[-2, -1], [-2, -1]] = gain_sd**2, slope_sd**2
        variances, directions = np.linalg.eigh(covariance)
        kept = variances > KEPT_VARIANCE * max(variances.max(), 1e-12)
        sizes = np.sqrt(variances[kept])
        coordinates = (np.column_stack([known, effects]) - mean) @ directions[:, kept] / sizes
        return cls(mean, (directions[:, kept] * sizes).T, coordinates, some.shape, np.zeros(count))

    @property
    def weights(self) -> Floats:
        """Their weights (B,), which add up to 1."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return np.asarray(weights / weights.sum())

    @property
    def effective(self) -> float:
        """The effective number of draws."""
        return float(1.0 / np.sum(self.weights**2))

    def to_parameters(self, rows: Ints | None = None) -> ParameterDraws:
        """Return the parameters of all draws, or of some."""
        rows = np.arange(len(self.at)) if rows is None else rows
        parameters = self.mean + self.at[rows] @ self.axes
        carried, gain, slope = parameters[:, -3:].T
        strengths = np.exp(parameters[:, :-3])
        return ParameterDraws(strengths[:, :-1], self.shape[rows], strengths[:, -1], gain, carried, slope)

    def list_sigma_points(self) -> ParameterDraws:
        """Return 2 R draws of equal weights, two along each direction, with mean and covariance of all.

        S. J. Julier and J. K. Uhlmann, Proc. IEEE 92 (2004) 401, section IV.
        """
        centre = self.weights @ self.at
        away = (self.at - centre) * np.sqrt(len(centre) * self.weights)[:, None]
        root = np.linalg.qr(away).R  # root^T root is R times the covariance
        points = centre + np.concatenate([root, -root]) if len(root) else centre[None]
        shape = np.tensordot(self.weights, self.shape, 1)
        return replace(self, at=points, shape=np.tile(shape, (len(points), 1, 1))).to_parameters()

    def choose(self, count: int) -> Ints:
        """Return which draws (count,) stand for all with equal weights: by systematic resampling."""
        places = (np.arange(count) + 0.5) / count
        return np.minimum(np.searchsorted(np.cumsum(self.weights), places), len(self.at) - 1)

    def learn(
        self,
        now: Floats,
        weigh: Callable[["SteeredDraws"], Floats],
        rng: np.random.Generator,
    ) -> tuple["SteeredDraws", int]:
        """Return the draws after a measurement, and in how many rounds new ones were drawn.

        `now` (B,) is its log likelihood; `weigh` returns that of all measurements together, of new draws.

        Raises ModelError where no draw has a needle.
        """
        learned, rounds = replace(self, log_weights=self.log_weights + now), 0
        if not np.isfinite(learned.log_weights.max()):
            raise ModelError("no draw of the parameters has a needle there", expected="one that is solved")
        fewest = MIN_EFFECTIVE_DRAWS * min(1.0, len(self.at) / 500.0)
        while learned.effective < fewest and rounds < MAX_ROUNDS and len(self.axes):
            learned, rounds = learned._draw_anew(fewest, weigh, rng), rounds + 1
        return learned, rounds

    def _draw_anew(
        self, fewest: float, weigh: Callable[["SteeredDraws"], Floats], rng: np.random.Generator
    ) -> "SteeredDraws":
        weights = self._flatten(fewest / 2)
        centre = weights @ self.at
        away = self.at - centre
        covariance = INFLATION * (away.T * weights) @ away + 1e-6 * np.eye(len(centre))
        root = np.linalg.cholesky(covariance)
        normal = rng.standard_normal(self.at.shape)
        moved = replace(self, at=centre + normal @ root.T)
        proposed = -0.5 * np.sum(normal**2, axis=1)
        log_weights = weigh(moved) - 0.5 * np.sum(moved.at**2, axis=1) - proposed
        if not np.isfinite(log_weights.max()):
            return self
        return replace(moved, log_weights=log_weights)

    def _flatten(self, fewest: float) -> Floats:
        """Return the weights to the greatest power up to 1 that leaves so many effective draws."""
        low, high, flattened = 0.0, 1.0, self
        for _ in range(30 if self.effective < fewest else 0):
            power = (low + high) / 2
            flattened = replace(self, log_weights=power * np.maximum(self.log_weights, -1e300))
            low, high = (power, high) if flattened.effective >= fewest else (low, power)
        return flattened.weights
