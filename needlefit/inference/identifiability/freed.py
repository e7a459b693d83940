"""A fixed alpha made free, to show what the shapes say of it: hardly anything, and that is worth seeing."""

from collections.abc import Mapping
from dataclasses import replace

from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import Problem

ALPHA_RANGE = (-3.0, 5.0)
"""Where a fixed alpha is looked for once it is free: tissues and gels lie well within."""


def fixed_alphas(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Return the fixed alphas that some insertion meets; with each, those of the same material.

    Layers are of one material if their mu are the same parameter and their alphas are fixed at one value.
    """
    if problem.medium.law != "ogden":
        return {}  # other laws have none
    met = sorted({layer for insertion in problem.insertions for layer in insertion.sequence})
    groups: dict[tuple[tuple[float, str], float], list[str]] = {}
    for layer in range(1, problem.medium.layers + 1):
        alpha, mu, of = f"alpha{layer}", f"mu{layer}_pa", problem.parameters
        if alpha in of.fixed:
            groups.setdefault((of.ties.get(mu, (1.0, mu)), of.fixed[alpha]), []).append(alpha)
    return {
        first: tuple(same)
        for first, *same in groups.values()
        if any(f"alpha{layer}" in (first, *same) for layer in met)
    }


def freed(problem: Problem, name: str) -> Problem:
    """Return the problem with one alpha of `fixed_alphas` free, those of its material going with it."""
    return problem.with_parameters(_freed(problem.parameters, name, fixed_alphas(problem)[name]))


def _freed(parameters: Parameters, name: str, same: tuple[str, ...]) -> Parameters:
    at, (low, high) = parameters.fixed[name], ALPHA_RANGE
    bounds: Mapping[str, tuple[float, float]] = {name: (min(low, at), max(high, at))}
    return replace(
        parameters,
        bounds={**parameters.bounds, **bounds},
        fixed={other: value for other, value in parameters.fixed.items() if other not in (name, *same)},
        ties={**parameters.ties, **dict.fromkeys(same, (1.0, name))},
    )
