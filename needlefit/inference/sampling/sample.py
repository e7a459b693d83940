"""Sample the posterior with several independent ensembles until they converge, or the budget ends.

Walkers are laid out and moved in the coordinates of the Laplace approximation, in which the ridges of the
posterior are round. After every block of steps the run is kept, and the rule of `assess_convergence` asked:
what ends a run is counted in steps, never in time. Not counted is the burn-in, the first ten autocorrelation
times of the second half of the steps, but never more than the first half; nor what the ensembles learned
from.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, FitError
from needlefit.inference.evaluation_recorder import MAX_FAILED_POINTS
from needlefit.inference.fit import Callbacks
from needlefit.inference.sampling.convergence import (
    MIN_LENGTH_TAU,
    Convergence,
    assess_convergence,
    autocorrelation_times,
)
from needlefit.inference.sampling.ensembles import WalkerState, parse_moves, run_ensembles
from needlefit.inference.sampling.log_density import (
    Evaluator,
    LaplaceApproximation,
    LogDensity,
    approximate_by_laplace,
)
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.snapshots import Block, Failed, Snapshots
from needlefit.inference.sampling.walkers import (
    block_length,
    initialize_walkers,
    last_adaptation_step,
    make_proposal_densities,
)
from needlefit.schemas.limits import MAX_STORED_NUMBERS
from needlefit.schemas.recipe import SampleRecord

BURN_IN_TAU = 10.0
"""Autocorrelation times that are thrown away."""


def sample(
    problem: LogDensity,
    ends: Floats | Sequence[float],
    settings: SampleRecord,
    rng: np.random.Generator,
    callbacks: Callbacks | None = None,
    snapshots: Snapshots | None = None,
) -> Posterior:
    """Draw from the posterior with `settings.ensembles` independent ensembles.

    `ends` (P,) or (M, P) are points that a search ended at, the best first: the ensembles begin about them in
    turn, so that a second mode that the search found is not missed. The result does not depend on
    `callbacks.jobs`, nor on where a run was interrupted that resumes from its `snapshots`. A stop ends it
    after the present step.

    Raises
    ------
    ConfigError
        If nothing is free, a move is not known, or the walkers are fewer than twice the free parameters.
    FitError
        If no starting point of positive density is found, or the stop came before the second step.
    """
    _check_settings(problem, settings)
    callbacks, snapshots = callbacks or Callbacks(), snapshots or Snapshots()
    points = np.atleast_2d(np.asarray(ends, dtype=np.float64))
    evaluator = Evaluator(problem, callbacks.jobs)
    approximation = approximate_by_laplace(evaluator, points[0], problem.lower, problem.upper)
    task = _SamplingTask(problem, approximation, settings, callbacks)
    blocks = list(snapshots.blocks())
    state = blocks[-1].last if blocks else initialize_walkers(evaluator, approximation, points, settings, rng)
    while True:
        chain = _join_blocks(task, blocks)
        found = _assess_chain(task, chain)
        length = block_length(settings, chain.steps)
        if length <= 0 or (found is not None and not found.faults):
            return _make_posterior(task, chain, found, interrupted=False)
        block = None if callbacks.stop() else _run_block(task, state, chain, length)
        if block is None or block.steps < length:
            whole = _join_blocks(task, [*blocks, block] if block else blocks)
            return _make_posterior(task, whole, None, interrupted=True)
        snapshots.keep(len(blocks), block)
        blocks.append(block)
        state = block.last


@dataclass(frozen=True)
class _SamplingTask:
    problem: LogDensity
    approximation: LaplaceApproximation
    settings: SampleRecord
    callbacks: Callbacks


@dataclass(frozen=True)
class _Chain:
    """All steps so far: where (E, S, W, P), log densities (E, S, W), and what the blocks counted."""

    coordinates: Floats
    thetas: Floats
    log_density: Floats
    accepted: NDArray[np.int64]  # (E, W)
    failures: int
    failed: Failed

    @property
    def steps(self) -> int:
        return int(self.log_density.shape[1])


def _check_settings(problem: LogDensity, settings: SampleRecord) -> None:
    if not problem.names:
        raise ConfigError("nothing is free: there is no posterior to sample")
    parse_moves(settings.moves)
    # refused before any work: the whole chain is kept in memory
    stored = settings.ensembles * settings.walkers * settings.steps * len(problem.names)
    if stored > MAX_STORED_NUMBERS:
        raise ConfigError(
            f"ensembles x walkers x steps x free parameters is {stored}",
            where="recipe, key `sample.steps`",
            expected=f"at most {MAX_STORED_NUMBERS} numbers, which are kept in memory",
        )
    if settings.walkers < 2 * len(problem.names):
        raise ConfigError(
            f"{settings.walkers} walkers cannot explore {len(problem.names)} free parameters",
            where="recipe, key `sample.walkers`",
            expected=f"at least {2 * len(problem.names)}",
        )


def _run_block(task: _SamplingTask, state: WalkerState, chain: _Chain, length: int) -> Block:
    """Return the next `length` steps, fewer if a stop comes."""
    evaluator = Evaluator(task.problem, task.callbacks.jobs, task.settings.ensembles)

    def log_density(z: Floats) -> Floats:
        return evaluator(task.approximation.thetas(z))

    steps_done, known = [], make_proposal_densities(task.settings, chain.coordinates)
    for step in run_ensembles(log_density, state, task.settings.moves, known, length):
        steps_done.append(step)
        task.callbacks.step(chain.steps + len(steps_done), task.settings.steps)
        if task.callbacks.stop():
            break
    return Block(
        coordinates=np.stack([step.state.coordinates for step in steps_done], axis=1),
        log_density=np.stack([step.state.log_density for step in steps_done], axis=1),
        accepted=np.sum([step.accepted for step in steps_done], axis=0),
        random=steps_done[-1].state.random,
        failures=evaluator.failures,
        failed=tuple(tuple(thetas) for thetas in evaluator.failed),
    )


def _join_blocks(task: _SamplingTask, blocks: Sequence[Block]) -> _Chain:
    ensembles, walkers = task.settings.ensembles, task.settings.walkers
    nothing = np.empty((ensembles, 0, walkers, len(task.problem.names)))
    z = np.concatenate([nothing, *(block.coordinates for block in blocks)], axis=1)
    failed = [
        [theta for block in blocks for theta in block.failed[e]][:MAX_FAILED_POINTS] for e in range(ensembles)
    ]
    return _Chain(
        coordinates=z,
        thetas=task.approximation.thetas(z),
        log_density=np.concatenate([nothing[..., 0], *(block.log_density for block in blocks)], axis=1),
        accepted=sum((block.accepted for block in blocks), np.zeros((ensembles, walkers), dtype=np.int64)),
        failures=sum(block.failures for block in blocks),
        failed=tuple(tuple(thetas) for thetas in failed),
    )


def _find_burn_in(task: _SamplingTask, chain: _Chain) -> tuple[int, float]:
    """Return how many steps are burn-in, and the longest autocorrelation time of the late steps."""
    adapted, half = last_adaptation_step(task.settings, chain.steps), chain.steps // 2
    late = chain.thetas[:, max(adapted, half) :]
    if late.shape[1] < 2:
        return max(adapted, half), math.inf
    slowest = max(float(autocorrelation_times(late[..., k]).max()) for k in range(late.shape[3]))
    return max(adapted, half if BURN_IN_TAU * slowest >= half else math.ceil(BURN_IN_TAU * slowest)), slowest


def _assess_chain(task: _SamplingTask, chain: _Chain) -> Convergence | None:
    """Return what the rule looks at; None while the steps are too few for it, which is quickly seen."""
    first, slowest = _find_burn_in(task, chain)
    if not chain.steps - first > MIN_LENGTH_TAU * slowest:
        return None
    return assess_convergence(chain.thetas[:, first:], chain.log_density[:, first:], task.problem.names)


def _make_posterior(
    task: _SamplingTask, chain: _Chain, found: Convergence | None, interrupted: bool
) -> Posterior:
    if chain.steps < 2:
        raise FitError(f"the sampler was stopped after {chain.steps} steps: nothing to keep")
    first, names = _find_burn_in(task, chain)[0], task.problem.names
    if found is None:  # stopped just after a lesson: what there is
        first = min(first, chain.steps // 2)
    thetas, density = chain.thetas[:, first:], chain.log_density[:, first:]
    values = np.empty((thetas.size // len(names), len(names)))
    for n, theta in enumerate(thetas.reshape(-1, len(names))):  # one by one: a list of all takes gigabytes
        row = task.problem.values(theta)
        values[n] = [row[name] for name in names]
    ensembles = len(thetas)
    return Posterior(
        names=names,
        draws=values.reshape(ensembles, -1, len(names)),
        log_posterior=density.reshape(ensembles, -1),
        walkers=task.settings.walkers,
        moves=task.settings.moves,
        acceptance=np.mean(chain.accepted, axis=1) / chain.steps,
        convergence=found or assess_convergence(thetas, density, names),
        burn_in=first,
        failures=chain.failures,
        interrupted=interrupted,
        failed=chain.failed,
    )
