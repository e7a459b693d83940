"""Diagnose the convergence of independent ensembles: R-hat, autocorrelation times, effective sample sizes.

A chain is one ensemble: its draws are pooled over walkers step by step, and split in time. R-hat compares
these halves; the autocorrelation time says how many steps of an ensemble count for one, so that S steps of
W walkers are worth S W / tau draws. Both use normal scores of the ranks, so that heavy tails and the scale
do not matter, and are computed for every parameter, of the principal directions of the draws' covariance (the
inverse of the posterior's information: stiff and sloppy ones), and of the log posterior.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import ndtri

from needlefit.arrays import Floats

#: the rule: R-hat below, at least this many autocorrelation times long, and more independent draws than this
#: in the bulk and in the tails of every ensemble
MAX_R_HAT, MIN_LENGTH_TAU, MIN_ESS = 1.01, 50, 400
MIN_ENSEMBLES = 4  #: fewest ensembles whose agreement means something
TAIL_QUANTILES = (0.05, 0.95)  #: quantiles whose indicators tell how well the tails are known
#: autocorrelations are summed up to this many autocorrelation times (Sokal): beyond is noise
WINDOW_TAU = 5.0


@dataclass(frozen=True)
class Convergence:
    """Convergence diagnostics of Q quantities and E ensembles of S steps."""

    quantities: tuple[str, ...]  #: parameters, "direction 1" (the stiffest) and on, "log posterior"
    r_hat: Floats  #: (Q,) naN with fewer than two ensembles
    tau: Floats  #: (E, Q) autocorrelation time in steps; infinite where all walkers stand still
    #: ess_bulk, ess_tail: (E, Q) independent draws, of the value and of the worse of the two tails
    ess_bulk: Floats
    ess_tail: Floats
    steps: int  #: of each ensemble

    @property
    def faults(self) -> tuple[str, ...]:
        """Which parts of the rule are not met; empty if all are."""
        found = []
        if len(self.tau) < MIN_ENSEMBLES:
            count = f"{len(self.tau)} independent ensembles, not {MIN_ENSEMBLES}"
            found.append(f"{count}: too few to show that they agree")
        if len(self.tau) > 1 and not np.all(self.r_hat < MAX_R_HAT):
            at = int(np.argmax(np.nan_to_num(self.r_hat, nan=np.inf)))
            found.append(f"R-hat of {self.quantities[at]} is {self.r_hat[at]:.3g}, not below {MAX_R_HAT}")
        longest = self.tau.max(axis=0)
        if not self.steps > MIN_LENGTH_TAU * longest.max():
            at = int(np.argmax(longest))
            times = f"{MIN_LENGTH_TAU} autocorrelation times of {longest[at]:.3g}"
            found.append(f"{self.steps} steps are not more than {times} ({self.quantities[at]})")
        for where, draws in (("", self.ess_bulk), (" in a tail", self.ess_tail)):
            fewest = draws.min(axis=0)
            if not fewest.min() > MIN_ESS:
                at = int(np.argmin(fewest))
                has = f"an ensemble has {fewest[at]:.0f} independent draws{where} of {self.quantities[at]}"
                found.append(f"{has}, not more than {MIN_ESS}")
        return tuple(found)


def assess_convergence(thetas: Floats, log_density: Floats, names: Sequence[str]) -> Convergence:
    """Return the convergence diagnostics of all quantities, given draws (E, S, W, P) of P `names`."""
    # principal coordinates of the draws' covariance, stiffest first: eigh sorts ascending variances
    _, axes = np.linalg.eigh(np.atleast_2d(np.cov(thetas.reshape(-1, thetas.shape[-1]).T)))  # (P, P)
    along = thetas @ axes
    directions = [f"direction {k + 1}" for k in range(along.shape[-1])]
    columns = np.concatenate([thetas, along, log_density[..., None]], axis=3)  # (E, S, W, Q)
    r_hats, taus, tails = [], [], []
    for values in np.moveaxis(columns, 3, 0):
        scores, folded = _normal_scores(values), _folded_scores(values)
        pooled = (values.shape[0], -1)  # step by step
        slower = [
            autocorrelation_times((values <= q).astype(np.float64))
            for q in np.quantile(values, TAIL_QUANTILES)
        ]
        r_hats.append(_r_hat(scores.reshape(pooled), folded.reshape(pooled)))
        taus.append(autocorrelation_times(scores))
        tails.append(np.maximum(*slower))
    size, tau = thetas.shape[1] * thetas.shape[2], np.stack(taus, axis=1)
    return Convergence(
        quantities=(*names, *directions, "log posterior"),
        r_hat=np.array(r_hats),
        tau=tau,
        ess_bulk=size / tau,
        ess_tail=size / np.stack(tails, axis=1),
        steps=int(thetas.shape[1]),
    )


def r_hat(chains: Floats) -> float:
    """Return R-hat of one quantity over chains (E, N); NaN with fewer than two chains or four draws.

    All draws are replaced by normal scores of their ranks, every chain is cut in halves, and with B the
    variance between and W the mean variance within halves of length n

        R-hat = sqrt( ((n - 1) W / n + B) / W ),    B = var(means of the halves).

    The larger of two values counts: of the draws, and of their distances from the median (which sees
    chains that differ in width alone). Vehtari et al., Bayesian Analysis 16 (2021) 667.
    """
    return _r_hat(_normal_scores(chains), _folded_scores(chains))


def _r_hat(scores: Floats, folded: Floats) -> float:
    """Return the larger R-hat of two kinds of scores (E, N)."""
    if len(scores) < 2 or scores.shape[1] < 4:
        return float("nan")
    return max(_split_r_hat(scores), _split_r_hat(folded))


def autocorrelation_times(series: Floats) -> Floats:
    """Return the integrated autocorrelation time (E,), in steps, of series (E, S, W) of E ensembles.

    tau = 1 + 2 sum_t rho(t), summed up to the first t >= 5 tau(t). rho is the mean over an ensemble's
    walkers of each one's autocorrelation (Goodman & Weare, Comm. App. Math. Comp. Sci. 5 (2010) 65, take that
    of the walkers' mean, which is the same where walkers are independent, and noisier). Unlike emcee's, it is
    taken about the mean of the whole ensemble: a walker that stays apart from the others counts as slow.
    """
    steps, found = series.shape[1], []
    # padded to twice the length: the FFT's correlation is circular
    size = next_fast_len(2 * steps, real=True)
    for one in series:
        spectrum = rfft(one - one.mean(), n=size, axis=0)
        covariance = irfft(np.mean(np.abs(spectrum) ** 2, axis=1), n=size)[:steps]  # (S,)
        if not covariance[0] > 0.0:
            found.append(math.inf)
            continue
        times = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
        ends = np.flatnonzero(np.arange(steps) >= WINDOW_TAU * times)
        # anticorrelated draws do not count as more than independent ones: the estimate may be noise
        found.append(max(1.0, float(times[ends[0] if len(ends) else -1])))
    return np.array(found)


def _normal_scores(draws: Floats) -> Floats:
    from scipy.stats import rankdata  # late: it takes 0.2 s to load

    ranks = rankdata(draws, axis=None).reshape(draws.shape)
    # Blom's offsets 3/8 and 1/4, as in Vehtari et al.
    return ndtri((ranks - 0.375) / (draws.size + 0.25))


def _folded_scores(draws: Floats) -> Floats:
    return _normal_scores(np.abs(draws - np.median(draws)))


def _split_r_hat(chains: Floats) -> float:
    """Return R-hat of the halves of chains (E, N), as they are."""
    n = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :n], chains[:, -n:]])  # (2 E, n)
    within = float(np.mean(np.var(halves, axis=1, ddof=1)))
    between = float(np.var(np.mean(halves, axis=1), ddof=1))
    # walkers that never moved: equal halves agree, others disagree without bound
    if within == 0.0:
        return 1.0 if between == 0.0 else float("inf")
    return float(np.sqrt(((n - 1) / n * within + between) / within))
