"""Compare the lengths of curves with the stated depths, and name what explains a difference.

Points that are missing, a depth that is wrong, curves whose names were exchanged and another scale all make a
length differ from its depth. They differ in the rest: where the points begin, and which other needles
have the same.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.datasets.comparison import OUTLIER_SD
from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Noise
from needlefit.datasets.layers import ListedInsertion, find_length_tolerance
from needlefit.datasets.planes import MAX_NAMED_INSERTIONS
from needlefit.errors import DataError
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

SAME_LENGTH_MM = 0.1  # mm, by which a curve's length and its depth may differ: depths have a digit or two
# Part of a difference that a cause explains at least: of the place of the first point, or of another length.
MIN_EXPLAINED_PART = 0.7
SAME_SCALE = 0.02  # by which factors of one scale differ at most
MIN_ALIKE = 3  # needles that show a scale of all


@dataclass(frozen=True)
class _Difference:
    """A curve and its depth."""

    listed: ListedInsertion
    length: float  # of the curve, mm
    limit: float  # of the difference from the depth: beyond it has a cause, mm

    @property
    def name(self) -> str:
        return self.listed.insertion.id

    @property
    def depth(self) -> float:
        return self.listed.insertion.depth

    @property
    def gap(self) -> float:
        """By how much the curve is longer, mm."""
        return self.length - self.depth

    @property
    def is_beyond(self) -> bool:
        return abs(self.gap) > self.limit

    @property
    def begin(self) -> float:
        """Where the first point lies along the entry direction, from the entry, mm; 0 without an entry."""
        one = self.listed.insertion
        return 0.0 if one.pose_source == "none" else float(one.points[0, 0])


def find_length_faults(listed: Sequence[ListedInsertion], pose: str, depth_column: str) -> Iterator[Fault]:
    """Yield a fault for each curve that is far from as long as its depth."""
    every = [
        _Difference(
            one, one.insertion.smooth("space").length, find_length_tolerance(one.insertion.depth, pose)
        )
        for one in listed
    ]
    found = [one for one in every if one.is_beyond]
    for one in found:
        cause, fix = _find_cause(one, found, every, f"`{depth_column}`")
        yield DataError(
            f"is {one.length:.2f} mm long, but `{depth_column}` is {one.depth:.2f}. {cause}",
            expected=f"the inserted length, within {one.limit:.1f} mm",
            fix=fix,
            where=one.listed.points.where(),
        )


def find_length_warnings(
    listed: Sequence[ListedInsertion], noise: Noise, depth_column: str
) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions whose curves are longer or shorter than their depths.

    A depth is taken as it is stated. Free shapes need not begin at the entry.
    """
    every = list[_Difference]()
    point_sd = math.sqrt(2) * math.hypot(noise.point_sd, noise.correlated_sd)  # of both ends
    for one in (each for each in listed if each.insertion.pose_source != "none"):
        insertion, curve = one.insertion, one.insertion.smooth("space")
        sd = math.hypot(point_sd, curve.length_sd, insertion.depth_sd, insertion.pose_shift_sd)
        every.append(_Difference(one, curve.length, max(OUTLIER_SD * sd, SAME_LENGTH_MM)))
    found = sorted((one for one in every if one.is_beyond), key=lambda one: -abs(one.gap))
    if found:
        worst = found[0]
        cause, fix = _find_cause(worst, found, every, f"`{depth_column}`")
        names = join_names([one.name for one in found], MAX_NAMED_INSERTIONS)
        yield ResultWarning(
            kind="length",
            what=(
                f"{names}: the curve is longer or shorter than `{depth_column}` by more "
                f"than noise explains, that of {worst.name} by {worst.gap:+.2f} mm; the "
                f"stated depth is used. {cause}"
            ),
            where=worst.listed.where,
            fix=fix,
        )


def _find_cause(
    one: _Difference, found: Sequence[_Difference], every: Sequence[_Difference], column: str
) -> tuple[str, str]:
    """Return what most likely made a difference, of those `found`, and what to look at."""
    small = 1 - MIN_EXPLAINED_PART
    factors = [each.length / each.depth for each in found]
    if len(found) == len(every) >= MIN_ALIKE and np.ptp(factors) < SAME_SCALE:
        scale = f"Every curve is {np.mean(factors):.3g} times as long as its depth"
        return scale, f"check the unit and the scale of the points and of {column}"
    for other in (each for each in found if each is not one):
        crossed = one.length - other.depth, other.length - one.depth
        if np.hypot(*crossed) < small * np.hypot(one.gap, other.gap):
            fit = f"The curve of {one.name} is as long as {other.name} is deep, and the other way round"
            return fit, "check which curve has which name, and which row"
    if abs(one.begin + one.gap) < small * abs(one.gap):
        side = "beyond" if one.begin > 0 else "before"
        fix = "first points are missing" if one.begin > 0 else "points lie outside the tissue"
        first = f"Its first point lies {abs(one.begin):.1f} mm {side} the entry"
        return first, f"check whether {fix}, and where the entry is"
    if one.gap < 0:
        return "Its last points may be missing", f"check whether its points reach the tip, and {column}"
    more = f"{column} may be too small, or points lie outside the tissue"
    return more, f"check {column}, and whether its points go from the entry to the tip"
