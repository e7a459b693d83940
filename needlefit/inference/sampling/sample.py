"""Sample a posterior by an ensemble of walkers that starts from draws by importance, until it converges."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.draws import draw_from_prior
from needlefit.inference.fit import Callbacks
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem
from needlefit.inference.sampling import importance
from needlefit.inference.sampling.importance import Evaluator, LogDensityFunction
from needlefit.inference.sampling.interpolated_density import MAX_RMS_ERROR
from needlefit.inference.sampling.posterior import LOG_POSTERIOR, Posterior
from needlefit.inference.sampling.samplers import SAMPLERS, Step
from needlefit.schemas.recipe import SampleRecord

BLOCK_STEPS = 10  #: number of steps between two checks of convergence
CHECKED_DRAWS = 64  #: number of draws at which interpolated densities are checked in the end


def sample(
    problem: Problem,
    begin: importance.WeightedDraws,
    settings: SampleRecord,
    rng: np.random.Generator,
    callbacks: Callbacks | None = None,
) -> Posterior | None:
    """Return the posterior by an ensemble of walkers; None after a stop before the first step.

    Walkers start from draws by importance, none twice while these suffice. Where these are not certified, the
    first half of the steps is burn-in; else densities are interpolated as those of the draws were, and if
    that errs in the chain, it is made again without. The result does not depend on `callbacks.jobs`.

    Parameters that are held are independent draws of their prior.
    """
    posterior = _sample(problem.searched, begin, settings, rng, callbacks or Callbacks(), interpolated=True)
    return posterior and _add_held(posterior, problem.parameters, rng.spawn(1)[0])


def _add_held(posterior: Posterior, parameters: Parameters, rng: np.random.Generator) -> Posterior:
    """Return a posterior of the searched parameters as one of all free ones."""
    if not parameters.held:
        return posterior
    drawn = draw_from_prior(parameters, posterior.log_posterior.size, rng)
    table = dict(zip(parameters.free, drawn.T, strict=True))
    columns = {name: table[name].reshape(posterior.log_posterior.shape) for name in parameters.held}
    columns |= dict(zip(posterior.names, np.moveaxis(posterior.draws, 2, 0), strict=True))

    def extend(estimates: Floats, of_held: float) -> Floats:
        """Return one of each free parameter, and of the density where `estimates` end with that."""
        named = dict(zip((*posterior.names, LOG_POSTERIOR), estimates, strict=False))
        named |= dict.fromkeys(parameters.held, of_held)
        return np.array([named[name] for name in (*parameters.free, LOG_POSTERIOR) if name in named])

    # those held are independent by construction, not as far as an estimate knows
    return replace(
        posterior,
        names=parameters.free,
        draws=np.stack([columns[name] for name in parameters.free], axis=2),
        r_hat=extend(posterior.r_hat, 1.0),
        autocorrelation_time=extend(posterior.autocorrelation_time, 1.0),
        apart=extend(posterior.apart, 0.0),
    )


def _sample(
    problem: Problem,
    begin: importance.WeightedDraws,
    settings: SampleRecord,
    rng: np.random.Generator,
    callbacks: Callbacks,
    *,
    interpolated: bool,
) -> Posterior | None:
    """Return the posterior of a problem of which no parameter is held, as `sample` does."""
    nodes = begin.interpolated if interpolated and begin.certified else None
    if nodes is not None:
        nodes.fixed = True
    evaluator = Evaluator(problem, callbacks.jobs, interpolated=nodes)
    posterior = sample_density(evaluator, problem.names, begin, settings, rng, callbacks)
    if posterior is not None and nodes is not None:
        thetas = posterior.draws.reshape(-1, len(problem.names))
        if nodes.find_error(thetas[:: -(-len(thetas) // CHECKED_DRAWS)]) > MAX_RMS_ERROR:
            return _sample(problem, begin, settings, rng, callbacks, interpolated=False)
    return posterior and replace(
        posterior, draws=problem.tabulate_values(posterior.draws), failures=evaluator.failures
    )


def sample_density(
    log_density: LogDensityFunction,
    names: tuple[str, ...],
    begin: importance.WeightedDraws,
    settings: SampleRecord,
    rng: np.random.Generator,
    callbacks: Callbacks,
) -> Posterior | None:
    """Return draws of a density of P quantities with these `names`, as `sample` does those of a posterior.

    Its `draws` are the coordinates of the density.
    """
    walkers = max(settings.walkers, 2 * len(names))
    most = max(1, settings.densities // walkers)
    # the largest of weights times Gumbel's noise: drawn in turn by weight
    order = np.argsort(-(begin.log_weights + rng.gumbel(size=len(begin.thetas))), kind="stable")
    order = np.resize(order[np.isfinite(begin.log_weights[order])], walkers)  # repeated where there are fewer
    steps = [(begin.thetas[order], begin.log_density[order])]  # the first is where they begin
    walk = SAMPLERS[settings.sampler].walk(log_density, steps[0], begin, rng)
    stopped, posterior = callbacks.stop(), None
    while not (stopped or len(steps) > most or (posterior is not None and not posterior.faults)):
        for step in islice(walk, min(BLOCK_STEPS, most + 1 - len(steps))):
            steps.append(step)
            callbacks.step(len(steps) - 1, most)
            if stopped := callbacks.stop():
                break
        posterior = replace(_summarize(steps, names, begin, settings), interrupted=stopped)
        posterior = replace(posterior, apart=compare_means(posterior, begin))
    return posterior


def _summarize(
    steps: Sequence[Step], names: tuple[str, ...], begin: importance.WeightedDraws, settings: SampleRecord
) -> Posterior:
    """Return the draws of a chain, by steps from where its walkers began, with what shows its convergence."""
    walked, density = (np.array(part) for part in zip(*steps, strict=True))  # (N + 1, W, P), (N + 1, W)
    moved = np.any(walked[1:] != walked[:-1], axis=2)
    burn_in = 0 if begin.certified else (len(steps) - 1) // 2
    chain, density = walked[1 + burn_in :], density[1 + burn_in :]
    quantities = [*np.moveaxis(chain, 2, 0), density]  # each (N, W)
    return Posterior(
        names=names,
        draws=chain.transpose(1, 0, 2),
        log_posterior=density.T,
        acceptance_fraction=moved.mean(axis=0),
        r_hat=np.array([compute_r_hat(quantity) for quantity in quantities]),
        autocorrelation_time=np.array([compute_autocorrelation_time(quantity) for quantity in quantities]),
        wanted=settings.independent_draws,
        burn_in=burn_in,
        failures=0,
        sampler=settings.sampler,
    )


def compute_autocorrelation_time(values: Floats) -> float:
    """Return the integrated autocorrelation time, in steps, of one quantity (N, W); infinite if it rests.

    The walkers are joined to one series. Of each walker by itself emcee takes off its own mean, which hides
    that it never leaves its place, and in short chains most of the correlation. Equal draws count as one at
    most: walkers that begin alike and hardly move look independent to a series.
    """
    from emcee.autocorr import integrated_time

    if np.ptp(values) == 0:
        return math.inf
    # anticorrelated draws do not count as more than independent ones: the estimate may be noise
    return max(values.size / len(np.unique(values)), float(integrated_time(values.T.ravel(), tol=0)[0]))


def compare_means(chains: Posterior, begin: importance.WeightedDraws) -> Floats:
    """Return how far the means (P,) of chains lie from those of weighted draws, in standard errors.

    Without certified draws there is nothing to compare them with: 0.
    """
    flat, weights = chains.draws.reshape(-1, len(chains.names)), np.exp(begin.log_weights)
    if not begin.certified:
        return np.zeros(len(chains.names))
    mean = weights @ begin.thetas
    variance = weights @ (begin.thetas - mean) ** 2
    ess, begin_ess = chains.ess[:-1], begin.effective_sample_size
    return np.abs(flat.mean(axis=0) - mean) * np.sqrt(ess * begin_ess / (ess + begin_ess) / variance)


def compute_r_hat(values: Floats) -> float:
    """Return R-hat of one quantity (N, W) over both halves of the ensemble, each halved in time.

    With B the variance of their means and W their mean variance, of n draws each,
    sqrt((n - 1) / n + B / W) (A. Gelman, D. B. Rubin, Stat. Sci. 7 (1992) 457).
    """
    half = len(values) // 2
    if half < 2:
        return math.inf
    parts = np.array([part[:, k::2].ravel() for part in (values[:half], values[-half:]) for k in (0, 1)])
    between, within = parts.mean(axis=1).var(ddof=1), parts.var(axis=1, ddof=1).mean()
    return math.sqrt(1 - 1 / parts.shape[1] + between / within) if within else math.inf
