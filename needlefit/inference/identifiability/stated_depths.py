"""Whether the data would show a boundary at another depth than stated, and which modulus leans on it."""

import math
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.identifiability.precision import linearize, prior_and_noise_information
from needlefit.inference.likelihood.nodes import shift_depths
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import DepthMetadata

#: of a boundary, either way, for derivatives, mm: that of constraint points, between which they jump
STEP_MM = 1.0


def examine_depths(problem: Problem, theta: Floats) -> list[DepthMetadata]:
    """Return a record for each boundary at a stated depth, by the information at the fit `theta` (P,).

    Of a shift that all insertions share: `sd_mm` to which the data know it, with the parameters free;
    `shift_mm` that the residuals suggest, positive where the boundary is deeper; `stated_sd_mm`; and the
    modulus that changes most with it, by `factor_per_mm`. None where depths are crossings of surfaces, or no
    noise is stated.
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
        found.append(
            DepthMetadata(
                boundary=k + 1,
                sd_mm=1 / math.sqrt(known),
                shift_mm=-float(left @ residuals) / scale / known,
                stated_sd_mm=stated,
                parameter=problem.names[worst],
                factor_per_mm=math.exp(abs(taken[worst])),
            )
        )
    return found
