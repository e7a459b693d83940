"""Compute the profile likelihoods of a fit's free parameters, and of shape parameters that it held fixed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.gauss_newton import LocalMinimum, minimize_squares
from needlefit.inference.identifiability.identify import tip_range
from needlefit.inference.identifiability.precision import add_estimated_noise, linearize
from needlefit.inference.identifiability.profile import LikelihoodProfile, compute_profile
from needlefit.inference.parameters import without_prior
from needlefit.inference.problem import Problem
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.inference.ties import dimension
from needlefit.mechanics.laws import LAWS
from needlefit.project.progress import Stop, never_stop
from needlefit.project.tasks import THIS_PROCESS, TaskPool, TaskStop


def find_fixed_shape(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Return the fixed shape parameters that some insertion meets, each with the others of its material.

    Layers are of one material if their mu are tied, exactly or with a spread, and the parameter is fixed at
    one value in them.
    """
    met = {layer for insertion in problem.insertions for layer in insertion.sequence}
    tied, parameters = without_prior(problem.parameters).ties, problem.parameters
    every = range(1, problem.medium.layers + 1)
    found: dict[str, tuple[str, ...]] = {}
    for row in LAWS[problem.medium.law].name_shape(every):
        groups: dict[tuple[tuple[float, str], float], dict[int, str]] = {}
        for layer, name in zip(every, row, strict=True):
            mu = f"mu{layer}_pa"
            if name in parameters.fixed:
                material = tied.get(mu, (1.0, mu)), parameters.fixed[name]
                groups.setdefault(material, {})[layer] = name
        for group in groups.values():
            if met & group.keys():
                first, *same = group.values()
                found[first] = tuple(same)
    return found


def free_shape(problem: Problem, name: str) -> Problem:
    """Return the problem with one parameter of `find_fixed_shape` free, the others of its material tied."""
    same, parameters = find_fixed_shape(problem)[name], problem.parameters
    (low, high), at = find_usual_bounds(problem.medium.law, name), parameters.fixed[name]
    # the value that the fit used must lie within the bounds, whatever it was
    bounds: Mapping[str, tuple[float, float]] = {name: (min(low, at), max(high, at))}
    return problem.with_parameters(
        replace(
            parameters,
            bounds={**parameters.bounds, **bounds},
            fixed={other: value for other, value in parameters.fixed.items() if other not in (name, *same)},
            ties={**parameters.ties, **dict.fromkeys(same, (1.0, name))},
        )
    )


def find_usual_bounds(law: str, name: str) -> tuple[float, float]:
    """Return the usual bounds of a law's shape parameter in one layer, such as `alpha2`."""
    return next(one.usual for one in LAWS[law].parameters if one.name == dimension(name))


MAX_OTHER_STARTS = 2
"""Most ends of other starts from which profiles are tried again, beside the middle of the bounds."""

MIN_SEPARATION = 0.05
"""Ends closer than this part of the bounds, in every parameter, are one place."""


@dataclass(frozen=True)
class ParameterProfile:
    """The profile of one parameter; for a fixed shape parameter also the range of the tip.

    Attributes
    ----------
    bounds : tuple of two floats
        In the parameter's coordinate of theta.
    fixed_at : float or None
        Its value in the fit, where it was fixed there and freed for this.
    same : tuple of str
        Other parameters that went with it.
    tip_range_mm : float or None
        How far the tip moves most while it goes through its bounds, the others held, mm.
    """

    profile: LikelihoodProfile
    bounds: tuple[float, float]
    fixed_at: float | None = None
    same: tuple[str, ...] = ()
    tip_range_mm: float | None = None

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.profile.name


@dataclass(frozen=True)
class FitProfiles:
    """The profiles of all parameters of one fit.

    Attributes
    ----------
    parameters : tuple of ParameterProfile
        Free ones in the order of theta, then fixed shape parameters.
    scale : float
        What deviances were divided by: the reduced chi-square where it is above 1.
    evaluations : int
        Jacobians computed, those that led to the optimum included.
    gain : float
        How much higher than at the fit the log posterior is at the best point met on the way.
    best : tuple of float
        Theta of that point.
    """

    parameters: tuple[ParameterProfile, ...]
    scale: float
    evaluations: int
    gain: float
    best: tuple[float, ...]


def profile_parameters(
    problem: Problem, fit: Fit, jobs: int = 1, stop: Stop = never_stop, pool: TaskPool = THIS_PROCESS
) -> FitProfiles:
    """Compute the profiles about a fit; the result depends neither on the number of threads nor on the pool.

    Where the dataset states no noise, the fit's residuals stand for it. `stop` leaves out what has not begun.
    """
    noisy = add_estimated_noise(problem, np.array(fit.theta))
    ends = _select_separate(
        noisy, [fit.theta, *(s.theta for s in sorted(fit.starts, key=lambda s: s.objective))]
    )
    descend, never = partial(minimize_squares, noisy), TaskStop(never_stop)
    minima = [one for _, one in sorted(run_side_by_side(descend, ends, THIS_PROCESS, jobs, never))]
    optimum = min(minima, key=lambda one: one.value)
    elsewhere = [*ends[1:], 0.5 * (noisy.lower + noisy.upper)]
    scale = max(1.0, linearize(noisy, optimum.theta)[2])

    parts: list[str | int] = [*range(len(noisy.names)), *find_fixed_shape(noisy)]
    work = partial(_profile_one, noisy, optimum, elsewhere, scale)
    every = dict(run_side_by_side(work, parts, pool, jobs, TaskStop(stop)))
    found = tuple(every[n] for n in sorted(every))
    spent = sum(one.evaluations for one in minima) + sum(one.profile.evaluations for one in found)
    at_fit = noisy.residuals(np.array(fit.theta))
    # residuals are those of the posterior: of a metric fit their gain means nothing
    gain = 0.5 * (float(at_fit @ at_fit) - optimum.value) if fit.minimized == "posterior" else 0.0
    return FitProfiles(found, scale, spent, gain, tuple(optimum.theta.tolist()))


def _profile_one(
    problem: Problem, optimum: LocalMinimum, elsewhere: Sequence[Floats], scale: float, part: str | int
) -> ParameterProfile:
    """Return the profile of a free parameter, by its number, or of a fixed shape parameter, by its name."""
    if isinstance(part, str):
        return _profile_fixed(problem, part, optimum, scale)
    return _profile_free(problem, part, optimum, elsewhere, scale)


def _profile_free(
    problem: Problem, k: int, optimum: LocalMinimum, elsewhere: Sequence[Floats], scale: float
) -> ParameterProfile:
    found = compute_profile(problem, k, optimum, elsewhere, scale)
    return ParameterProfile(found, (float(problem.lower[k]), float(problem.upper[k])))


def _profile_fixed(problem: Problem, name: str, optimum: LocalMinimum, scale: float) -> ParameterProfile:
    """Return the profile of a shape parameter that the fit held fixed."""
    freed = free_shape(problem, name)
    theta = freed.parameters.theta(problem.values(optimum.theta))
    k = freed.names.index(name)
    found = compute_profile(freed, k, minimize_squares(freed, theta), (), scale)
    return ParameterProfile(
        found,
        (float(freed.lower[k]), float(freed.upper[k])),
        fixed_at=problem.parameters.fixed[name],
        same=find_fixed_shape(problem)[name],
        tip_range_mm=tip_range(freed, theta, name),
    )


def _select_separate(problem: Problem, thetas: Sequence[Sequence[float]]) -> list[Floats]:
    """Return the first, then at most `MAX_OTHER_STARTS` that lie apart from it and from each other."""
    width = problem.upper - problem.lower
    kept: list[Floats] = []
    for theta in map(np.array, thetas):
        if all(np.any(np.abs(theta - other) > MIN_SEPARATION * width) for other in kept):
            kept.append(theta)
    return kept[: 1 + MAX_OTHER_STARTS] or [np.array(thetas[0])]
