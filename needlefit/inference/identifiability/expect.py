"""What insertions can tell before any is made: Fisher information of a design, at several places.

The information is that of the model's own shapes, so no measured one decides. It changes along the ridge on
which parameters lie, and the truth is not known: besides the place asked for, it is taken at some more,
drawn from what the design would leave of the parameters there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.identifiability.identify import known_before, known_besides, told_by
from needlefit.inference.identifiability.information import Direction, cramer_rao, directions
from needlefit.inference.problem import Problem

Floats = NDArray[np.float64]
Design = Callable[[Mapping[str, float]], Problem | None]
"""Values (Pa, mm) -> the problem of insertions as these would shape them; None where one has no solution."""

DRAWS = 8
"""Places besides the one asked for."""

NEAR = 1.0
"""Standard deviation of the places along directions that the design leaves open: of logarithms, of alpha."""


@dataclass(frozen=True)
class Expectation:
    """Deviations that a design leads one to expect; coordinates are those of theta.

    Attributes
    ----------
    names : tuple of str
        P of them.
    sds : (D, P) array
        Cramer-Rao, bounds and stated prior included, at each place; the one asked for comes first.
    prior_sds : (P,) array
        What bounds and stated prior say alone.
    directions : tuple of Direction
        At the place asked for, best known first.
    direction_sds : (D, P) array
        Of the principal directions at each place, best known first.
    direction_prior_sds : (P,) array
        Of the prior along `directions`.
    """

    names: tuple[str, ...]
    sds: Floats
    prior_sds: Floats
    directions: tuple[Direction, ...]
    direction_sds: Floats
    direction_prior_sds: Floats


def expect(design: Design, values: Mapping[str, float], rng: np.random.Generator) -> Expectation | None:
    """Return what the design tells at `values` and at places near; None where it has no solution there."""
    problem = design(values)
    if problem is None:
        return None
    centre = np.clip(problem.parameters.theta(values), problem.lower, problem.upper)
    before = known_before(problem)
    first = information(problem, centre)
    others = [(design(at), at) for at in _places(problem, centre, first, rng)]
    every = [first, *(information(p, p.parameters.theta(at)) for p, at in others if p is not None)]
    every = [one for one in every if np.all(np.isfinite(one))]
    found = directions(first, problem.names)
    axes = np.array([d.weights for d in found]).reshape(-1, len(centre))
    spread = np.linalg.inv(before) if len(before) else before
    return Expectation(
        names=problem.names,
        sds=np.array([cramer_rao(one) for one in every]),
        prior_sds=np.sqrt(np.diag(spread)),
        directions=found,
        direction_sds=np.array([1 / np.sqrt(np.linalg.eigvalsh(one)[::-1]) for one in every]),
        direction_prior_sds=np.sqrt(np.einsum("dp,pq,dq->d", axes, spread, axes)),
    )


def information(problem: Problem, theta: Floats) -> Floats:
    """Return J^T J (P, P) of what insertions tell, with what is known besides: bounds, or a stated prior."""
    _, slope, _ = told_by(problem, theta)
    found: Floats = slope.T @ slope + known_besides(problem)
    return found


def _places(
    problem: Problem, centre: Floats, first: Floats, rng: np.random.Generator
) -> list[dict[str, float]]:
    """Return `DRAWS` places within the bounds, along the directions by what is expected to be known there."""
    precision, axes = np.linalg.eigh(first)
    sds = np.minimum(1 / np.sqrt(precision), NEAR)
    drawn = centre + rng.standard_normal((DRAWS, len(centre))) * sds @ axes.T
    return [problem.values(theta) for theta in np.clip(drawn, problem.lower, problem.upper)]
