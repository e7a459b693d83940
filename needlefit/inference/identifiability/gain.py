"""What one more insertion is expected to tell, before it is made: nats, and the deviations that it leaves.

The gain of an insertion is the mutual information of parameters and data: the fall of entropy from what is
known now to what will be known, averaged over all data that may come (D. V. Lindley, Ann. Math. Stat. 27
(1956) 986). Nested Monte Carlo has it without linearising (K. J. Ryan, J. Comput. Graph. Stat. 12 (2003)
585): some draws of the posterior each give the data that they foretell, and all draws, of weights w_b that
sum to 1, are weighed anew by them,

    gain = mean_o [ log p(y_o | theta_o) - log sum_b w_b p(y_o | theta_b) ],      y_o ~ p(y | theta_o).

The new weights are the posterior after y_o, so deviations and gains of single quantities come with it. As
theta_o is among the b, what B draws can show is about log B at most.

Linearised at a draw the gain is 0.5 log det( I + Sigma J^T J ), with Sigma the covariance of all draws and J
the whitened Jacobian. That is exact where data depend linearly on Gaussian parameters, and too large where
what is known is a bent ridge, which one covariance makes too thick.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from needlefit.inference.likelihood.depths import Nodes
from needlefit.inference.likelihood.marginal import log_marginals

Floats = NDArray[np.float64]

LEAST = 1e-12
"""Part of a variance below which none falls, so that it stays positive in spite of rounding."""


@dataclass(frozen=True)
class Gain:
    """What data are expected to tell; quantities are functions of the parameters, or these themselves.

    Attributes
    ----------
    nats : float
        About all parameters together.
    nats_se : float
        Its standard error, of the outer draws.
    sds : (Q,) array
        Expected standard deviation of each quantity afterwards: the root of the mean variance.
    quantity_nats : (Q,) array
        About each quantity: the mean fall of the logarithm of its standard deviation, which for a Gaussian
        quantity is the fall of its entropy.
    worth : float
        Median over the data of how many draws the posterior afterwards stands on.
    """

    nats: float
    nats_se: float
    sds: Floats
    quantity_nats: Floats
    worth: float


@dataclass(frozen=True)
class Foreseen:
    """Draws of what is known now, and what one insertion would show if they were true.

    Attributes
    ----------
    log_weights : (B,) array
        The weights sum to 1.
    scales : (B,) array
        What each draw multiplies the deviations of noise and pose by.
    white : (B, m, R) array
        Whitened deflections at the m nodes of the insertion, from any origin.
    nodes : Nodes
    """

    log_weights: Floats
    scales: Floats
    white: Floats
    nodes: Nodes

    def log_likelihoods(self, of: NDArray[np.intp], rng: np.random.Generator) -> Floats:
        """Return the log likelihood (O, B) of every draw, given data that draws `of` (O,) foretell."""
        found = []
        for draw in of:
            turned = np.tensordot(self.nodes.linear, self.white[draw], axes=1)  # (1 + d, R)
            depths = rng.standard_normal(self.nodes.axes) @ turned[1:]
            data = turned[0] + depths + self.scales[draw] * rng.standard_normal(turned.shape[1])
            found.append(log_marginals(self.white - data, self.nodes, self.scales))
        return np.array(found)


def nested(seen: Foreseen, of: NDArray[np.intp], quantities: Floats, rng: np.random.Generator) -> Gain:
    """Return what an insertion tells of quantities (B, Q), over data that draws `of` (O,) foretell.

    `of` stand for the posterior: they are drawn by its weights.
    """
    likelihoods = seen.log_likelihoods(of, rng)  # (O, B)
    joint = likelihoods + seen.log_weights
    evidence = logsumexp(joint, axis=1)
    gains = likelihoods[np.arange(len(of)), of] - evidence
    after = np.exp(joint - evidence[:, None])  # (O, B)
    variances = _variances(after, quantities)  # (O, Q)
    before = _variances(np.exp(seen.log_weights)[None], quantities)
    return Gain(
        nats=float(gains.mean()),
        nats_se=float(gains.std(ddof=1) / np.sqrt(len(of))),
        sds=np.sqrt(variances.mean(axis=0)),
        quantity_nats=-0.5 * np.log(variances / before).mean(axis=0),
        worth=float(np.median(1 / np.sum(after**2, axis=1))),
    )


def _variances(weights: Floats, quantities: Floats) -> Floats:
    """Return the variances (O, Q) of quantities (B, Q) under weights (O, B)."""
    centred = quantities - quantities.mean(axis=0)
    spread = weights @ centred**2 - (weights @ centred) ** 2
    kept: Floats = np.maximum(spread, LEAST * centred.var(axis=0))
    return kept


def linear(covariance: Floats, slopes: Floats) -> float:
    """Return 0.5 log det( I + Sigma J^T J ) of a covariance (P, P) and whitened slopes J (R, P)."""
    root = np.linalg.cholesky(covariance + LEAST * np.diag(np.diag(covariance)))
    whole = np.eye(len(covariance)) + root.T @ slopes.T @ slopes @ root
    return 0.5 * float(np.linalg.slogdet(whole)[1])
