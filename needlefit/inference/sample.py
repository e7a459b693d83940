"""The adapter around emcee: several independent ensembles, none of which ever sees a NaN.

Ensembles take their steps in turn, so a stop leaves them equally long. Each has its own stream: emcee's
legacy generator is seeded from the passed one.
"""

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError, FitError
from needlefit.inference.convergence import r_hat
from needlefit.inference.ledger import FAILURES, KEPT
from needlefit.inference.posterior import Posterior
from needlefit.inference.starts import Watch
from needlefit.project.records.recipe import SampleRecord

Floats = NDArray[np.float64]

SCATTER = 0.05
"""Walkers begin scattered about the best point, and ensembles about each other, by this part of the range."""

ATTEMPTS = 100
"""Redraws of a walker that begins where the density is 0, each time at half the scatter after ten."""


class Density(Protocol):
    """What can be sampled; `Problem` is one."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates of theta."""

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""

    def log_posteriors(self, thetas: Floats, jobs: int) -> Floats:
        """Return the log densities (W,) of `thetas` (W, P), not normalised.

        -inf where the density is 0, NaN where it cannot be computed. `jobs` threads may be used; the
        densities do not depend on it.
        """

    def values(self, theta: Floats) -> dict[str, float]:
        """Return what theta means, by name."""


def sample(
    problem: Density,
    best: Floats | tuple[float, ...],
    settings: SampleRecord,
    rng: np.random.Generator,
    watch: Watch | None = None,
) -> Posterior:
    """Draw from the posterior with `settings.ensembles` independent ensembles begun around `best` (P,).

    The result does not depend on `watch.jobs`. A stop ends after the step at hand and keeps what is there.

    Raises
    ------
    ConfigError
        If nothing is free, or the walkers are fewer than twice the free parameters.
    FitError
        If no starting point of positive density is found, or the stop came before the first kept step.
    """
    watch = Watch() if watch is None else watch
    _check(problem, settings)
    begin, count = np.asarray(best), settings.ensembles
    ensembles = [_begin(_Evaluator(problem, watch.jobs), begin, settings, rng) for _ in range(count)]
    done = _advance(ensembles, settings, watch)
    kept = done - settings.burn_in
    if kept < 1:
        raise FitError(
            f"the sampler was stopped after {done} of {settings.burn_in} steps of burn-in: nothing to keep"
        )
    return _collected(problem, ensembles, settings, kept)


@dataclass
class _Evaluator:
    """The density of many thetas at once; whatever is no number or fails is counted and has density 0."""

    problem: Density
    jobs: int
    failures: int = 0
    failed: list[tuple[float, ...]] = field(default_factory=list)

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (W,) of `thetas` (W, P)."""
        lower, upper = self.problem.lower, self.problem.upper
        inside = np.all((thetas >= lower) & (thetas <= upper), axis=1)
        density = np.full(len(thetas), -math.inf)
        if np.any(inside):
            found = self._guarded(thetas[inside])
            lost = np.isnan(found) | (found == math.inf)
            self.failures += int(np.sum(lost))
            self.failed += [tuple(theta) for theta in thetas[inside][lost].tolist()]
            del self.failed[KEPT:]
            density[inside] = np.where(lost, -math.inf, found)
        return density

    def _guarded(self, thetas: Floats) -> Floats:
        """Return the densities, NaN for a theta that raises: it is looked for one by one."""
        try:
            return self.problem.log_posteriors(thetas, self.jobs)
        except FAILURES:
            if len(thetas) == 1:
                return np.array([math.nan])
            return np.concatenate([self._guarded(theta[None]) for theta in thetas])


def _check(problem: Density, settings: SampleRecord) -> None:
    if not problem.names:
        raise ConfigError("nothing is free: there is no posterior to sample")
    if settings.walkers < 2 * len(problem.names):
        raise ConfigError(
            f"{settings.walkers} walkers cannot explore {len(problem.names)} free parameters",
            where="recipe, key `sample.walkers`",
            expected=f"at least {2 * len(problem.names)}",
        )


@dataclass(frozen=True)
class _Ensemble:
    evaluator: _Evaluator
    sampler: Any  # emcee.EnsembleSampler
    steps: Iterator[object]


def _begin(
    evaluator: _Evaluator, best: Floats, settings: SampleRecord, rng: np.random.Generator
) -> _Ensemble:
    """Return an ensemble whose walkers stand scattered about a point scattered about the best."""
    import emcee  # takes 0.7 s, which only a sampling run should pay

    start = _walkers(evaluator, best, settings.walkers, rng)
    sampler = emcee.EnsembleSampler(settings.walkers, len(best), evaluator, vectorize=True)
    legacy = np.random.RandomState(int(rng.integers(2**32)))  # all that emcee takes
    state = emcee.State(start, random_state=legacy.get_state())
    steps = sampler.sample(state, iterations=settings.burn_in + settings.steps)
    return _Ensemble(evaluator, sampler, iter(steps))


def _walkers(evaluator: _Evaluator, best: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return starting points (W, P) of positive density."""
    lower, span = evaluator.problem.lower, evaluator.problem.upper - evaluator.problem.lower
    inside = np.clip((best - lower) / span, 0.0, 1.0)
    centre = inside + SCATTER * rng.normal(size=len(best))
    found = np.empty((0, len(best)))
    for attempt in range(ATTEMPTS):
        shrink = 0.5 ** (attempt // 10)
        about = inside + shrink * (centre - inside)
        cube = about + shrink * SCATTER * rng.normal(size=(count, len(best)))
        folded = 1 - np.abs(1 - np.abs(cube) % 2)  # reflects at both ends of [0, 1]
        thetas = lower + folded * span
        found = np.concatenate([found, thetas[np.isfinite(evaluator(thetas))]])
        if len(found) >= count:
            return found[:count]
    raise FitError(
        "no starting points of positive density were found around the best fit",
        mend="tune with more evaluations, or widen the bounds",
    )


def _advance(ensembles: list[_Ensemble], settings: SampleRecord, watch: Watch) -> int:
    """Let the ensembles step in turn until done or stopped; return the steps each has done."""
    total = settings.burn_in + settings.steps
    for done in range(total):
        if watch.stop():
            return done
        for ensemble in ensembles:
            next(ensemble.steps)
        watch.step(done + 1, total)
    return total


def _collected(problem: Density, ensembles: list[_Ensemble], settings: SampleRecord, kept: int) -> Posterior:
    first, last = settings.burn_in, settings.burn_in + kept
    chains = np.stack([e.sampler.get_chain()[first:last] for e in ensembles])  # (E, S, W, P)
    density = np.stack([e.sampler.get_log_prob()[first:last] for e in ensembles])  # (E, S, W)
    count, dimensions = len(ensembles), len(problem.names)
    pooled = chains.reshape(count, -1, dimensions)
    rows = [problem.values(theta) for theta in pooled.reshape(-1, dimensions)]
    values = np.array([[row[name] for name in problem.names] for row in rows])
    accepted = [e.sampler.backend.accepted / last for e in ensembles]  # burn-in included
    return Posterior(
        names=problem.names,
        draws=values.reshape(pooled.shape),
        log_posterior=density.reshape(count, -1),
        walkers=settings.walkers,
        acceptance=np.array([float(np.mean(a)) for a in accepted]),
        autocorrelation_time=np.stack([_times(chain) for chain in chains]),
        r_hat=np.array([r_hat(pooled[:, :, k]) for k in range(dimensions)]),
        burn_in=settings.burn_in,
        failures=sum(e.evaluator.failures for e in ensembles),
        interrupted=kept < settings.steps,
        failed=tuple(tuple(e.evaluator.failed) for e in ensembles),
    )


def _times(chain: Floats) -> Floats:
    """Return the autocorrelation time (P,) of a chain (S, W, P), in steps."""
    from emcee.autocorr import integrated_time

    logger = logging.getLogger("emcee.autocorr")
    logger.addFilter(_silent)  # that the chain is short is said by Posterior.faults
    try:
        with np.errstate(invalid="ignore", divide="ignore"):
            times: Floats = integrated_time(chain, quiet=True)
    finally:
        logger.removeFilter(_silent)
    return times


def _silent(record: logging.LogRecord) -> bool:
    return False
