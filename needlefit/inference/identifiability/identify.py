"""Decide which parameters the data determine, and which only in combination.

A parameter is called determined if the shapes could determine it (its standard deviation is below
`MAX_LOG_SD` in the logarithm, `MAX_SHAPE_SD` for shape parameters of a law, and below the part
`MAX_SD_RATIO` of the prior's), if it stays so with ties loosened and an error of the model (`conditions`), if
the starts that ended within tolerance of the best agree on it (their range is below `MAX_RANGE_SD` such
deviations), and if it does not lie at a bound. Of several specimens it is the mean over them; it must be as
well known in a further one.

Standard deviations and directions are those of the posterior's draws where there are any and no bound cuts
them off, else by the information. That is J^T J of the whitened residuals plus that of the stated prior or,
without one, of the bounds, 12 / width^2 (the precision of a uniform distribution): without it, an alpha free
to be 300 would take mu with it. Where the residuals are larger than the noise explains (reduced chi-square
above 1), J^T J is divided by that ratio. With five independent groups of insertions or more (depths of one
hole are one group), and two more than parameters, no deviation is smaller than the scatter between groups
implies (`precision.between_needle_sds`).

The information at the optimum is local, profile likelihoods are not, and the posterior SD is of draws where
there are any: where the three disagree, the sentence about a parameter says which.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.directions import (
    AGREEMENT,
    MAX_LOG_SD,
    MAX_SD_RATIO,
    MAX_SHAPE_SD,
    NORMAL_95_HALF_WIDTH_SD,
    UNINFORMED_SD_RATIO,
    Direction,
    is_determined_by_data,
    principal_directions,
)
from needlefit.inference.identifiability.precision import (
    LOOSENED,
    MEAN_OF_SPECIMENS,
    Loosened,
    add_estimated_noise,
    add_model_error,
    compute_sds,
    find_bounds,
    find_condition,
    find_tie_conditions,
    linearize,
    loosen,
    prior_information,
)
from needlefit.inference.identifiability.profile import (
    LikelihoodProfile,
    LocalMinimum,
    compute_profile,
    minimize_squares,
)
from needlefit.inference.parameter_changes import find_freed_bounds
from needlefit.inference.parameters import is_logarithmic, to_value, without_prior
from needlefit.inference.problem import Problem
from needlefit.inference.quantity_text import format_quantity, format_quantity_range
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.mechanics.laws import LAWS
from needlefit.project.progress import Stop, never_stop
from needlefit.project.tasks import TaskStop

#: largest range among equal starts, in these standard deviations, of a parameter called determined
MAX_RANGE_SD = 4.0
#: a start is within tolerance of the best if its log posterior is within this of the best one's
LOG_POSTERIOR_TOLERANCE = 0.1
#: the same for the metric objective: within 1 % or 0.002 mm of the best one's
METRIC_RELATIVE_TOLERANCE, METRIC_TOLERANCE_MM = 0.01, 0.002
MIN_NAMED_WEIGHT = 0.1  #: weight from which on a direction is named in the note of a parameter


@dataclass(frozen=True)
class Identifiability:
    """Which free parameters the data determine, and how well; mappings are keyed by parameter name."""

    sds: Mapping[str, float]  #: posterior standard deviation, of the logarithm (of a shape parameter itself)
    determined: Mapping[str, bool]  #: whether the data determine it by itself
    at_bound: Mapping[str, str]  #: "lower" or "upper" where the best point lies at a bound, else ""
    #: spread_low, spread_high: its range among the starts within tolerance of the best (Pa, mm)
    spread_low: Mapping[str, float]
    spread_high: Mapping[str, float]
    equal_starts: int  #: how many starts these are
    directions: tuple[Direction, ...]  #: principal directions of the information, best known first
    notes: Mapping[str, str]  #: one sentence for a person
    #: reduced: mean square of the whitened residuals at the best point; 1 where the noise explains them
    chi_square: float
    together: Mapping[str, bool] = field(default_factory=dict)  #: the same while all others are held
    #: under which assumption alone the data determine it, "" otherwise
    conditions: Mapping[str, str] = field(default_factory=dict)
    #: the standard deviations with assumptions loosened; none where nothing is determined anyway
    loosened: tuple[Loosened, ...] = ()
    #: by how much an error of the model lets each parameter vary beside the posterior: SD, as `sds`
    model_error: Mapping[str, float] = field(default_factory=dict)


def identify(
    problem: Problem, fit: Fit, draws: Floats | None = None, further: Floats | None = None
) -> Identifiability:
    """Return what the data determine at the best point of a fit, given `draws` (B, P) of its posterior.

    Where several specimens were fitted these are of their mean, and `further` (B, P) are in another specimen.
    """
    theta, names = np.array(fit.theta), problem.names
    noisy = add_estimated_noise(problem, theta)
    known, information, chi_square = compute_sds(noisy, theta, draws)
    sds, before = dict(zip(names, known.tolist(), strict=True)), prior_information(noisy)
    added = add_model_error(noisy, theta)
    # pinv: a direction without information has no variance to add to
    wider = np.linalg.pinv(np.linalg.pinv(information, hermitian=True) + added, hermitian=True)
    found = principal_directions(wider.astype(np.float64), names, before)
    together = _find_together(names, information, before)
    ends = [s.theta for s in select_within_tolerance(fit)] or [fit.theta]
    equal = np.array(ends, dtype=np.float64).reshape(len(ends), len(names))
    bounds = dict(zip(names, find_bounds(problem, theta), strict=True))
    ranges = dict(zip(names, np.ptp(equal, axis=0).tolist(), strict=True))
    prior = problem.parameters.prior
    informed = {n: not bounds[n] and sds[n] < MAX_SD_RATIO * prior.sd(n) for n in names}
    limits = {n: MAX_LOG_SD if is_logarithmic(n) else MAX_SHAPE_SD for n in names}
    nominally = {
        n: informed[n] and sds[n] < limits[n] and ranges[n] < MAX_RANGE_SD * limits[n] for n in names
    }
    loosened = loosen(noisy, theta, sds) if any(nominally.values()) else ()
    if loosened and further is not None:
        apart = dict(zip(names, np.std(further, axis=0).tolist(), strict=True))
        apart |= {name: apart.get(source, 0.0) for name, (_, source) in problem.parameters.ties.items()}
        loosened = (Loosened(MEAN_OF_SPECIMENS, apart), *loosened)
    conditions = {n: find_condition(n, prior.sd(n), loosened) if nominally[n] else "" for n in names}
    determined = {n: nominally[n] and not conditions[n] for n in names}
    conditions |= find_tie_conditions(problem.parameters, determined, conditions, loosened)
    low, high = (problem.values(end(equal, axis=0)) for end in (np.min, np.max))
    notes = {}
    for k, n in enumerate(names):
        if bounds[n]:
            note = f"not determined: it lies at its {bounds[n]} bound"
        elif determined[n]:
            note = f"determined, also with {LOOSENED}"
        elif conditions[n]:
            note = conditions[n]
        else:
            # the best-known combination that the parameter is part of, if any is known
            combinations = [
                one.words
                for one in found
                if abs(one.weights[k]) >= MIN_NAMED_WEIGHT and one.sd < MAX_LOG_SD and one.is_informed
            ]
            note = "not determined" + (" alone" if combinations else "")
            if is_logarithmic(n):
                note += ": equally good starts disagree" if sds[n] < MAX_LOG_SD else ""
            else:
                moved = tip_range(problem, theta, n)
                between = "over its whole range, {:g} to {:g}".format(*problem.parameters.bounds[n])
                note += f": {between}, the tip moves by at most {moved:.2g} mm"
            note = "; ".join([note, *combinations[:1]])
        notes[n] = note + prior.describe(n)
    return Identifiability(
        sds=sds,
        determined=determined,
        together=together,
        conditions=conditions,
        loosened=loosened,
        model_error=dict(zip(names, np.sqrt(np.diag(added)).tolist(), strict=True)),
        at_bound=bounds,
        spread_low={n: low[n] for n in names},
        spread_high={n: high[n] for n in names},
        equal_starts=len(equal),
        directions=found,
        notes=notes,
        chi_square=chi_square,
    )


def find_together(problem: Problem, theta: Floats) -> dict[str, bool]:
    """Return which parameters the data determine while all others are held, by the information at `theta`."""
    return _find_together(problem.names, compute_sds(problem, theta)[1], prior_information(problem))


def _find_together(names: Sequence[str], information: Floats, prior: Floats) -> dict[str, bool]:
    # the diagonal of the information is that on each parameter given all others
    held = zip(names, *(1 / np.sqrt(np.diag(one)) for one in (information, prior)), strict=True)
    return {name: is_determined_by_data(name, sd, prior_sd) for name, sd, prior_sd in held}


def select_within_tolerance(fit: Fit) -> tuple[Start, ...]:
    """Return the starts whose objective is within tolerance of the optimum."""
    return tuple(start for start in fit.starts if within_tolerance(start, fit))


def within_tolerance(start: Start, fit: Fit) -> bool:
    """Return whether the objective of a start is within tolerance of the best start's."""
    return objective_excess(start, fit) <= 1.0


def objective_excess(start: Start, fit: Fit) -> float:
    """Return the objective of a start minus the best one, in units of the tolerance."""
    tolerance = LOG_POSTERIOR_TOLERANCE
    if fit.minimized != "posterior":
        tolerance = max(METRIC_RELATIVE_TOLERANCE * abs(fit.objective), METRIC_TOLERANCE_MM)
    return (start.objective - fit.objective) / tolerance if math.isfinite(fit.objective) else math.inf


def tip_range(problem: Problem, theta: Floats, name: str) -> float:
    """Return the largest tip movement, mm, as one parameter alone goes through its bounds."""
    k = problem.names.index(name)
    tips = []
    for end in (problem.lower[k], problem.upper[k]):
        moved = theta.copy()
        moved[k] = end
        tips.append([s.tip_lateral if s.converged else math.nan for s in problem.shapes(moved)])
    low, high = np.array(tips)
    return float(np.max(np.abs(high - low)))


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
    bounds = find_freed_bounds(parameters, name, problem.medium.law)
    return problem.with_parameters(
        replace(
            parameters,
            bounds={**parameters.bounds, name: bounds},
            fixed={other: value for other, value in parameters.fixed.items() if other not in (name, *same)},
            ties={**parameters.ties, **dict.fromkeys(same, (1.0, name))},
        )
    )


#: most ends of other starts from which profiles are tried again, beside the middle of the bounds
MAX_OTHER_STARTS = 2
MIN_SEPARATION = 0.05  #: ends closer than this part of the bounds, in every parameter, are one place


@dataclass(frozen=True)
class ParameterProfile:
    """The profile of one parameter; for a fixed shape parameter also the range of the tip."""

    profile: LikelihoodProfile
    bounds: tuple[float, float]  #: in the parameter's coordinate of theta
    fixed_at: float | None = None  #: its value in the fit, where it was fixed there and freed for this
    same: tuple[str, ...] = ()  #: other parameters that went with it
    #: how far the tip moves most while it goes through its bounds, the others held, mm
    tip_range_mm: float | None = None
    #: how much the log posterior rises from the fit to the best point with the parameter free
    log_posterior_rise: float | None = None

    @property
    def name(self) -> str:
        return self.profile.name


@dataclass(frozen=True)
class FitProfiles:
    """The profiles of all parameters of one fit."""

    parameters: tuple[ParameterProfile, ...]  #: free ones in the order of theta, then fixed shape parameters
    scale: float  #: what deviances were divided by: the reduced chi-square where it is above 1
    gain: float  #: how much higher than at the fit the log posterior is at the best point met on the way
    best: tuple[float, ...]  #: Theta of that point


def profile_parameters(
    problem: Problem,
    fit: Fit,
    jobs: int = 1,
    stop: Stop = never_stop,
    step: Callable[[int, int], None] = lambda done, total: None,
) -> FitProfiles:
    """Compute the profiles about a fit; the result does not depend on the number of threads.

    Where the dataset states no noise, the fit's residuals stand for it. `stop` leaves out what has not begun.
    `step` is called with the number of profiles that are finished, and of all.
    """
    noisy = add_estimated_noise(problem, np.array(fit.theta))
    # the fit, and the ends of at most `MAX_OTHER_STARTS` that lie apart from it and from each other
    thetas = [fit.theta, *(s.theta for s in sorted(fit.starts, key=lambda s: s.objective))]
    ends: list[Floats] = []
    for theta in map(np.array, thetas):
        if all(np.any(np.abs(theta - end) > MIN_SEPARATION * (noisy.upper - noisy.lower)) for end in ends):
            ends.append(theta)
    ends = ends[: 1 + MAX_OTHER_STARTS]
    descend, never = partial(minimize_squares, noisy), TaskStop(never_stop)
    minima = [one for _, one in sorted(run_side_by_side(descend, ends, jobs, never))]
    optimum = min(minima, key=lambda one: one.value)
    elsewhere = [*ends[1:], 0.5 * (noisy.lower + noisy.upper)]
    scale = max(1.0, linearize(noisy, optimum.theta)[2])

    parts: list[str | int] = [*range(len(noisy.names)), *find_fixed_shape(noisy)]
    work = partial(_profile_one, noisy, optimum, elsewhere, scale)
    every: dict[int, ParameterProfile] = {}
    for n, one in run_side_by_side(work, parts, jobs, TaskStop(stop)):
        every[n] = one
        step(len(every), len(parts))
    found = tuple(every[n] for n in sorted(every))
    at_fit = noisy.jacobian(np.array(fit.theta))[0]
    # residuals are those of the posterior: of a metric fit their gain means nothing
    gain = 0.5 * (float(at_fit @ at_fit) - optimum.value) if fit.minimized == "posterior" else 0.0
    return FitProfiles(found, scale, gain, tuple(optimum.theta.tolist()))


def _profile_one(
    problem: Problem, optimum: LocalMinimum, elsewhere: Sequence[Floats], scale: float, part: str | int
) -> ParameterProfile:
    """Return the profile of a free parameter, by its number, or of a fixed shape parameter, by its name."""
    if isinstance(part, int):
        found = compute_profile(problem, part, optimum, elsewhere, scale)
        return ParameterProfile(found, (float(problem.lower[part]), float(problem.upper[part])))
    freed = free_shape(problem, part)
    theta = freed.parameters.theta(problem.values(optimum.theta))
    k = freed.names.index(part)
    found = compute_profile(freed, k, minimize_squares(freed, theta), (), scale)
    best = freed.jacobian(found.thetas[int(np.argmin(found.deviance))])[0]
    return ParameterProfile(
        found,
        (float(freed.lower[k]), float(freed.upper[k])),
        fixed_at=problem.parameters.fixed[part],
        same=find_fixed_shape(problem)[part],
        tip_range_mm=tip_range(freed, theta, part),
        log_posterior_rise=max(0.0, 0.5 * (optimum.value - float(best @ best))),
    )


#: half widths of intervals, and standard deviations, that differ by less than this factor agree
AGREEMENT_FACTOR = 1.5


@dataclass(frozen=True)
class Assessment:
    """How well one parameter is identified, by its profile and by the information."""

    name: str
    flat: bool  #: whether the data determine nothing: every value between the bounds is within the interval
    #: whether the 95 % interval of its profile ends on both sides and is as narrow as that of a parameter
    #: called determined
    determined: bool
    interval: tuple[float, float]  #: that interval (Pa, mm); the last values looked at where it does not end
    profile_verdict: str  #: the profile in words
    agreement: str  #: `AGREEMENT`, or where standard deviation, information and profile do not, in words


def assess_parameter(
    parameter: ParameterProfile, sds: tuple[float, float], equal: tuple[float, float] | None = None
) -> Assessment:
    """Return the identifiability of one parameter, and where the measures disagree.

    `sds` are the standard deviations of its coordinate in the posterior and in the prior, `equal` the lowest
    and highest coordinate at which equally good starts ended.
    """
    profile, name = parameter.profile, parameter.name
    low, high = (to_value(name, end) for end in (profile.low, profile.high))
    by_profile = 0  # class: 0 not determined, 1 in part, 2 determined
    if not profile.flat:
        sd = (profile.high - profile.low) / (2 * NORMAL_95_HALF_WIDTH_SD)  # of a Gaussian of this interval
        by_profile = 1 + (profile.closed and is_determined_by_data(name, sd, sds[1]))
    return Assessment(
        name=name,
        flat=profile.flat,
        determined=by_profile == 2,
        interval=(low, high),
        profile_verdict=_describe_profile(parameter, low, high),
        agreement="; ".join(_list_disagreements(parameter, sds, equal, by_profile)) or AGREEMENT,
    )


def _describe_profile(parameter: ParameterProfile, low: float, high: float) -> str:
    profile = parameter.profile
    if profile.flat:
        ends = (to_value(parameter.name, bound) for bound in parameter.bounds)
        between = format_quantity_range(parameter.name, *ends)
        tip_range_mm = parameter.tip_range_mm
        tip = "" if tip_range_mm is None else f" and the tip moves by {_print_small(tip_range_mm)} mm"
        rise = _print_small(profile.rise)
        description = f"not identifiable: over its whole range, {between}, the deviance rises by {rise}{tip}"
    elif profile.closed:
        description = f"{format_quantity_range(parameter.name, low, high)} (95 %)"
    else:
        values = (format_quantity(parameter.name, end) for end in (low, high))
        sides = list(zip(("above", "below"), values, profile.ends, strict=True))
        parts = [f"{side} {value} (95 %)" for side, value, end in sides if end == "closed"]
        parts += [f"open at its bound {value}" for _, value, end in sides if end == "bound"]
        parts += [f"no solution was found beyond {value}" for _, value, end in sides if end == "lost"]
        description = f"not identifiable: {', '.join(parts)}"
    return description + (f"; its profile has {profile.minima} minima" if profile.minima > 1 else "")


def _list_disagreements(
    parameter: ParameterProfile,
    sds: tuple[float, float],
    equal: tuple[float, float] | None,
    by_profile: int,
) -> Iterator[str]:
    """Yield where class, posterior SD, interval and starts are not as profile and information imply."""
    profile, name, (sd, prior_sd) = parameter.profile, parameter.name, sds
    by_sd = 0 if sd > UNINFORMED_SD_RATIO * prior_sd else 1 + is_determined_by_data(name, sd, prior_sd)
    if by_profile != by_sd:
        words = ("not determined", "determined in part", "determined")
        yield f"{words[by_sd]} by the posterior SD, {words[by_profile]} by the profile"
    ratio = sd * math.hypot(1 / profile.sd, 1 / prior_sd)
    if not 1 / AGREEMENT_FACTOR < ratio < AGREEMENT_FACTOR:
        yield f"the posterior SD is {ratio:.2g} times that by the information"
    half, found = NORMAL_95_HALF_WIDTH_SD * profile.sd, []
    reaches = (("below", profile.best - profile.low), ("above", profile.high - profile.best))
    for (side, reach), end in zip(reaches, profile.ends, strict=True):
        # 1e-9: the reach is divided by, and may be 0
        share = max(reach, 1e-9) / half
        if math.isfinite(half) and end == "closed" and not 1 / AGREEMENT_FACTOR < share < AGREEMENT_FACTOR:
            times = max(reach / half, half / max(reach, 1e-9))
            found.append(f"{times:.2g} times {'farther' if reach > half else 'nearer'} {side}")
    if found:
        yield f"the profile’s interval ends {' and '.join(found)} the optimum than the information implies"
    if equal is not None and not (equal[0] >= profile.low - 1e-6 and equal[1] <= profile.high + 1e-6):
        between = format_quantity_range(name, *(to_value(name, end) for end in equal))
        yield f"equally good starts end outside its interval, {between}"


def _print_small(value: float) -> str:
    return "less than 1e-4" if value < 1e-4 else f"at most {value:.2g}"
