"""emcee: an ensemble of walkers (D. Foreman-Mackey et al., PASP 125 (2013) 306).

Most steps propose, for every walker, a draw of a fixed mixture of Student's t that is fitted to the draws by
importance (Metropolis-Hastings). Of emcee's own moves one independent draw costs several times as many
densities (`python benchmarks/sampling.py`); its stretch move takes the other steps, and frees walkers that
stand where the mixture is too thin.
"""

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.sampling.importance import LogDensityFunction, Proposal, WeightedDraws
from needlefit.inference.sampling.samplers import Sampler, Step

INDEPENDENT_SHARE = 0.9  #: share of the steps that are proposals of the mixture
#: number of fits to the draws by importance, from different beginnings, so that none follows their noise
FITS = 6
COMPONENTS = 8  #: number of components of each fit
#: share of the fits in the mixture; the rest is the wide one that the draws are of, so that no place is
#: proposed too rarely
FITTED_SHARE = 0.9


def walk(
    log_density: LogDensityFunction, start: Step, begin: WeightedDraws, rng: np.random.Generator
) -> Iterator[Step]:
    """Yield one step after another of an ensemble."""
    emcee = _load()
    walkers, dimensions = start[0].shape
    random = np.random.RandomState(int(rng.integers(2**32))).get_state()  # the kind that emcee takes
    assert begin.proposal is not None
    proposal = begin.proposal.add_fitted(begin, rng, COMPONENTS, FITTED_SHARE, FITS)
    moves = make_moves(proposal)
    sampler = emcee.EnsembleSampler(walkers, dimensions, log_density, moves=moves, vectorize=True)
    begun = emcee.State(*start, random_state=random)
    for state in sampler.sample(begun, iterations=sys.maxsize, skip_initial_state_check=True, store=False):
        yield state.coords.copy(), state.log_prob.copy()


def _load() -> Any:  # noqa: ANN401  (a module without types)
    """Return emcee: loaded late, and without scipy.stats (0.3 s), which is for a move that none takes."""
    modules: dict[str, Any] = sys.modules
    is_needed = modules.setdefault("scipy.stats", None) is not None
    import emcee

    if not is_needed:
        del modules["scipy.stats"]
    return emcee


def make_moves(proposal: Proposal) -> list[tuple[Any, float]]:
    """Return emcee's moves, each with its share of the steps."""
    moves = _load().moves

    def propose(coordinates: Floats, random: Any) -> tuple[Floats, Floats]:  # noqa: ANN401  (emcee's generator)
        proposed = proposal.draw(len(coordinates), random)
        return proposed, proposal.log_density(coordinates) - proposal.log_density(proposed)

    return [(moves.MHMove(propose), INDEPENDENT_SHARE), (moves.StretchMove(), 1 - INDEPENDENT_SHARE)]


EMCEE = Sampler("emcee", walk)
