"""Test a needle's cross-sections for a step: from one slice on they lie beside where its axis goes on.

A needle is a beam and has no step. Patients who move between two slices make one, and slices that are missing
or repeated. For the boundary of every two slices a shift of all that lies behind it is added to the fit,
which is linear near its optimum, and the largest F statistic of these shifts is tested (D. W. K. Andrews,
Econometrica 61 (1993) 821-856) against the residuals that are left, with their correlation along the needle,
and the model's stated error.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from needlefit.arrays import Floats
from needlefit.geometry.frames import to_unit
from needlefit.geometry.smoothing_spline import design_matrix, free_end_basis
from needlefit.imaging.constants import MM, PROBABILITY
from needlefit.imaging.needle.axis_spline import AxisSpline, axis_frames, correlation_factor
from needlefit.imaging.volume import Volume


@dataclass(frozen=True)
class Step:
    """A shift of the needle from one slice on."""

    place: Floats  # (3,); where the needle passes from one slice to the next, LPS, mm
    size: float  # across the needle, mm
    sd: float  # in any one direction, mm


def find_step(volume: Volume, axis: AxisSpline, near_slices: bool) -> Step | None:
    """Return the step that the cross-sections of an axis show between two slices; None if there is none.

    Of a needle near the slices, whose sections follow these along their normal, only steps in them show.
    """
    where, normal = axis_frames(axis, axis.s), volume.grid.normal
    across = [to_unit(np.cross(normal, where.tangents))] if near_slices else [where.u, where.v]
    beside = np.einsum("sn,dsn->sd", axis.points - where.origins, np.stack(across))
    slopes = design_matrix(axis.s, axis.spline.t) @ free_end_basis(axis.spline.t)
    inverse = np.linalg.pinv(slopes.T @ slopes)
    # anew: sections at a step, which count less in a fit, count in full
    left = beside - slopes @ (inverse @ (slopes.T @ beside))
    height = (axis.points - volume.origin) @ normal / volume.grid.slice_distance
    # sections of a base in tissue or air show its end, too
    tested = height[(axis.s > MM.EDGE_BLUR) & (axis.s < axis.length - MM.EDGE_BLUR)]
    if not len(tested):
        return None
    boundaries = np.arange(np.floor(tested.min()), tested.max())
    step, probability = None, PROBABILITY.FALSE_ALARM
    for boundary in boundaries:
        shift = np.clip(height - boundary, 0, 1)
        alone = shift - slopes @ (inverse @ (slopes.T @ shift))  # what no parameter explains
        information = float(alone @ shift)
        if information <= 1e-9 * np.sum(shift**2):
            continue
        sizes = alone @ left / information
        rest = left - np.outer(alone, sizes)
        factor = correlation_factor(rest, slopes.shape[1])
        freedom = max(1.0, (len(rest) - slopes.shape[1]) * len(across) / factor)
        variance = float(np.sum(rest**2)) / freedom / information + MM.MODEL_SD**2
        chance = len(boundaries) * fdtrc(len(across), freedom, np.mean(sizes**2) / variance)
        if chance < probability:
            place = axis.points[np.abs(shift - 0.5).argmin()]
            step, probability = Step(place, float(np.linalg.norm(sizes)), float(np.sqrt(variance))), chance
    return step
