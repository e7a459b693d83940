"""Samplers of a posterior, of this package or of a plugin: ensembles of walkers that advance step by step.

`sampling/sample.py` starts them at draws by importance, checks their convergence, and stops them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.sampling.importance import LogDensityFunction, WeightedDraws
from needlefit.registry import Registry

Step = tuple[Floats, Floats]  #: where W walkers are, thetas (W, P), and their log densities (W,)


@dataclass(frozen=True)
class Sampler:
    """A sampler, as the key `sampler` of a recipe names it."""

    name: str
    #: log density, where the walkers begin, certified or not certified draws by importance with the proposal
    #: they are of, and random numbers -> one step after another; the caller ends it
    walk: Callable[[LogDensityFunction, Step, WeightedDraws, np.random.Generator], Iterator[Step]]


SAMPLERS = Registry(Sampler, __name__, "sampler")
