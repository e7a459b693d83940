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
    for entry in listed:
        length, depth = entry.insertion.smooth("space").length, entry.insertion.depth
        limit = find_length_tolerance(depth, pose)
        if abs(length - depth) > limit:
            yield DataError(
                f"is {length:.2f} mm long, but `{depth_column}` is {depth:.2f}",
                expected=f"the inserted length, within {limit:.1f} mm",
                fix=FIX,
                where=entry.points.where(),
            )


def find_length_warnings(
    listed: Sequence[ListedInsertion], noise: Noise, depth_column: str
) -> Iterator[ResultWarning]:
    """Yield a warning with the curves that are longer or shorter than their depths by more than their errors.

    Free shapes need not begin at the entry.
    """
    ends, differing = math.sqrt(2) * math.hypot(noise.point_sd, noise.correlated_sd), list[tuple[str, str]]()
    for entry in (entry for entry in listed if entry.insertion.is_posed):
        insertion, curve = entry.insertion, entry.insertion.smooth("space")
        sd, gap = math.hypot(ends, curve.length_sd, insertion.depth_sd), curve.length - insertion.depth
        if abs(gap) > max(OUTLIER_SD * math.hypot(sd, insertion.pose_shift_sd), SAME_LENGTH_MM):
            differing.append((f"{insertion.id} by {gap:+.2f} mm", entry.where))
    if differing:
        names = join_names([name for name, _ in differing], MAX_NAMED_INSERTIONS)
        problem = (
            f"curves are longer or shorter than `{depth_column}` beyond their errors: {names}; the stated "
        )
        yield ResultWarning("length", f"{problem}depth is used", where=differing[0][1], fix=FIX)
