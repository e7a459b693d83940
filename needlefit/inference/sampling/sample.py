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

Ensembles take their steps side by side, with emcee's moves or adapted proposals. A proposal of an ensemble
looks at walkers of that ensemble only; the proposals of all are evaluated in one call, which costs no more
than those of one ensemble. Independent proposals are a mixture of Student's t, fitted to the points that an
ensemble visited. A walker that accepts one is independent of its last place, so a good fit mixes in a few
steps. At first it is one Student-t, the Laplace approximation's; later many narrow ones about visited points,
and a wide one about all of them, so that every place is proposed often enough.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cholesky

from needlefit.arrays import Bools, Floats, Ints
from needlefit.errors import ConfigError, FitError
from needlefit.inference.fit import MAX_FAILED_POINTS, Callbacks, Fit
from needlefit.inference.identifiability.identify import select_within_tolerance
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.log_density import Evaluator, LaplaceApproximation, approximate_by_laplace
from needlefit.inference.sampling.posterior import (
    MIN_LENGTH_TAU,
    Convergence,
    Posterior,
    assess_convergence,
    autocorrelation_times,
    to_tuples,
)
from needlefit.project.checkpoint import ARRAYS_KEY, NO_CHECKPOINT, Checkpoint
from needlefit.schemas.limits import MAX_STORED_NUMBERS
from needlefit.schemas.recipe import SampleRecord

RandomState = np.random.RandomState

DEGREES_OF_FREEDOM = 5.0  #: degrees of freedom: tails heavier than those of most posteriors
MAX_CENTRES = 400  #: most points that a proposal density is fitted to
#: scale of the wide Student-t in standard deviations, and the part of the proposals drawn from it
WIDE_SCALE, WIDE_FRACTION = 1.5, 0.2
MIN_VARIANCE = 1e-8  #: added to the variances of whitened places: walkers that stood still have none


@dataclass(frozen=True)
class ProposalDensity:
    """A mixture of Student's t in P dimensions, all of one shape."""

    mean: Floats  #: (P,) middle of the wide one
    factor: Floats  #: (P, P) lower Cholesky factor of the covariance that gives them their shape
    centres: Floats  #: (K, P) middles of the narrow ones; none before anything is learned
    width: float  #: scale of the narrow ones

    @property
    def dimensions(self) -> int:
        """P: the number of dimensions."""
        return len(self.mean)

    def draw(self, count: int, random: RandomState) -> Floats:
        """Return `count` independent points (count, P)."""
        steps = random.normal(size=(count, self.dimensions)) @ self.factor.T
        spread = DEGREES_OF_FREEDOM / random.chisquare(DEGREES_OF_FREEDOM, size=count)
        steps = steps * np.sqrt(spread)[:, None]
        # drawn even if there are no centres: the random numbers used do not depend on what was learned
        wide, chosen = random.uniform(size=(2, count))
        found: Floats = self.mean + WIDE_SCALE * steps
        if len(self.centres):
            around_centres = self.centres[(chosen * len(self.centres)).astype(int)] + self.width * steps
            found = np.where(wide[:, None] < WIDE_FRACTION, found, around_centres)
        return found

    def log_density(self, points: Floats) -> Floats:
        """Return the logarithm (N,) of the density at points (N, P), up to a constant."""
        found = self._density(points, self.mean[None], WIDE_SCALE)
        if len(self.centres):
            found = WIDE_FRACTION * found + (1 - WIDE_FRACTION) * self._density(
                points, self.centres, self.width
            )
        return np.log(found)  # tails of powers: never 0

    def _density(self, points: Floats, about: Floats, scale: float) -> Floats:
        """Return the mean (N,) over the Student-t's about some places (K, P), but for a constant."""
        apart = (points @ self._whitening - (about @ self._whitening)[:, None]) / scale  # (K, N, P)
        squares = np.einsum("knp,knp->kn", apart, apart)
        powers = (1.0 + squares / DEGREES_OF_FREEDOM) ** (-0.5 * (DEGREES_OF_FREEDOM + self.dimensions))
        return powers.mean(axis=0) / scale**self.dimensions

    @cached_property
    def _whitening(self) -> Floats:
        """Whitening matrix (P, P) of the shape, applied from the right."""
        return np.asarray(np.linalg.inv(self.factor).T, dtype=np.float64)


def make_initial_proposal(dimensions: int) -> ProposalDensity:
    """Return the proposal before any adaptation: one Student's t in whitened coordinates."""
    return ProposalDensity(np.zeros(dimensions), np.eye(dimensions), np.empty((0, dimensions)), 1.0)


def fit_proposal(visited: Floats) -> ProposalDensity:
    """Fit a proposal density to points (N, P) where an ensemble has been.

    Scott's width; the places are drawn towards their mean so that the mixture of narrow ones is not wider for
    it (West, J. R. Stat. Soc. B 55 (1993) 409): the more dimensions, the more it is a single one.
    """
    chosen = visited[np.linspace(0, len(visited) - 1, min(MAX_CENTRES, len(visited))).round().astype(int)]
    count, dimensions = chosen.shape
    mean, width = visited.mean(axis=0), count ** (-1 / (dimensions + 4))
    covariance: Floats = np.atleast_2d(np.cov(visited.T)) + MIN_VARIANCE * np.eye(dimensions)
    factor = cholesky(covariance, lower=True)
    return ProposalDensity(mean, factor, mean + math.sqrt(1 - width**2) * (chosen - mean), width)


#: what walkers (N, P) propose by looking at parts of the others, and the logarithm (N,) of its correction
Proposal = Callable[[Floats, Sequence[Floats], RandomState], tuple[Floats, Floats]]

INDEPENDENT = "independent"

MOVES = ("stretch", "de", INDEPENDENT)
ENSEMBLE_PARTS = 2  #: parts of an ensemble that move in turn, each looking at the other

_MOVE = re.compile(r"\s*(?:(?P<factor>[^*\s]+)\s*\*\s*)?(?P<name>[a-z]+)\s*")


def parse_moves(moves: str) -> dict[str, float]:
    """Return the share of the steps of each move in `moves`: `"stretch"`, `"0.9*de+0.1*stretch"`.

    Raises ConfigError if a move is not known or its factor is not above 0.
    """
    found: dict[str, float] = {}
    for term in moves.split("+"):
        match, factor = _MOVE.fullmatch(term), math.nan
        if match is not None and match["name"] in MOVES and match["name"] not in found:
            with suppress(ValueError):
                factor = float(match["factor"] or 1.0)
        if match is None or not 0 < factor < np.inf:
            raise ConfigError(
                f"cannot move by `{moves}`",
                where="recipe, key `sample.moves`",
                expected=f"{', '.join(MOVES)}, or several: de+stretch, 0.9*de + 0.1*stretch",
            )
        found[match["name"]] = factor
    return {name: factor / sum(found.values()) for name, factor in found.items()}


@dataclass(frozen=True)
class WalkerState:
    """The positions of all walkers of E ensembles, and the state of the random generator."""

    coordinates: Floats  #: (E, W, P)
    log_density: Floats  #: (E, W)
    random: tuple[Any, ...]  #: state of the legacy generator, the one that emcee takes


@dataclass(frozen=True)
class EnsembleStep:
    """One step of all ensembles: the new state, and which walkers (E, W) accepted their proposal."""

    state: WalkerState
    accepted: Bools


def run_ensembles(
    log_density: Callable[[Floats], Floats],
    state: WalkerState,
    moves: str,
    proposal_densities: Sequence[ProposalDensity],
    count: int,
) -> Iterator[EnsembleStep]:
    """Yield `count` steps from `state`; `log_density` is called with (E * n, P) coordinates at once.

    These are ensemble by ensemble, n of each. The same state gives the same steps, however they are divided
    among calls. `proposal_densities` are what independent proposals are drawn from, one of each ensemble.
    """
    import emcee  # takes 0.7 s, which only a sampling run should pay

    ensembles, walkers, dimensions = state.coordinates.shape
    last_acceptance = _LastAcceptance(np.zeros((ensembles, walkers), dtype=bool))
    mixture = []
    for name, share in parse_moves(moves).items():
        proposals = [_make_proposal(name, one) for one in proposal_densities]
        mixture.append((_EnsembleMove(proposals, ensembles, last_acceptance), share))
    sampler = emcee.EnsembleSampler(
        ensembles * walkers, dimensions, log_density, vectorize=True, moves=mixture
    )
    begin = emcee.State(
        state.coordinates.reshape(-1, dimensions).copy(),
        log_prob=state.log_density.reshape(-1).copy(),
        random_state=state.random,
    )
    for now in sampler.sample(begin, iterations=count, store=False, skip_initial_state_check=True):
        coordinates = now.coords.reshape(state.coordinates.shape).copy()
        density = now.log_prob.reshape(state.log_density.shape).copy()
        yield EnsembleStep(WalkerState(coordinates, density, now.random_state), last_acceptance.accepted)


@dataclass
class _LastAcceptance:
    """Which walkers moved in the last step: emcee gives this only if it stores the whole chain."""

    accepted: Bools


@dataclass(frozen=True)
class _EnsembleMove:
    """A move in the form that emcee asks for, made in each ensemble by itself."""

    proposals: Sequence[Proposal]
    ensembles: int
    last_acceptance: _LastAcceptance

    def propose(self, model: Any, state: Any) -> tuple[Any, Bools]:  # noqa: ANN401  (emcee has no types)
        """Move all walkers once; `state` is changed in place and returned with who moved (E * W,)."""
        coordinates = state.coords.reshape(self.ensembles, -1, state.coords.shape[1])  # (E, W, P), a view
        # also a view: writing to it changes emcee's state
        density = state.log_prob.reshape(self.ensembles, -1)
        accepted = np.zeros(density.shape, dtype=bool)
        every = range(self.ensembles)
        order = np.array([model.random.permutation(density.shape[1]) for _ in every])  # (E, W)
        for part in range(ENSEMBLE_PARTS):
            own = order[:, part::ENSEMBLE_PARTS]  # (E, n)
            resting = [np.delete(order[e], np.s_[part::ENSEMBLE_PARTS]) for e in every]
            found = [
                self.proposals[e](coordinates[e, own[e]], [coordinates[e, resting[e]]], model.random)
                for e in every
            ]
            proposed = np.stack([one for one, _ in found])  # (E, n, P)
            factor = np.stack([one for _, one in found])  # (E, n)
            new, _ = model.compute_log_prob_fn(proposed.reshape(-1, proposed.shape[2]))
            new = new.reshape(factor.shape)
            # a column of ensemble numbers broadcasts against own (E, n): each ensemble indexes its own
            # walkers
            rows = np.arange(self.ensembles)[:, None]
            accepted_now = np.log(model.random.uniform(size=factor.shape)) < factor + new - density[rows, own]
            coordinates[rows, own] = np.where(accepted_now[..., None], proposed, coordinates[rows, own])
            density[rows, own] = np.where(accepted_now, new, density[rows, own])
            accepted[rows, own] = accepted_now
        self.last_acceptance.accepted = accepted
        return state, accepted.reshape(-1)


def _make_proposal(name: str, proposal_density: ProposalDensity) -> Proposal:
    from emcee import moves

    if name == INDEPENDENT:  # wherever the walkers are

        def propose(own: Floats, _: Sequence[Floats], random: RandomState) -> tuple[Floats, Floats]:
            moved = proposal_density.draw(len(own), random)
            before, after = np.split(proposal_density.log_density(np.concatenate([own, moved])), 2)
            return moved, before - after

        return propose
    move = {"stretch": moves.StretchMove, "de": moves.DEMove}[name]()
    move.setup(np.empty((0, proposal_density.dimensions)))  # differential evolution scales with the dimension
    return move.get_proposal


Failed = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True)
class Block:
    """Some successive steps of all ensembles, as they are stored."""

    coordinates: Floats  #: (E, S, W, P)
    log_density: Floats  #: (E, S, W)
    accepted: Ints  #: (E, W) how many proposals each walker took
    random: tuple[Any, ...]  #: state of the legacy generator after the last step
    failures: int  #: evaluations that were no number, or raised
    failed: Failed  #: by ensemble the first of these

    @property
    def steps(self) -> int:
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
    callbacks, snapshots = callbacks or Callbacks(), snapshots or Snapshots()
    points = np.atleast_2d(np.asarray(ends, dtype=np.float64))
    evaluator = Evaluator(problem, callbacks.jobs)
    approximation = approximate_by_laplace(evaluator, points[0], problem.lower, problem.upper)
    blocks = list(snapshots.blocks())
    state = blocks[-1].last if blocks else initialize_walkers(evaluator, approximation, points, settings, rng)
    while True:
        chain = _Chain(problem, approximation, settings, blocks)
        # convergence is not assessed while the steps are too few for it, which is quickly seen
        first, slowest = chain.find_burn_in()
        found = None
        if chain.steps - first > MIN_LENGTH_TAU * slowest:
            late = chain.thetas[:, first:], chain.log_density[:, first:]
            found = assess_convergence(*late, problem.names)
        # an adaptation or the budget ends a block
        adaptations = (step - chain.steps for step in list_adaptation_steps(settings) if step > chain.steps)
        length = min(settings.check_interval, settings.steps - chain.steps, *adaptations)
        if length <= 0 or (found is not None and not found.faults):
            return chain.make_posterior(found, interrupted=False)
        block = None if callbacks.stop() else chain.run_block(state, length, callbacks)
        if block is None or block.steps < length:
            whole = _Chain(problem, approximation, settings, [*blocks, block] if block else blocks)
            return whole.make_posterior(None, interrupted=True)
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


class _Chain:
    """All steps so far: where (E, S, W, P), log densities (E, S, W), and what the blocks counted."""

    def __init__(
        self,
        problem: Problem,
        approximation: LaplaceApproximation,
        settings: SampleRecord,
        blocks: Sequence[Block],
    ) -> None:
        self.problem, self.approximation, self.settings = problem, approximation, settings
        ensembles, walkers = settings.ensembles, settings.walkers
        nothing = np.empty((ensembles, 0, walkers, len(problem.names)))
        self.coordinates = np.concatenate([nothing, *(block.coordinates for block in blocks)], axis=1)
        self.thetas = approximation.thetas(self.coordinates)
        self.log_density = np.concatenate([nothing[..., 0], *(block.log_density for block in blocks)], axis=1)
        self.accepted = sum((block.accepted for block in blocks), np.zeros((ensembles, walkers), np.int64))
        self.failures = sum(block.failures for block in blocks)
        self.failed = tuple(
            tuple([theta for block in blocks for theta in block.failed[e]][:MAX_FAILED_POINTS])
            for e in range(ensembles)
        )
        self.steps = int(self.log_density.shape[1])

    def run_block(self, state: WalkerState, length: int, callbacks: Callbacks) -> Block:
        """Return the next `length` steps, fewer if a stop comes."""
        evaluator = Evaluator(self.problem, callbacks.jobs, self.settings.ensembles)

        def log_density(z: Floats) -> Floats:
            return evaluator(self.approximation.thetas(z))

        # the independent proposals of each ensemble
        ensembles, done, _, dimensions = self.coordinates.shape
        known = [make_initial_proposal(dimensions)] * ensembles
        if last := last_adaptation_step(self.settings, done):
            visited = self.coordinates[:, last // 2 : last]
            known = [fit_proposal(one.reshape(-1, dimensions)) for one in visited]
        steps_done = []
        for step in run_ensembles(log_density, state, self.settings.moves, known, length):
            steps_done.append(step)
            callbacks.step(self.steps + len(steps_done), self.settings.steps)
            if callbacks.stop():
                break
        return Block(
            coordinates=np.stack([step.state.coordinates for step in steps_done], axis=1),
            log_density=np.stack([step.state.log_density for step in steps_done], axis=1),
            accepted=np.sum([step.accepted for step in steps_done], axis=0),
            random=steps_done[-1].state.random,
            failures=evaluator.failures,
            failed=tuple(tuple(thetas) for thetas in evaluator.failed),
        )

    def find_burn_in(self) -> tuple[int, float]:
        """Return how many steps are burn-in, and the longest autocorrelation time of the late steps."""
        half = self.steps // 2
        adapted = last_adaptation_step(self.settings, self.steps)
        late = self.thetas[:, max(adapted, half) :]
        if late.shape[1] < 2:
            return max(adapted, half), math.inf
        slowest = max(float(autocorrelation_times(late[..., k]).max()) for k in range(late.shape[3]))
        burn_in = half if BURN_IN_TAU * slowest >= half else math.ceil(BURN_IN_TAU * slowest)
        return max(adapted, burn_in), slowest

    def make_posterior(self, found: Convergence | None, interrupted: bool) -> Posterior:
        """Return the posterior of the steps that are no burn-in."""
        if self.steps < 2:
            raise FitError(f"the sampler was stopped after {self.steps} steps: nothing to keep")
        first, names = self.find_burn_in()[0], self.problem.names
        if found is None:  # stopped just after a lesson: what there is
            first = min(first, self.steps // 2)
        thetas, density = self.thetas[:, first:], self.log_density[:, first:]
        values = np.empty((thetas.size // len(names), len(names)))
        for n, theta in enumerate(thetas.reshape(-1, len(names))):  # one by one: a list takes gigabytes
            row = self.problem.values(theta)
            values[n] = [row[name] for name in names]
        ensembles = len(thetas)
        return Posterior(
            names=names,
            draws=values.reshape(ensembles, -1, len(names)),
            log_posterior=density.reshape(ensembles, -1),
            walkers=self.settings.walkers,
            moves=self.settings.moves,
            acceptance=np.mean(self.accepted, axis=1) / self.steps,
            convergence=found or assess_convergence(thetas, density, names),
            burn_in=first,
            failures=self.failures,
            interrupted=interrupted,
            failed=self.failed,
        )
