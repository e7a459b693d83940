"""Test the image of a needle for a step: from one slice on it lies beside where the fitted rod goes on.

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


def find_step(beside: Floats, slopes: Floats, shifts: Floats, places: Floats) -> Step | None:
    """Return the step that a needle shows which is seen `beside` (S, M, D) a fit, mm; None if there is none.

    S: stations along it, M: sections at each, 0 where none shows, D: directions across. `slopes` (S, M, P):
    derivatives by the P parameters of a direction; `shifts` (K, S, M): 1 behind a boundary of slices, 0
    before it; `places` (K, 3): where the needle passes the boundaries, LPS, mm.
    """
    inverse = np.linalg.pinv(np.tensordot(slopes, slopes, axes=([0, 1], [0, 1])))
    # anew: sections at a step, which count less in a fit, count in full
    left = beside - slopes @ (inverse @ np.tensordot(slopes, beside, axes=([0, 1], [0, 1])))
    best, probability = None, PROBABILITY.FALSE_ALARM
    for shift, place in zip(shifts, places, strict=True):
        followed = inverse @ np.tensordot(slopes, shift, axes=([0, 1], [0, 1]))
        alone = shift - slopes @ followed  # what no parameter explains
        information = float(np.sum(alone * shift))
        if information <= 1e-9 * np.sum(shift**2):
            continue
        sizes = np.tensordot(alone, left, axes=2) / information
        rest = left - alone[..., None] * sizes
        factor = correlation_factor(rest.reshape(len(rest), -1), slopes.shape[2])
        count, components = np.count_nonzero(left), left.shape[2]
        freedom = max(1.0, (count - components * slopes.shape[2]) / factor)
        variance = float(np.sum(rest**2)) / freedom / information + MM.MODEL_SD**2
        chance = len(shifts) * fdtrc(components, freedom, np.mean(sizes**2) / variance)
        if chance < probability:
            best, probability = Step(place, float(np.linalg.norm(sizes)), float(np.sqrt(variance))), chance
    return best


def find_section_step(volume: Volume, axis: AxisSpline) -> Step | None:
    """Return the step that the cross-sections of an axis show between two slices; None if there is none."""
    where, slopes = axis_frames(axis, axis.s), design_matrix(axis.s, axis.spline.t)
    slopes = slopes @ free_end_basis(axis.spline.t)
    beside = np.einsum("sn,dsn->sd", axis.points - where.origins, np.stack([where.u, where.v]))
    height = (axis.points - volume.origin) @ volume.grid.normal / volume.grid.slice_distance
    boundaries = np.arange(np.floor(height.min()), height.max())
    behind = np.clip(height - boundaries[:, None], 0, 1)
    places = axis.points[np.abs(behind - 0.5).argmin(axis=1)]
    return find_step(beside[:, None], slopes[:, None], behind[..., None], places)
