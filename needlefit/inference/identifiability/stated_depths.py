"""Whether the data would show a boundary at another depth than stated, and which modulus leans on it."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.compared import MIN_LOG_ODDS
from needlefit.inference.hypotheses import LOG_FITTED
from needlefit.inference.identifiability.precision import linearize, prior_and_noise_information
from needlefit.inference.linear_needles import (
    MIN_NEEDLES,
    Prediction,
    linearize_needle,
    predict_from,
    refit,
    weigh_all,
)
from needlefit.inference.problem import Problem
from needlefit.project.unit_warnings import LENGTH_UNITS
from needlefit.schemas.run_metadata import DepthMetadata

#: of a boundary for derivatives, either way, and the least of a profile, mm: that of constraint points,
#: between which they jump
STEP_MM = 1.0
GRID_DEPTHS = 5  #: of a profile, between the neighbouring boundaries
PROFILE_STEPS = 3  #: from there toward the most probable depth, by parabolas


def examine_depths(problem: Problem, theta: Floats) -> list[DepthMetadata]:
    """Return a record for each boundary at a stated depth, by the information at the fit `theta` (P,).

    Of a shift that all insertions share: `sd_mm` to which the data know it, with the parameters free;
    `shift_mm` that the residuals suggest, positive where the boundary is deeper; `stated_sd_mm`; and the
    modulus that changes most with it, by `factor_per_mm`. The shift is found by a profile, as derivatives are
    flat far from where a boundary is. None where depths are crossings of surfaces, or no noise is stated.
    """
    if not problem.dataset.noise_is_stated or any(insertion.surfaces for insertion in problem.insertions):
        return []
    stated = max(insertion.boundary_sd for insertion in problem.insertions)
    exact = tuple(replace(insertion, boundary_sd=0.0) for insertion in problem.insertions)
    base = replace(problem, insertions=exact)
    residuals, slope, chi_square, _ = linearize(base, theta)
    scale = max(1.0, chi_square)
    covariance = np.linalg.pinv(slope.T @ slope / scale + prior_and_noise_information(base), hermitian=True)
    moduli = [k for k, name in enumerate(problem.names) if name.startswith("mu")]
    rows: list[DepthMetadata] = []
    for k in range(max(len(insertion.boundaries) for insertion in exact)):
        ends = []
        for step in (STEP_MM, -STEP_MM):
            ends.append(linearize(_move_all(base, k, step), theta)[0])
        by_depth = (ends[0] - ends[1]) / (2 * STEP_MM)
        taken = covariance @ (slope.T @ by_depth) / scale  # what the parameters take up of a mm
        left = by_depth - slope @ taken
        information = float(left @ by_depth) / scale
        if not information > 0 or not moduli:
            continue
        worst = max(moduli, key=lambda n: abs(taken[n]))
        sd, near = 1 / math.sqrt(information), -float(left @ residuals) / scale / information
        shift, sd, describes = _profile(problem, theta, k, near, stated) or (0.0, sd, True)
        rows.append(
            DepthMetadata(
                boundary=k + 1,
                depth_mm=_find_depth(base, k),
                sd_mm=sd,
                shift_mm=shift,
                stated_sd_mm=stated,
                parameter=problem.names[worst],
                factor_per_mm=math.exp(abs(taken[worst])),
                describes=describes,
            )
        )
    return rows


def _find_depth(problem: Problem, number: int) -> float:
    """Return the mean depth of a boundary over the insertions that cross it, mm."""
    return float(
        np.mean(
            [
                insertion.boundaries[number]
                for insertion in problem.insertions
                if len(insertion.boundaries) > number
            ]
        )
    )


class _Profile(NamedTuple):
    """Where the fit is best with a boundary moved in all insertions."""

    shift: float  #: mm, positive where it is deeper than stated
    sd: float
    describes: bool


def _profile(problem: Problem, theta: Floats, number: int, near: float, stated_sd: float) -> _Profile | None:
    """Return by how much a boundary is deeper than stated where the needles are most probable.

    It is moved in all insertions, between its neighbours, and all parameters are fitted again; differences
    between needles are integrated out. `near`: by the derivatives. A depth that was written in a larger unit
    costs the choice of the unit alone. None if no other depth is more probable, or the noise is estimated:
    then any depth describes the needles.
    """
    if problem.likelihood.noise_scale == "estimated":
        return None
    stated = _find_depth(problem, number)
    longest = max(problem.insertions, key=lambda insertion: len(insertion.boundaries))
    ends = np.array([0.0, *longest.boundaries, max(insertion.depth for insertion in problem.insertions)])
    low, high = ends[number] - stated, ends[number + 2] - stated

    profile: dict[float, tuple[Floats, Prediction]] = {}  # by shift

    def add(shift: float) -> None:
        part = _move_all(problem, number, shift)
        moved = part.insertions
        nearest = min(profile, key=lambda other: abs(other - shift), default=None)
        refitted = refit(part, moved, theta if nearest is None else profile[nearest][0])
        blocks = [linearize_needle(part, insertion, refitted) for insertion in moved]
        profile[shift] = refitted, predict_from(part, range(len(moved)), weigh_all(part, blocks), refitted)

    by_unit = [(factor - 1) * stated for factor in LENGTH_UNITS.values()]
    in_units = [shift for shift in by_unit if 0 < shift < high]
    costs = dict.fromkeys(in_units, math.log(max(1, len(in_units))))
    evenly = np.linspace(low, high, GRID_DEPTHS + 2)[1:-1].tolist()
    grid = {0.0, *in_units, *[near] * bool(low < near < high), *evenly}
    for shift in sorted(grid, key=abs):
        add(shift)
    stated_density, count = profile[0.0][1].log_density, sum(problem.density.residual_counts)
    if max(prediction.log_density for _, prediction in profile.values()) <= stated_density:
        return None
    for _ in range(PROFILE_STEPS):
        shifts = sorted(profile)
        peak = int(
            np.clip(np.argmax([profile[shift][1].log_density for shift in shifts]), 1, len(shifts) - 2)
        )
        three = np.array(shifts[peak - 1 : peak + 2])
        square, slope, _ = np.polyfit(three, [profile[place][1].log_density for place in three.tolist()], 2)
        vertex = float(-slope / (2 * square)) if square < 0 else three.mean()
        if not three[0] < vertex < three[-1] or np.min(np.abs(three - vertex)) < STEP_MM:
            break
        add(vertex)

    gains = {
        shift: (prediction.log_density - stated_density) / max(1.0, prediction.chi_square)
        for shift, (_, prediction) in profile.items()
        if prediction.log_density > stated_density
    }

    def weigh(shift: float) -> tuple[bool, bool, float]:
        gain, cost = gains[shift], costs.get(shift, LOG_FITTED)
        # less what the error of the stated depth allows
        is_far_better = gain / (1 + 2 * gain * (stated_sd / shift) ** 2) - cost >= MIN_LOG_ODDS
        return profile[shift][1].describes(count), is_far_better, gain - cost * is_far_better

    shift = max(gains, key=weigh)
    describes, is_far_better, _ = weigh(shift)
    is_tested = len(problem.insertions) >= MIN_NEEDLES
    sd = abs(shift) / math.sqrt(2 * gains[shift])
    return _Profile(shift, sd, is_tested and describes and is_far_better)


def _move_all(problem: Problem, number: int, shift: float) -> Problem:
    """Return the problem with a boundary moved in all insertions, also in those that did not reach it."""
    longest = max(problem.insertions, key=lambda insertion: len(insertion.boundaries))
    stated, moved = _find_depth(problem, number), []
    for insertion in problem.insertions:
        boundaries = insertion.boundaries.copy()
        if len(boundaries) > number:
            boundaries[number] += shift
        elif len(boundaries) == number:
            boundaries = np.append(boundaries, stated + shift)
        sequence = longest.sequence[: len(boundaries) + 1]
        moved.append(replace(insertion, boundaries=boundaries, sequence=tuple(sequence)))
    return replace(problem, insertions=tuple(moved))
