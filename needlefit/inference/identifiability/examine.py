"""What a fit's data say of each parameter: the profiles of all free ones, and of alphas that are fixed."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.identifiability.freed import fixed_alphas, freed
from needlefit.inference.identifiability.identify import tip_range, told_by, with_noise
from needlefit.inference.identifiability.profile import Profile, profile
from needlefit.inference.identifiability.settle import Settled, settle
from needlefit.inference.problem import Problem
from needlefit.inference.starts import Fit

Floats = NDArray[np.float64]

ELSEWHERE = 2
"""Most ends of other starts from which profiles are tried again, beside the middle of the bounds."""

APART = 0.05
"""Ends closer than this part of the bounds, in every parameter, are one place."""


@dataclass(frozen=True)
class Examined:
    """The profile of one parameter, and the tip's way where it is an alpha.

    Attributes
    ----------
    profile : Profile
    bounds : tuple of two floats
        In the parameter's coordinate of theta.
    fixed_at : float or None
        Its value in the fit, where it was fixed there and freed for this.
    same : tuple of str
        Other parameters that went with it.
    tip_moves : float or None
        How far the tip moves most while alpha goes through its bounds, the others held, mm.
    """

    profile: Profile
    bounds: tuple[float, float]
    fixed_at: float | None = None
    same: tuple[str, ...] = ()
    tip_moves: float | None = None

    @property
    def name(self) -> str:
        """Of the parameter."""
        return self.profile.name


@dataclass(frozen=True)
class Examination:
    """All profiles of one fit.

    Attributes
    ----------
    parameters : tuple of Examined
        Free ones in the order of theta, then fixed alphas.
    scale : float
        What deviances were divided by: the reduced chi-square where it is above 1.
    evaluations : int
        Jacobians computed, those that led to the optimum included.
    gain : float
        How much higher than at the fit the log posterior is at the best point met on the way.
    """

    parameters: tuple[Examined, ...]
    scale: float
    evaluations: int
    gain: float = 0.0


def examine(
    problem: Problem, fit: Fit, jobs: int = 1, stop: Callable[[], bool] = lambda: False
) -> Examination:
    """Return the profiles about a fit; the same for any number of threads.

    Where the dataset states no noise, the fit's residuals stand for it. `stop` leaves out what has not begun.
    """
    weighed = with_noise(problem, np.array(fit.theta))
    ends = _apart(weighed, [fit.theta, *(s.theta for s in sorted(fit.starts, key=lambda s: s.objective))])
    settled = [settle(weighed, end) for end in ends]
    optimum = min(settled, key=lambda one: one.value)
    elsewhere = [*ends[1:], 0.5 * (weighed.lower + weighed.upper)]
    scale = max(1.0, told_by(weighed, optimum.theta)[2])

    def free(k: int) -> Examined | None:
        return None if stop() else _free(weighed, k, optimum, elsewhere, scale)

    def alpha(name: str) -> Examined | None:
        return None if stop() else _fixed(weighed, name, optimum, scale)

    with ThreadPoolExecutor(max(1, jobs), thread_name_prefix="profile") as pool:
        tasks = [pool.submit(free, k) for k in range(len(weighed.names))]
        tasks += [pool.submit(alpha, name) for name in fixed_alphas(weighed)]
        found = tuple(one for task in tasks if (one := task.result()) is not None)
    spent = sum(one.evaluations for one in settled) + sum(one.profile.evaluations for one in found)
    at_fit = weighed.residuals(np.array(fit.theta))
    gain = 0.5 * (float(at_fit @ at_fit) - optimum.value) if fit.minimized == "posterior" else 0.0
    return Examination(found, scale, spent, gain)


def _free(problem: Problem, k: int, optimum: Settled, elsewhere: Sequence[Floats], scale: float) -> Examined:
    found = profile(problem, k, optimum, elsewhere, scale)
    return Examined(found, (float(problem.lower[k]), float(problem.upper[k])))


def _fixed(problem: Problem, name: str, optimum: Settled, scale: float) -> Examined:
    """Return the profile of an alpha that the fit held fixed."""
    opened = freed(problem, name)
    theta = opened.parameters.theta(problem.values(optimum.theta))
    k = opened.names.index(name)
    found = profile(opened, k, settle(opened, theta), (), scale)
    return Examined(
        found,
        (float(opened.lower[k]), float(opened.upper[k])),
        fixed_at=problem.parameters.fixed[name],
        same=fixed_alphas(problem)[name],
        tip_moves=tip_range(opened, theta, name),
    )


def _apart(problem: Problem, thetas: Sequence[Sequence[float]]) -> list[Floats]:
    """Return the first of these, then at most `ELSEWHERE` that lie apart from it and from each other."""
    width = problem.upper - problem.lower
    kept: list[Floats] = []
    for theta in map(np.array, thetas):
        if all(np.any(np.abs(theta - other) > APART * width) for other in kept):
            kept.append(theta)
    return kept[: 1 + ELSEWHERE] or [np.array(thetas[0])]
