"""Compute the expected information of insertions before they are made: nested Monte Carlo, or Fisher.

The gain of an insertion is the mutual information of parameters and data (D. V. Lindley, Ann. Math. Stat. 27
(1956) 986), by nested Monte Carlo (K. J. Ryan, J. Comput. Graph. Stat. 12 (2003) 585): some draws of the
posterior each give the data that they predict, and all draws, of weights w_b that sum to 1, are reweighted by
them,

    gain = mean_o [ log p(y_o | theta_o) - log sum_b w_b p(y_o | theta_b) ],      y_o ~ p(y | theta_o).

The new weights are the posterior after y_o, so deviations of single quantities come with it. As
theta_o is among the b, what B draws can show is about log B at most.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats, log_sum_exp
from needlefit.inference.identifiability.information import linearize, prior_and_noise_information
from needlefit.inference.likelihood.marginal import stack_residuals
from needlefit.inference.likelihood.nodes import NodeGroup
from needlefit.inference.problem import Problem

#: smallest fraction to which a variance falls, so that it stays positive in spite of rounding
MIN_RELATIVE_VARIANCE = 1e-12


@dataclass(frozen=True)
class ExpectedGain:
    """The expected information gain of one insertion, and what it would leave of single quantities."""

    nats: float  #: about all parameters together
    nats_se: float  #: its standard error, of the outer draws
    #: (Q,) expected standard deviation of each quantity afterwards: the root of the mean variance
    sds: Floats
    #: median over the data of the effective number of draws of the posterior afterwards
    effective_sample_size: float


@dataclass(frozen=True)
class PredictedData:
    """Draws of the present posterior, and the data of one insertion that each of them predicts."""

    log_weights: Floats  #: (B,) the weights sum to 1
    #: scales, spreads: (B,) what each draw multiplies the deviations of the noise by, and its relative bevel
    #: SD
    scales: Floats
    spreads: Floats
    white: Floats  #: (B, m, R) whitened deflections at the m nodes of the insertion, from any origin
    group: NodeGroup  #: of this insertion alone

    def log_likelihoods(self, outer_draws: NDArray[np.intp], rng: np.random.Generator) -> Floats:
        """Return the log likelihood (O, B) of every draw, of data predicted by draws `outer_draws` (O,)."""
        hyperparameters = self.scales, self.spreads
        # (B, R) and (B, D, R), both in standard deviations of each draw's own noise
        first, slopes = stack_residuals([self.white], self.group, *hyperparameters)
        stiff = np.eye(slopes.shape[1]) + slopes @ slopes.transpose(0, 2, 1)
        weights = np.linalg.solve(stiff, slopes)  # the same for all data
        _, log_det = np.linalg.slogdet(stiff)
        norm, logs = -first.shape[1] * np.log(self.scales) - 0.5 * log_det, []
        for draw in outer_draws:
            data = first[draw] + rng.standard_normal(slopes.shape[1]) @ slopes[draw]
            data = self.scales[draw] * (data + rng.standard_normal(len(data)))
            off = first - data / self.scales[:, None]
            explained = (slopes @ off[..., None]) * (weights @ off[..., None])
            logs.append(norm - 0.5 * (np.sum(off**2, axis=1) - explained.sum(axis=(1, 2))))
        return np.array(logs)


def nested_gain(
    predicted: PredictedData, outer_draws: NDArray[np.intp], quantities: Floats, rng: np.random.Generator
) -> ExpectedGain:
    """Return the expected gain about quantities (B, Q), averaged over data predicted by draws `outer_draws`
    (O,).

    `outer_draws` stand for the posterior: they are drawn by its weights.
    """
    # the numerator is the draw that made the data, the denominator the mean over all draws: log p(y|theta) -
    # log p(y)
    likelihoods = predicted.log_likelihoods(outer_draws, rng)  # (O, B)
    joint = likelihoods + predicted.log_weights
    evidence = log_sum_exp(joint, axis=1)
    gains = likelihoods[np.arange(len(outer_draws)), outer_draws] - evidence
    after = np.exp(joint - evidence[:, None])  # (O, B)
    centred = quantities - quantities.mean(axis=0)
    variances = after @ centred**2 - (after @ centred) ** 2  # (O, Q)
    variances = np.maximum(variances, MIN_RELATIVE_VARIANCE * centred.var(axis=0))
    return ExpectedGain(
        nats=float(gains.mean()),
        nats_se=float(gains.std(ddof=1) / np.sqrt(len(outer_draws))),
        sds=np.sqrt(variances.mean(axis=0)),
        effective_sample_size=float(np.median(1 / np.sum(after**2, axis=1))),
    )


def fisher_information(problem: Problem, theta: Floats) -> Floats:
    """Return the Fisher information (P, P) of insertions, plus that of the bounds or the stated prior."""
    slope = linearize(problem, theta).slope
    return slope.T @ slope + prior_and_noise_information(problem)
