"""Compare the lengths of curves with the stated depths."""

import math
from collections.abc import Iterator, Sequence

from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Noise
from needlefit.datasets.layers import ListedInsertion, find_length_tolerance
from needlefit.datasets.outlying_points import OUTLIER_SD
from needlefit.datasets.planes import MAX_NAMED_INSERTIONS
from needlefit.errors import DataError
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

SAME_LENGTH_MM = 0.1  #: mm, by which a curve's length and its depth may differ: depths have a digit or two
FIX = "check the depth, and whether the points go from the entry to the tip"


def find_length_faults(listed: Sequence[ListedInsertion], pose: str, depth_column: str) -> Iterator[Fault]:
    """Yield a fault for each curve that is far from as long as its depth."""
    for one in listed:
        length, depth = one.insertion.smooth("space").length, one.insertion.depth
        limit = find_length_tolerance(depth, pose)
        if abs(length - depth) > limit:
            yield DataError(
                f"is {length:.2f} mm long, but `{depth_column}` is {depth:.2f}",
                expected=f"the inserted length, within {limit:.1f} mm",
                fix=FIX,
                where=one.points.where(),
            )


def find_length_warnings(
    listed: Sequence[ListedInsertion], noise: Noise, depth_column: str
) -> Iterator[ResultWarning]:
    """Yield a warning with the curves that are longer or shorter than their depths by more than their errors.

    Free shapes need not begin at the entry.
    """
    ends, found = math.sqrt(2) * math.hypot(noise.point_sd, noise.correlated_sd), list[tuple[str, str]]()
    for one in (each for each in listed if each.insertion.is_posed):
        insertion, curve = one.insertion, one.insertion.smooth("space")
        sd, gap = math.hypot(ends, curve.length_sd, insertion.depth_sd), curve.length - insertion.depth
        if abs(gap) > max(OUTLIER_SD * math.hypot(sd, insertion.pose_shift_sd), SAME_LENGTH_MM):
            found.append((f"{insertion.id} by {gap:+.2f} mm", one.where))
    if found:
        names = join_names([name for name, _ in found], MAX_NAMED_INSERTIONS)
        what = f"curves are longer or shorter than `{depth_column}` beyond their errors: {names}; the stated "
        yield ResultWarning("length", f"{what}depth is used", where=found[0][1], fix=FIX)
