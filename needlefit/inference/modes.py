"""Where a posterior is highest: a few searches, from the best of many draws of its prior."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.evaluator import Density, Evaluator
from needlefit.inference.goal import Weighed, posterior
from needlefit.inference.optimize.search import search
from needlefit.inference.starts import Place
from needlefit.project.records.recipe import RecipeRecord

Floats = NDArray[np.float64]

STARTS, EVALUATIONS = 3, 60
"""Searches, and the most that each may evaluate."""

APART = 0.15
"""Starts are as far from each other, in the unit cube of the bounds."""

SAME = 1e-3
"""Ends nearer to each other than this are one mode."""

PLAUSIBLE = 10.0
"""An end whose log density is this much below the best one's is none."""

NEGLIGIBLE = 1e-2
"""Change of the log density under which a search may end: the mode is where a proposal is put."""


class Searched(Density, Weighed, Protocol):
    """What can be searched and evaluated many at a time; `Problem` is one."""


@dataclass(frozen=True)
class _Cube:
    lower: Floats
    width: Floats

    def apart(self, one: Floats, others: list[Floats]) -> float:
        """Return how far a point is from the nearest of others; infinite without any."""
        return min((float(np.linalg.norm((one - o) / self.width)) for o in others), default=np.inf)


def modes(problem: Searched, recipe: RecipeRecord, candidates: Floats) -> Floats:
    """Return the modes (M, P) met by searches from the best of `candidates` (C, P), the best one first.

    The recipe says by which algorithm. Empty where no search found a point that can be solved.
    """
    cube = _Cube(problem.lower, problem.upper - problem.lower)
    goal = replace(posterior(problem), negligible=NEGLIGIBLE)
    hurried = recipe.model_copy(update={"evaluations": min(EVALUATIONS, recipe.evaluations)})
    known = Evaluator(problem, 1)(candidates)
    starts: list[Floats] = []
    for n in np.argsort(-known, kind="stable"):
        if len(starts) < STARTS and np.isfinite(known[n]) and cube.apart(candidates[n], starts) > APART:
            starts.append(candidates[n])
    found = [search(goal, hurried, Place(k, tuple(at.tolist()))) for k, at in enumerate(starts)]
    found = sorted((one for one in found if np.isfinite(one.objective)), key=lambda one: one.objective)
    ends: list[Floats] = []
    for one in found:
        end = np.array(one.theta)
        if one.objective < found[0].objective + PLAUSIBLE and cube.apart(end, ends) > SAME:
            ends.append(end)
    return np.array(ends).reshape(len(ends), len(cube.width))
