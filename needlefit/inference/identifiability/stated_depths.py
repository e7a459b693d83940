"""Whether the data would show a boundary at another depth than stated, and which modulus leans on it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.doubts import refit
from needlefit.inference.identifiability.precision import linearize, prior_and_noise_information
from needlefit.inference.likelihood.nodes import shift_depths
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import DepthMetadata

#: of a boundary, either way, for derivatives, mm: that of constraint points, between which they jump
STEP_MM = 1.0
#: standard deviations of a shift, by the derivatives, from which on the boundary is profiled: a boundary far
#: from where it is stated has flat derivatives there
MIN_PROFILED_SD = 1.0
PROFILE_STEP_MM = 0.3  #: to which the best depth of a profile is found
GRID_DEPTHS = 8  #: of a profile, between the neighbouring boundaries
FOUND_SD = 3.0  #: deviance of the stated depth in a profile, as standard deviations, that counts


def examine_depths(problem: Problem, theta: Floats) -> list[DepthMetadata]:
    """Return a record for each boundary at a stated depth, by the information at the fit `theta` (P,).

    Of a shift that all insertions share: `sd_mm` to which the data know it, with the parameters free;
    `shift_mm` that the residuals suggest, positive where the boundary is deeper; `stated_sd_mm`; and the
    modulus that changes most with it, by `factor_per_mm`. A boundary far from where it is stated is found by
    its profile. None where depths are crossings of surfaces, or no noise is stated.
    """
    if not problem.dataset.noise_is_stated or any(one.surfaces for one in problem.insertions):
        return []
    stated = max(one.boundary_sd for one in problem.insertions)
    exact = tuple(replace(one, boundary_sd=0.0) for one in problem.insertions)
    base = replace(problem, insertions=exact)
    residuals, slope, chi_square, _ = linearize(base, theta)
    scale = max(1.0, chi_square)
    covariance = np.linalg.pinv(slope.T @ slope / scale + prior_and_noise_information(base), hermitian=True)
    moduli = [k for k, name in enumerate(problem.names) if name.startswith("mu")]
    found: list[DepthMetadata] = []
    for k in range(max(len(one.boundaries) for one in exact)):
        ends = []
        for step in (STEP_MM, -STEP_MM):
            by = [step * (np.arange(len(one.boundaries)) == k) for one in exact]
            pairs = zip(exact, by, strict=True)
            moved = tuple(shift_depths(one, np.zeros(1), shift, 0.0)[0] for one, shift in pairs)
            ends.append(linearize(replace(problem, insertions=moved), theta)[0])
        by_depth = (ends[0] - ends[1]) / (2 * STEP_MM)
        taken = covariance @ (slope.T @ by_depth) / scale  # what the parameters take up of a mm
        left = by_depth - slope @ taken
        known = float(left @ by_depth) / scale
        if not known > 0 or not moduli:
            continue
        worst = max(moduli, key=lambda n: abs(taken[n]))
        shift, sd = -float(left @ residuals) / scale / known, 1 / math.sqrt(known)
        if abs(shift) > MIN_PROFILED_SD * math.hypot(sd, stated):
            shift, sd = _profile(base, theta, k, scale) or (shift, sd)
        found.append(
            DepthMetadata(
                boundary=k + 1,
                depth_mm=_find_depth(base, k),
                sd_mm=sd,
                shift_mm=shift,
                stated_sd_mm=stated,
                parameter=problem.names[worst],
                factor_per_mm=math.exp(abs(taken[worst])),
            )
        )
    return found


def _find_depth(problem: Problem, number: int) -> float:
    """Return the mean depth of a boundary over the insertions that cross it, mm."""
    return float(
        np.mean([one.boundaries[number] for one in problem.insertions if len(one.boundaries) > number])
    )


def _profile(problem: Problem, theta: Floats, number: int, scale: float) -> tuple[float, float] | None:
    """Return by how much a boundary is deeper than stated where the fit is best, and to which SD, mm.

    It is moved in all insertions, between its neighbours, and all parameters are fitted again. None unless
    the stated depth is beyond chance. `scale`: of the squared misfits.
    """
    stated = _find_depth(problem, number)
    longest = max(problem.insertions, key=lambda one: len(one.boundaries))
    ends = np.array([0.0, *longest.boundaries, max(one.depth for one in problem.insertions)])
    low, high = ends[number] - stated, ends[number + 2] - stated

    def weigh(shift: float) -> float:
        moved = [_move(one, number, stated, shift, longest.sequence) for one in problem.insertions]
        part = replace(problem, insertions=tuple(moved))
        return -(part.plain or part).log_posterior(refit(part, moved, theta)) / scale

    grid = np.linspace(low, high, GRID_DEPTHS + 2)[1:-1]
    step, start = float(grid[1] - grid[0]), weigh(0.0)
    nearest = float(min(grid, key=weigh))
    best = minimize_scalar(
        weigh, bounds=(nearest - step, nearest + step), method="bounded", options={"xatol": PROFILE_STEP_MM}
    )
    gain, shift = start - float(best.fun), float(best.x)
    if not gain > 0.5 * FOUND_SD**2:
        return None
    return shift, abs(shift) / math.sqrt(2 * gain)


def _move(
    insertion: Insertion, number: int, stated: float, shift: float, sequence: Sequence[int]
) -> Insertion:
    """Return an insertion with a boundary moved; one that did not reach it may do so then."""
    boundaries = insertion.boundaries.copy()
    if len(boundaries) > number:
        boundaries[number] += shift
    elif len(boundaries) == number:
        boundaries = np.append(boundaries, stated + shift)
    return replace(insertion, boundaries=boundaries, sequence=tuple(sequence[: len(boundaries) + 1]))
