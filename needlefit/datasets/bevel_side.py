"""Check whether measured needles bend toward the side their bevel faces, as the model's needles do."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

SIGNIFICANT_SD = 3.0
"""Standard deviations beyond which a bend is not a measurement error."""

MIN_BEND_SLOPE = 0.005
"""Least bend over depth that counts: entry directions are hardly known better than 0.3 degrees."""

REVERSED_SD = 4.0
"""Standard deviations of a medium's insertions together beyond which bevels count as reversed; the weight of
a single one is limited to this."""

MAX_NAMED_INSERTIONS = 8
"""Number of insertions that a warning names."""

BendSide = Literal["toward", "away", "unknown"]


@dataclass(frozen=True)
class BendResult:
    """One insertion or run with its table row and its bending side: toward or away from the bevel, or
    "unknown" within noise.

    `z` is its deflection toward the bevel in standard deviations; NaN where it cannot be judged.
    """

    id: str
    where: str
    bend: BendSide
    medium: str = ""
    z: float = math.nan


def classify_insertion(insertion: Insertion, where: str, noise: Noise) -> BendResult:
    """Return the bend result of an insertion; `where` is its position in the files, for messages."""
    z = compute_deflection_z(insertion, noise)
    return BendResult(insertion.id, where, find_bend_side(insertion, noise), insertion.medium, z)


def compute_deflection_z(insertion: Insertion, noise: Noise) -> float:
    """Return the deflection toward the bevel in standard deviations; NaN where it cannot be judged.

    They allow for noise of points and pose, and for entry directions off by a third of `MIN_BEND_SLOPE`.
    """
    if insertion.pose_source == "none" or insertion.base_moved:
        return math.nan
    return insertion.deflection / math.hypot(
        _compute_deflection_sd(insertion, noise), MIN_BEND_SLOPE * insertion.depth / SIGNIFICANT_SD
    )


def _compute_deflection_sd(insertion: Insertion, noise: Noise) -> float:
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    pose = math.hypot(shift, insertion.pose_angle_sd * insertion.depth)
    return math.hypot(pose, noise.point_sd, noise.correlated_sd)


def find_bend_side(insertion: Insertion, noise: Noise) -> BendSide:
    """Return to which side of its bevel an insertion bends.

    Both the tip's deflection from the entry line and the curve's own bend, which no error of the entry pose
    changes, must say so. A free shape lies by its bend, and a base that was moved bends the needle too: they
    say nothing.
    """
    if insertion.pose_source == "none" or insertion.base_moved:
        return "unknown"
    points = float(np.hypot(noise.point_sd, noise.correlated_sd))
    least = MIN_BEND_SLOPE * insertion.depth
    deflection_limit = max(least, SIGNIFICANT_SD * _compute_deflection_sd(insertion, noise))
    x, y = insertion.planar.T
    bend, scatter = fit_parabola(x, insertion.side * y)
    bend_limit = max(0.5 * least, SIGNIFICANT_SD * float(np.hypot(scatter, points)))
    return _classify((insertion.deflection, deflection_limit), (bend, bend_limit))


def find_track_bend_side(track: TipTrack, noise: Noise) -> BendSide:
    """Return to which side of its bevel a run bends; unknown if its guide moved.

    Readings are known up to a shift and a slope: only the bend counts.
    """
    if track.guided:
        return "unknown"
    bend, scatter = fit_parabola(track.depths, track.side * track.tip)
    points = float(np.hypot(noise.point_sd, noise.correlated_sd))
    limit = max(MIN_BEND_SLOPE * track.depth, SIGNIFICANT_SD * float(np.hypot(scatter, points)))
    return _classify((bend, limit))


def fit_parabola(x: Floats, y: Floats) -> tuple[float, float]:
    """Fit a parabola to points (N,); return the deflection from its first tangent, and the rms residual."""
    coefficients = np.polyfit(x - x[0], y, 2)
    residuals = y - np.polyval(coefficients, x - x[0])
    return float(coefficients[0] * (x[-1] - x[0]) ** 2), float(np.sqrt(np.mean(residuals**2)))


def _classify(*measures: tuple[float, float]) -> BendSide:
    if all(value > limit for value, limit in measures):
        return "toward"
    return "away" if all(value < -limit for value, limit in measures) else "unknown"


def find_side_warnings(results: Sequence[BendResult], column: str, what: str) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions, or runs (`what`), that bend away from their bevel."""
    away = [one for one in results if one.bend == "away"]
    clear = sum(one.bend != "unknown" for one in results)
    if not away:
        return
    if len(away) == clear > 1:
        message = f"all {clear} {what} that bend clearly bend away from their bevel side"
        fix = f"the side convention is probably flipped: change the sign of `{column}` in every row"
    else:
        names = join_names([one.id for one in away], MAX_NAMED_INSERTIONS)
        message = f"{names} bend{'s' if len(away) == 1 else ''} away from the bevel side"
        message += f" ({len(away)} of {clear} {what} that bend clearly)"
        fix = f"check `{column}` and the bevel direction of these rows"
    yield ResultWarning("bevel_side", message, away[0].where, fix)


def pool_z(results: Sequence[BendResult]) -> float:
    """Return the pooled z value: the sum of the defined values over the root of their number; NaN without
    any.

    Each is limited to `REVERSED_SD`, so that a single wrong row does not speak for its medium.
    """
    z = [min(max(one.z, -REVERSED_SD), REVERSED_SD) for one in results if not math.isnan(one.z)]
    return sum(z) / math.sqrt(len(z)) if z else math.nan


def find_pooled_side_warnings(results: Sequence[BendResult], column: str) -> Iterator[ResultWarning]:
    """Yield a warning for each medium whose insertions, taken together, bend away from their bevels.

    None where every insertion that bends clearly bends away: `find_side_warnings` names those already.
    """
    clear = [one.bend for one in results if one.bend != "unknown"]
    if len(clear) > 1 and set(clear) == {"away"}:
        return
    for medium in dict.fromkeys(one.medium for one in results):
        group = [one for one in results if one.medium == medium and not math.isnan(one.z)]
        z = pool_z(group)
        if len(group) > 1 and z < -REVERSED_SD:
            worst = sorted((one for one in group if one.z < 0), key=lambda one: one.z)
            names = join_names([one.id for one in worst], MAX_NAMED_INSERTIONS)
            what = (
                f"the bevel sides of medium {medium} are probably all reversed: its {len(group)} insertions "
            )
            what += (
                f"together bend away from their bevels by {-z:.1f} standard deviations, most of all {names}"
            )
            yield ResultWarning("bevel_side", what, worst[0].where, f"change the sign of `{column}` there")
