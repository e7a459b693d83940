"""Mixtures of Student's t: density, draws, and the step of EM that fits one to weighted draws."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from needlefit.arrays import Floats, log_sum_exp

#: degrees of freedom: heavy enough tails for posteriors within bounds, at a small loss on Gaussian ones
DEGREES_OF_FREEDOM = 5.0


@dataclass(frozen=True)
class StudentMixture:
    """A mixture of multivariate Student's t distributions, each with its own centre and scale."""

    weights: Floats  #: (M,) they sum to 1
    centres: Floats  #: (M, P)
    factors: Floats  #: (M, P, P) lower triangular roots of their scale matrices

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return `count` draws (N, P)."""
        return np.concatenate([*self.draw_parts(count, rng, max(1, count))])

    def draw_parts(self, count: int, rng: np.random.Generator, size: int) -> Iterator[Floats]:
        """Yield `count` draws (N, P), `size` at a time; all random numbers are drawn with the first."""
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, self.centres.shape[1]))
        spread = np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, size=count))
        for some in (slice(start, start + size) for start in range(0, max(1, count), size)):
            moves = np.einsum("npq,nq->np", self.factors[which[some]], normal[some])
            yield self.centres[which[some]] + spread[some, None] * moves

    def log_density(self, thetas: Floats) -> Floats:
        """Return the log density (N,) at points (N, P)."""
        return log_sum_exp(self._joint(thetas, self._distances(thetas)), axis=1)

    def _distances(self, thetas: Floats) -> Floats:
        """Return squared distances (N, M) from the centres in units of the scales."""
        # inverses of small triangular factors, which all points share
        inverses = np.linalg.inv(self.factors)
        white = inverses @ thetas.T  # (M, P, N)
        white -= inverses @ self.centres[:, :, None]
        white *= white  # in place: memory for another one takes most of the time
        return white.sum(axis=1).T

    def _joint(self, thetas: Floats, squares: Floats) -> Floats:
        """Return log weight and density (N, M) of every component."""
        p = thetas.shape[1]
        norm = (
            gammaln(0.5 * (DEGREES_OF_FREEDOM + p))
            - gammaln(0.5 * DEGREES_OF_FREEDOM)
            - 0.5 * p * np.log(DEGREES_OF_FREEDOM * np.pi)
        )
        volume = np.sum(np.log(np.diagonal(self.factors, axis1=1, axis2=2)), axis=1)  # (M,)
        with np.errstate(divide="ignore"):
            logs = np.log(self.weights) + norm - volume
        return logs - 0.5 * (DEGREES_OF_FREEDOM + p) * np.log1p(squares / DEGREES_OF_FREEDOM)

    def refit(self, thetas: Floats, weights: Floats, least: Floats) -> "StudentMixture":
        """Return the mixture after one EM step towards points (N, P) of `weights` (N,), which sum to 1.

        `least` (P, P) is added to every scale matrix; components that hardly any point belongs to go.
        """
        squares = self._distances(thetas)
        joint = self._joint(thetas, squares)
        belongs = weights[:, None] * np.exp(joint - log_sum_exp(joint, axis=1)[:, None])  # (N, M)
        p = thetas.shape[1]
        # weights of the Student likelihood: points far out pull less, as in robust regression
        pulls = belongs * (DEGREES_OF_FREEDOM + p) / (DEGREES_OF_FREEDOM + squares)
        parts, count = belongs.sum(axis=0), belongs.sum(axis=0) ** 2 / np.sum(belongs**2, axis=0).clip(1e-300)
        # a component with fewer effective points than this has no full-rank covariance
        kept = np.flatnonzero(count > p + 1)
        if not len(kept):
            return self
        pulls = pulls[:, kept]
        centres = (pulls.T @ thetas) / pulls.sum(axis=0)[:, None]
        moved = zip(pulls.T, (thetas - centre for centre in centres), strict=True)
        scales = np.array([(pull * away.T) @ away for pull, away in moved]) / parts[kept, None, None]
        return StudentMixture(parts[kept] / parts[kept].sum(), centres, np.linalg.cholesky(scales + least))


def join_mixtures(parts: Sequence[StudentMixture], shares: Sequence[float]) -> StudentMixture:
    """Return the mixture of several, each with its share; these sum to 1."""
    return StudentMixture(
        np.concatenate([share * part.weights for part, share in zip(parts, shares, strict=True)]),
        np.concatenate([part.centres for part in parts]),
        np.concatenate([part.factors for part in parts]),
    )
