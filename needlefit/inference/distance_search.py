"""Approach the least weighted sum of distances by Gauss-Newton steps.

A step leads to the least sum of the distances made linear, within the bounds and a radius (Osborne and Watson
1971, https://doi.org/10.1093/comjnl/14.2.184). The kinks, where a distance is 0, stay in the linear problem:
most minima lie on some of them, which quasi-Newton methods find in many small steps. The linear problem is
solved by least squares, reweighted while the kinks are made sharp.
"""

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.fit import FIRST_RADIUS, EvaluationRecorder
from needlefit.inference.least_squares import find_step
from needlefit.inference.metric_objective import SMOOTHING_MM, WeightedDistances

MIN_GAIN = 1e-4  #: gain that the linear problem promises, as a part of the sum, under which a search ends
#: times the linear problem is reweighted: from kinks as wide as a typical distance to sharp ones
REWEIGHTINGS = 5


def run_gauss_newton(recorder: EvaluationRecorder, start: Floats) -> str:
    """Search from theta `start` (P,) within the bounds; return why it ended.

    Raises SearchEnded where the recorder ends it.
    """
    lower, upper = recorder.objective_function.lower, recorder.objective_function.upper
    theta, radius, distances = start, FIRST_RADIUS, recorder.distances(start)
    if distances is None:
        return "failed at its start"
    while True:
        step = _solve_linear(distances, np.maximum(lower - theta, -radius), np.minimum(upper - theta, radius))
        gain = distances.total - distances.move(step).total
        if gain <= MIN_GAIN * distances.total:
            return "tolerance"
        trial = recorder.distances(theta + step)
        gain_ratio = -1.0 if trial is None else (distances.total - trial.total) / gain
        if gain_ratio > 0.75:
            radius *= 2
        elif gain_ratio < 0.25:
            radius = 0.25 * float(np.max(np.abs(step)))
        if trial is not None and gain_ratio > 0:
            theta, distances = np.clip(theta + step, lower, upper), trial


def _solve_linear(distances: WeightedDistances, low: Floats, high: Floats) -> Floats:
    """Return the step (P,) between two bounds that makes the sum of the distances made linear least."""
    step = np.zeros(len(low))
    width = float(np.median(np.linalg.norm(distances.off, axis=1)))
    for smoothing in np.geomspace(max(width, SMOOTHING_MM), SMOOTHING_MM, REWEIGHTINGS):
        off = distances.move(step).off
        pull = distances.weights / np.sqrt(np.sum(off**2, axis=1) + smoothing**2)
        pulls = np.repeat(pull, distances.off.shape[1])
        curvature = (distances.rows.T * pulls) @ distances.rows
        # singular where a combination of parameters moves nothing
        curvature[np.diag_indices(len(low))] += 1e-12 * max(float(np.trace(curvature)), 1e-300)
        best_step = find_step((distances.off.ravel() * pulls) @ distances.rows, curvature, low, high)
        if best_step is None:
            break
        step = np.clip(best_step, low, high)
    return step
