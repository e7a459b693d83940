"""Mixtures of Student's t: proposals with tails, and how they are fitted to weighted draws.

Fitting is the Rao-Blackwellised population Monte Carlo of O. Cappe, R. Douc, A. Guillin, J.-M. Marin and
C. P. Robert, Stat. Comput. 18 (2008) 447: one step of expectation and maximisation over all components.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

Floats = NDArray[np.float64]

FREEDOM = 5.0
"""Degrees of freedom: heavy enough for posteriors within bounds, at a small loss on Gaussian ones."""


@dataclass(frozen=True)
class Mixture:
    """Components of one shape, each somewhere and of its own scale.

    Attributes
    ----------
    weights : (M,) array
        They sum to 1.
    centres : (M, P) array
    factors : (M, P, P) array
        Lower triangular roots of their scale matrices.
    """

    weights: Floats
    centres: Floats
    factors: Floats

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return `count` draws (N, P)."""
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, self.centres.shape[1]))
        spread = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, size=count))
        drawn: Floats = self.centres[which] + spread[:, None] * np.einsum(
            "npq,nq->np", self.factors[which], normal
        )
        return drawn

    def log_density(self, at: Floats) -> Floats:
        """Return the log density (N,) at points (N, P)."""
        found: Floats = logsumexp(self._joint(at, self._distances(at)), axis=1)
        return found

    def _distances(self, at: Floats) -> Floats:
        """Return squared distances (N, M) from the centres in units of the scales."""
        away = at[None] - self.centres[:, None]  # (M, N, P)
        white = np.linalg.solve(self.factors, away.transpose(0, 2, 1))  # (M, P, N)
        squares: Floats = np.sum(white**2, axis=1).T
        return squares

    def _joint(self, at: Floats, squares: Floats) -> Floats:
        """Return log weight and density (N, M) of every component."""
        p = at.shape[1]
        norm = gammaln(0.5 * (FREEDOM + p)) - gammaln(0.5 * FREEDOM) - 0.5 * p * np.log(FREEDOM * np.pi)
        volume = np.sum(np.log(np.diagonal(self.factors, axis1=1, axis2=2)), axis=1)  # (M,)
        with np.errstate(divide="ignore"):
            own = np.log(self.weights) + norm - volume
        joint: Floats = own - 0.5 * (FREEDOM + p) * np.log1p(squares / FREEDOM)
        return joint

    def refitted(self, at: Floats, weights: Floats, least: Floats) -> "Mixture":
        """Return the mixture one step nearer to points (N, P) of `weights` (N,), which sum to 1.

        `least` (P, P) is added to every scale matrix; components that hardly any point belongs to go.
        """
        squares = self._distances(at)
        joint = self._joint(at, squares)
        belongs = weights[:, None] * np.exp(joint - logsumexp(joint, axis=1, keepdims=True))  # (N, M)
        p = at.shape[1]
        pulls = belongs * (FREEDOM + p) / (FREEDOM + squares)
        parts, count = belongs.sum(axis=0), belongs.sum(axis=0) ** 2 / np.sum(belongs**2, axis=0).clip(1e-300)
        kept = np.flatnonzero(count > p + 1)
        if not len(kept):
            return self
        centres = (pulls[:, kept].T @ at) / pulls[:, kept].sum(axis=0)[:, None]
        away = at[None] - centres[:, None]  # (M, N, P)
        scales = np.einsum("nm,mnp,mnq->mpq", pulls[:, kept], away, away) / parts[kept, None, None]
        return Mixture(parts[kept] / parts[kept].sum(), centres, np.linalg.cholesky(scales + least))
