"""Move the walkers of several independent ensembles side by side, with emcee's moves or adapted proposals.

A proposal of an ensemble looks at walkers of that ensemble only. They take their steps side by side so that
the proposals of all are evaluated in one call, which costs no more than those of one ensemble.

Independent proposals are a mixture of Student's t, fitted to the points that an ensemble visited. A walker
that accepts one is independent of its last place, so a good fit mixes in a few steps. At first it is one
Student-t, the Laplace approximation's; later many narrow ones about visited points, and a wide one about all
of them, so that every place is proposed often enough.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky

from needlefit.arrays import Floats
from needlefit.errors import ConfigError

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

#: parts of the steps that moves get without a factor, in relation: emcee's authors advise 0.8 and 0.2
MOVE_WEIGHTS = {"stretch": 1.0, "de": 0.8, "snooker": 0.2, INDEPENDENT: 1.0}
#: length of a snooker step in differences of two others; ter Braak & Vrugt, Stat. Comput. 18 (2008) 435.
SNOOKER_LENGTH = 1.7
ENSEMBLE_PARTS = 2  #: parts of an ensemble that move in turn, each looking at the other

_MOVE = re.compile(r"\s*(?:(?P<factor>[^*\s]+)\s*\*\s*)?(?P<name>[a-z]+)\s*")


def parse_moves(moves: str) -> dict[str, float]:
    """Return the share of the steps of each move in `moves`: `"stretch"`, `"0.9*de+0.1*snooker"`.

    Raises ConfigError if a move is not known or its factor is not above 0.
    """
    found: dict[str, float] = {}
    for term in moves.split("+"):
        match, factor = _MOVE.fullmatch(term), math.nan
        if match is not None and match["name"] in MOVE_WEIGHTS and match["name"] not in found:
            with suppress(ValueError):
                factor = float(match["factor"] or MOVE_WEIGHTS[match["name"]])
        if match is None or not 0 < factor < np.inf:
            raise ConfigError(
                f"cannot move by `{moves}`",
                where="recipe, key `sample.moves`",
                expected=f"{', '.join(MOVE_WEIGHTS)}, or several: de+snooker, 0.9*de + 0.1*snooker",
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
    accepted: NDArray[np.bool_]


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

    accepted: NDArray[np.bool_]


@dataclass(frozen=True)
class _EnsembleMove:
    """A move in the form that emcee asks for, made in each ensemble by itself."""

    proposals: Sequence[Proposal]
    ensembles: int
    last_acceptance: _LastAcceptance

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:  # noqa: ANN401  (emcee has no types)
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

    if name == "snooker":
        return _propose_snooker
    if name == INDEPENDENT:  # wherever the walkers are

        def propose(own: Floats, _: Sequence[Floats], random: RandomState) -> tuple[Floats, Floats]:
            moved = proposal_density.draw(len(own), random)
            before, after = np.split(proposal_density.log_density(np.concatenate([own, moved])), 2)
            return moved, before - after

        return propose
    move = {"stretch": moves.StretchMove, "de": moves.DEMove}[name]()
    move.setup(np.empty((0, proposal_density.dimensions)))  # differential evolution scales with the dimension
    return move.get_proposal


def _propose_snooker(own: Floats, others: Sequence[Floats], random: RandomState) -> tuple[Floats, Floats]:
    """Propose a step along the line through one other walker, by the projected difference of two more.

    emcee 3.1.6 has this move too, but not with the target as its stationary distribution: it multiplies the
    step by the distance from the other walker, and corrects by half the exponent. Of a Gaussian in five
    dimensions it finds 0.7 of the variances.
    """
    pool = np.concatenate(list(others))
    # random keys, sorted: three different others for every walker
    three = np.argsort(random.uniform(size=(len(own), len(pool))), axis=1)[:, :3]
    at = pool[three]  # (N, 3, P)
    away = own - at[:, 0]
    distance = np.linalg.norm(away, axis=1)  # (N,)
    unit = away / distance[:, None]
    moved = own + SNOOKER_LENGTH * unit * np.sum(unit * (at[:, 1] - at[:, 2]), axis=1)[:, None]
    stretched = np.linalg.norm(moved - at[:, 0], axis=1) / distance
    # Jacobian of a move along a line through a fixed point: the volume grows by the stretch to the power P -
    # 1
    return moved, (own.shape[1] - 1) * np.log(stretched)
