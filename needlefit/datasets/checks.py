"""What is checked of a dataset before a fit: one table, in the order of the warnings.

A needle is compared with what is stated of it, and its points with its own smooth curve; needles are compared
with each other only where two may be one. Whether the others predict a needle is judged by a fit
(`needlefit/inference/doubts.py`). These checks ask. Those that refuse a dataset, by faults, are:

- schema, types, ranges: `needlefit/schemas/dataset.py`, `insertion_table.py`;
- points: at least `MIN_POINTS`, none twice (`SAME_POINT_MM`), none far from all others, none that goes back
  by more than it errs (`MAX_BACKWARD_MM`): `find_curve_faults` in `layers.py`;
- entry: the first point within `MAX_START_DISTANCE_MM` of the stated one, the chord within `MAX_HEADING_DEG`
  of the stated direction: `find_curve_faults`;
- length of a curve beside its depth: `find_length_faults`, within `find_length_tolerance`;
- surfaces, layers, and what is stated but not used: `find_surface_faults`, `find_layer_faults`, `read.py`;
- bytes of files beside stated checksums: `sources.py`.
"""

from collections.abc import Callable, Iterator
from itertools import chain

from needlefit.datasets.layers import Checked
from needlefit.datasets.needle_warnings import (
    find_bevel_warnings,
    find_constant_warnings,
    find_copied_curves,
    find_entry_warnings,
    find_order_warnings,
    find_repeated_warnings,
)
from needlefit.datasets.outlying_points import find_point_warnings
from needlefit.datasets.planes import find_curvature_warnings, find_plane_warnings
from needlefit.datasets.record_warnings import (
    find_depth_warnings,
    find_noise_warnings,
    find_number_warnings,
    find_own_boundary_warnings,
    find_spelling_warnings,
    find_surface_warnings,
)
from needlefit.datasets.scatter import find_axis_warnings, find_interpolated_warnings
from needlefit.project.result_warnings import ResultWarning

Check = Callable[[Checked], Iterator[ResultWarning]]

#: what is stated alone, by kind of warning. `find_record_warnings` compares values of `dataset.toml` with the
#: ranges of `needlefit/project/unit_warnings.py`
STATED: tuple[Check, ...] = (
    find_spelling_warnings,  # "spelling": names of media, of specimens; alike by MIN_ALIKE
    find_own_boundary_warnings,  # "units": boundaries with the deepest insertion; BOUNDARY_TO_DEPTH
    find_depth_warnings,  # "units": the deepest insertion with MIN_DEEPEST_MM
    find_surface_warnings,  # "surfaces": insertions that meet none, or in another order than numbered
    find_number_warnings,  # "units": SDs of poses with SD_MM, ANGLE_SD_DEG, MAX_ROLL_SD_DEG
)
# between these, `find_point_warnings`, "point_outlier": single points with the cubic of their neighbours, by
# OUTLIER_SD; needles that have any are left out of the following
MEASURED: tuple[Check, ...] = (
    find_bevel_warnings,  # "bevel_side": the bend with the bevel's side; SIGNIFICANT_SD, MIN_BEND_SLOPE
    find_axis_warnings,  # "axis_unit": scatter along one axis with the stated SD; SCATTER_RATIOS squared
    find_entry_warnings,  # "entry_offset": first points with entries; OUTLIER_SD, and what tissue gives
    find_plane_warnings,  # "bevel_plane": tips with the planes of their bevels; SIGNIFICANT_SD, by Bonferroni
    find_curvature_warnings,  # "curvature": read curvatures with the tip; SIGNIFICANT_SD
    find_order_warnings,  # "reversed": whether last points lie in a plane and first ones do not
    find_interpolated_warnings,  # "interpolated": fourth differences of points with those of few of them
    find_copied_curves,  # "copy": equal coordinates of two needles; OUTLIER_SD, by Bonferroni
    find_constant_warnings,  # "axis_unit": a coordinate of one value that varies along most needles
    find_repeated_warnings,  # "copy": the distance of two needles with their errors; MIN_LOG_ODDS, Bonferroni
    find_noise_warnings,  # "no_noise", "noise": stated SDs with bends and scatter; SCATTER_RATIOS
)


def check_insertions(checked: Checked) -> Iterator[ResultWarning]:
    """Yield the warnings about insertions that have no fault."""
    for check in STATED:
        yield from check(checked)
    outlying = find_point_warnings(checked)
    yield from chain.from_iterable(outlying.values())
    # what is wrong with a point is no finding about its needle; where all have some, the noise is wrong
    sound = [entry for entry in checked.listed if entry.insertion.id not in outlying] or checked.listed
    for check in MEASURED:
        yield from check(checked._replace(listed=sound))
