"""Sample the posterior with several independent ensembles until they converge, or the budget ends.

Walkers are laid out, wider than the posterior, and moved in the coordinates of the Laplace approximation, in
which the ridges of the posterior are round. After every block of steps a snapshot is stored, from which a
killed run resumes to the same bytes, and the rule of `assess_convergence` asked: what ends a run is counted
in steps, never in time. Not counted is the burn-in, the first ten autocorrelation times of the second half of
the steps, but never more than the first half; nor what the ensembles learned from.

Proposals are adapted by each ensemble from its own steps alone, and only after a few fixed ones. Between
these it walks by fixed rules, which have the density as their stationary one; what was walked before the last
of them is burn-in. What an ensemble knows follows from the steps that are kept, so that a run that goes on
knows the same.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, FitError
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.identifiability.identify import select_within_tolerance
from needlefit.inference.objective import MAX_FAILED_POINTS
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.convergence import (
    MIN_LENGTH_TAU,
    Convergence,
    assess_convergence,
    autocorrelation_times,
)
from needlefit.inference.sampling.ensembles import (
    INDEPENDENT,
    ProposalDensity,
    WalkerState,
    fit_proposal,
    make_initial_proposal,
    parse_moves,
    run_ensembles,
)
from needlefit.inference.sampling.log_density import Evaluator, LaplaceApproximation, approximate_by_laplace
from needlefit.inference.sampling.posterior import Posterior, to_tuples
from needlefit.project.checkpoint import ARRAYS_KEY, NO_CHECKPOINT, Checkpoint
from needlefit.schemas.limits import MAX_STORED_NUMBERS
from needlefit.schemas.recipe import SampleRecord

Failed = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Block:
    """Some successive steps of all ensembles, as they are stored."""

    coordinates: Floats  #: (E, S, W, P)
    log_density: Floats  #: (E, S, W)
    accepted: NDArray[np.int64]  #: (E, W) how many proposals each walker took
    random: tuple[Any, ...]  #: state of the legacy generator after the last step
    failures: int  #: evaluations that were no number, or raised
    failed: Failed  #: by ensemble the first of these

    @property
    def steps(self) -> int:
        """Number of steps."""
        return int(self.log_density.shape[1])

    @property
    def last(self) -> WalkerState:
        """The state from which the next step starts."""
        return WalkerState(self.coordinates[:, -1], self.log_density[:, -1], self.random)


@dataclass(frozen=True)
class Snapshots:
    """The rows of a checkpoint with one block each of a run named `name`."""

    checkpoint: Checkpoint = NO_CHECKPOINT
    name: str = ""

    def blocks(self) -> Iterator[Block]:
        """Yield the stored blocks from the first on, up to one that is damaged.

        Those after it are of no use: they would go on from a state that is lost.
        """
        number = 0
        for row in self.checkpoint.rows(self._work, ("block", ARRAYS_KEY)):
            if row["block"] == number and (block := _read_block(row)) is not None:
                yield block
                number += 1

    def keep(self, number: int, block: Block) -> None:
        """Store a block."""
        # NumPy's legacy state: name, 624 words, position, has_gauss, cached_gaussian; only the words are an
        # array
        kind, key, *rest = block.random
        row = {"random": [kind, *rest], "failures": block.failures, "failed": block.failed}
        arrays = {name: getattr(block, name) for name in _ARRAYS}
        arrays["random"] = np.asarray(key, dtype=np.int64)
        self.checkpoint.keep_row(self._work, {"block": number, **row}, arrays)

    @property
    def _work(self) -> str:
        return f"posterior of {self.name}"


_ARRAYS = ("coordinates", "log_density", "accepted")


def _read_block(row: Mapping[str, Any]) -> Block | None:
    """Return the block in a row; None if it is no block, however whole."""
    arrays = row[ARRAYS_KEY]
    try:
        ensembles, steps, walkers, _ = arrays["coordinates"].shape
        shapes = (arrays["log_density"].shape, arrays["accepted"].shape)
        if not steps or shapes != ((ensembles, steps, walkers), (ensembles, walkers)):
            return None
        kind, *rest = row["random"]
        return Block(
            **{name: arrays[name] for name in _ARRAYS},
            random=(str(kind), arrays["random"].astype(np.uint32), *rest),
            failures=int(row["failures"]),
            failed=to_tuples(row["failed"]),
        )
    except (KeyError, TypeError, ValueError):
        return None


#: standard deviations of the Laplace approximation by which ensembles are scattered about their point, and
#: the walkers of each about its middle
ENSEMBLE_SCATTER_SD, WALKER_SCATTER_SD = 2.0, 1.0
#: no ensemble begins about a point whose log density is this much below the best point's
MAX_LOG_DENSITY_GAP = 10.0
#: redraws of walkers that begin where the density is 0, each time at half the scatter after ten
MAX_ATTEMPTS = 100


def initialize_walkers(
    evaluator: Evaluator,
    approximation: LaplaceApproximation,
    ends: Floats,
    settings: SampleRecord,
    rng: np.random.Generator,
) -> WalkerState:
    """Return the initial walkers: each ensemble about one of the points `ends` (M, P), the best first.

    Raises FitError if no starting point of positive density is found.
    """
    points = _select_plausible(evaluator, ends)
    legacy = np.random.RandomState(int(rng.integers(2**32)))  # all that emcee takes
    found = [
        _draw_walkers(evaluator, approximation, points[e % len(points)], settings.walkers, rng)
        for e in range(settings.ensembles)
    ]
    coordinates, density = (np.stack(part) for part in zip(*found, strict=True))
    return WalkerState(coordinates, density, tuple(legacy.get_state()))


def _select_plausible(evaluator: Callable[[Floats], Floats], ends: Floats) -> Floats:
    """Return the points (M, P) that are not far worse than the first one, which stays."""
    found = evaluator(ends)
    good = found >= found[0] - MAX_LOG_DENSITY_GAP
    good[0] = True
    return ends[good]


def _draw_walkers(
    evaluator: Evaluator,
    approximation: LaplaceApproximation,
    point: Floats,
    count: int,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return whitened starting points (W, P) of positive density, and its logarithm (W,)."""
    middle = ENSEMBLE_SCATTER_SD * rng.normal(size=len(point))
    chosen, known = np.empty((0, len(point))), np.empty(0)
    for attempt in range(MAX_ATTEMPTS):
        # the scatter is halved after every ten attempts without enough points
        shrink = 0.5 ** (attempt // 10)
        z = shrink * (middle + WALKER_SCATTER_SD * rng.normal(size=(count, len(point))))
        thetas = _reflect_at_bounds(
            point + z @ approximation.axes.T, evaluator.problem.lower, evaluator.problem.upper
        )
        density = evaluator(thetas)
        good = np.isfinite(density)
        chosen = np.concatenate([chosen, approximation.whitened(thetas[good])])
        known = np.concatenate([known, density[good]])
        if len(chosen) >= count:
            return chosen[:count], known[:count]
    raise FitError(
        "no starting points of positive density were found around the best fit",
        fix="tune with more evaluations, or widen the bounds",
    )


def _reflect_at_bounds(thetas: Floats, lower: Floats, upper: Floats) -> Floats:
    """Return thetas reflected at the bounds: cut off there, many would lie on one bound and span nothing."""
    # a triangle wave of period 2 in units of the range: reflection at both bounds, any number of times
    cube = np.abs((thetas - lower) / (upper - lower)) % 2
    return lower + (1 - np.abs(1 - cube)) * (upper - lower)


#: steps after which proposals are fitted anew, to the second half of them
ADAPTATION_STEPS = (50, 150, 500, 1200, 3000)


def list_adaptation_steps(settings: SampleRecord) -> tuple[int, ...]:
    """Return the steps after which proposals are adapted, each within the first half of the budget."""
    if INDEPENDENT not in parse_moves(settings.moves):
        return ()
    return tuple(step for step in ADAPTATION_STEPS if 2 * step <= settings.steps)


def last_adaptation_step(settings: SampleRecord, done: int) -> int:
    """Return the last of the first `done` steps after which proposals were adapted; 0 if there was none."""
    return max((step for step in list_adaptation_steps(settings) if step <= done), default=0)


def block_length(settings: SampleRecord, done: int) -> int:
    """Return the number of steps to the next snapshot; an adaptation or the budget ends a block."""
    adaptations = (step - done for step in list_adaptation_steps(settings) if step > done)
    return min(settings.check_interval, settings.steps - done, *adaptations)


def make_proposal_densities(settings: SampleRecord, coordinates: Floats) -> Sequence[ProposalDensity]:
    """Return the independent proposals of each ensemble after the steps (E, S, W, P)."""
    ensembles, done, _, dimensions = coordinates.shape
    last = last_adaptation_step(settings, done)
    if not last:
        return [make_initial_proposal(dimensions)] * ensembles
    return [fit_proposal(visited.reshape(-1, dimensions)) for visited in coordinates[:, last // 2 : last]]


BURN_IN_TAU = 10.0  #: autocorrelation times that are thrown away


def sample(
    problem: Problem,
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

    Raises ConfigError if nothing is free, a move is not known, or the walkers are fewer than twice the free
    parameters; FitError if no starting point of positive density is found, or the stop came before the second
    step.
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
        # convergence is not assessed while the steps are too few for it, which is quickly seen
        first, slowest = _find_burn_in(task, chain)
        found = None
        if chain.steps - first > MIN_LENGTH_TAU * slowest:
            late = chain.thetas[:, first:], chain.log_density[:, first:]
            found = assess_convergence(*late, problem.names)
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


def sample_from_fit(
    problem: Problem,
    fit: Fit,
    settings: SampleRecord,
    rng: np.random.Generator,
    callbacks: Callbacks,
    snapshots: Snapshots | None = None,
) -> Posterior | None:
    """Return the posterior from the ends of all equally good starts of a fit.

    None after a stop before there is anything to return.
    """
    ends = [fit.theta, *(start.theta for start in select_within_tolerance(fit) if start.theta != fit.theta)]
    try:
        return sample(problem, np.array(ends), settings, rng, callbacks, snapshots)
    except FitError:
        if callbacks.stop():
            return None
        raise


@dataclass(frozen=True)
class _SamplingTask:
    problem: Problem
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


def _check_settings(problem: Problem, settings: SampleRecord) -> None:
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
