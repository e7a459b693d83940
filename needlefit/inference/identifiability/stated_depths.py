"""Whether the data would show a boundary at another depth than stated, and which modulus leans on it."""

import math
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.common_doubts import change_all, list_boundary_shifts
from needlefit.inference.identifiability.precision import linearize, prior_and_noise_information
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import DepthMetadata

STEP_MM = 1.0  #: of a boundary for derivatives: that of constraint points, between which they jump


def examine_depths(problem: Problem, theta: Floats) -> list[DepthMetadata]:
    """Return a record for each boundary at a stated depth, by the information at the fit `theta` (P,).

    Of a shift that all insertions share: `sd_mm` to which the data know it, with the parameters free;
    `stated_sd_mm`; and the modulus that changes most with it, by `factor_per_mm`. None where depths are
    crossings of surfaces, or no noise is stated.
    """
    if not problem.dataset.noise_is_stated or any(insertion.surfaces for insertion in problem.insertions):
        return []
    stated = max(insertion.boundary_sd for insertion in problem.insertions)
    exact = tuple(replace(insertion, boundary_sd=0.0) for insertion in problem.insertions)
    base = replace(problem, insertions=exact)
    _, slope, chi_square, _ = linearize(base, theta)
    scale = max(1.0, chi_square)
    covariance = np.linalg.pinv(slope.T @ slope / scale + prior_and_noise_information(base), hermitian=True)
    moduli = [k for k, name in enumerate(problem.names) if name.startswith("mu")]
    rows: list[DepthMetadata] = []
    for shift in list_boundary_shifts(base):
        ends = [linearize(change_all(base, shift, step), theta)[0] for step in (STEP_MM, -STEP_MM)]
        by_depth = (ends[0] - ends[1]) / (2 * STEP_MM)
        taken = covariance @ (slope.T @ by_depth) / scale  # what the parameters take up of a mm
        left = by_depth - slope @ taken
        information = float(left @ by_depth) / scale
        if not information > 0 or not moduli:
            continue
        worst = max(moduli, key=lambda n: abs(taken[n]))
        rows.append(
            DepthMetadata(
                boundary=int(shift.where),
                sd_mm=1 / math.sqrt(information),
                stated_sd_mm=stated,
                parameter=problem.names[worst],
                factor_per_mm=math.exp(abs(taken[worst])),
            )
        )
    return rows
