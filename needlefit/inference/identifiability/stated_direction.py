"""What the direction of insertion would determine, of shapes that are known only up to a rigid motion."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.identifiability.information import cramer_rao, linearize, prior_and_noise_information
from needlefit.inference.parameter_names import HYPERPARAMETERS, is_logarithmic
from needlefit.inference.problem import Problem

DIRECTION_SD_DEG = 0.5  #: SD of the direction (degrees) of a needle that is set by hand


def predict_factors(problem: Problem, theta: Sequence[float]) -> dict[str, float]:
    """Return the factor between the ends of each 95 % interval if all directions were stated, by parameter.

    By the information at `theta` (P,), without the measured residuals: these are of shapes that were turned.
    Only moduli and lengths have a factor.
    """
    searched, problem = problem.parameters.restrict(np.array(theta)), problem.searched
    angle_sd = math.radians(DIRECTION_SD_DEG)
    insertions = tuple(
        replace(insertion, pose_source="first_point", pose_angle_sd=angle_sd)
        for insertion in problem.insertions
    )
    stated = replace(problem, dataset=replace(problem.dataset, pose="known"), insertions=insertions)
    slope = linearize(stated, searched).slope
    sds = cramer_rao(slope.T @ slope + prior_and_noise_information(stated))
    return {
        name: math.exp(2 * NORMAL_95_HALF_WIDTH_SD * sd)
        for name, sd in zip(stated.names, sds.tolist(), strict=True)
        if is_logarithmic(name) and name not in HYPERPARAMETERS
    }
