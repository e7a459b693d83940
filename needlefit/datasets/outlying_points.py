"""Compare single points with the smooth curve of their own needle."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import ndtri

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import Checked, ListedInsertion
from needlefit.datasets.points import find_rounding
from needlefit.geometry.neighbours import leave_one_out
from needlefit.project.result_warnings import ResultWarning

#: number of standard deviations beyond which a point or a needle is named: of 1e6 normal ones 0.6 are, so
#: that no dataset has one by chance; benchmarks/mistakes.py counts those of sound needles
OUTLIER_SD = 5.0
#: smallest SD of points (mm) that is assumed: it allows for what a cubic misses of a bent needle
MIN_SCATTER_MM = 0.01
#: smallest number of points of a curve that are checked: the four neighbours of a cubic, and two more
MIN_CURVE_POINTS = 6
#: largest fraction of points of a curve, or of needles, that are named; if more are off, the curve is rough,
#: or the model does not fit
MAX_OUTLYING_PART = 0.25


def find_point_warnings(checked: Checked) -> dict[str, list[ResultWarning]]:
    """Return the warnings about points off the curves of their needles, by insertion."""
    curves = [entry for entry in checked.curves if len(entry.insertion.points) >= MIN_CURVE_POINTS]
    if not curves:
        return {}
    rounding = find_rounding([curve.points.values for curve in curves])
    pairs = [(curve, sd_of_points(curve.insertion, checked.noise, rounding)) for curve in curves]
    larger = max(1.0, _measure_excess(pairs))
    outlying = {}
    for entry, sd in pairs:
        warnings = [*_find_in_curve(entry, larger * sd)]
        if 0 < len(warnings) <= MAX_OUTLYING_PART * len(sd):
            outlying[entry.insertion.id] = warnings
    return outlying


def sd_of_points(insertion: Insertion, noise: Noise, rounding: float) -> Floats:
    """Return the standard deviation of each point (N,), mm; that of rounding counts as half a step."""
    own_sds = np.zeros(len(insertion.points)) if insertion.sd is None else insertion.sd
    shared = (noise.of(insertion).point_sd, noise.correlated_sd, rounding / 2, MIN_SCATTER_MM)
    return np.hypot(own_sds, math.hypot(*shared))


def _measure_excess(pairs: Sequence[tuple[ListedInsertion, Floats]]) -> float:
    """Return the factor by which the points of all needles scatter more than their SDs, by the median."""
    sizes = [np.abs(measure_residuals(entry.insertion)) / sd[:, None] for entry, sd in pairs]
    return float(np.median(np.vstack(sizes)) / ndtri(0.75))


def measure_residuals(insertion: Insertion) -> Floats:
    """Return how far each point (N, 2) lies across the needle from the curve of its neighbours, mm.

    Divided by the factor by which errors of the neighbours enlarge it: their SD is that of the points.
    """
    off, factor = leave_one_out(insertion.points[:, 0], insertion.points[:, 1:])
    return off / factor[:, None]


def _find_in_curve(entry: ListedInsertion, sd: Floats) -> Iterator[ResultWarning]:
    """Yield the outlying points of one curve, the worst first: without each the next is sought.

    `sd` (N,): of the points, mm.
    """
    insertion, kept = entry.insertion, np.arange(len(sd))
    while len(kept) >= MIN_CURVE_POINTS:
        x, *values = insertion.points[kept].T
        off, factor = leave_one_out(x, np.column_stack(values))
        sds = np.abs(off).max(axis=1) / (factor * sd[kept])
        worst = int(np.argmax(sds))
        if sds[worst] <= OUTLIER_SD:
            return
        yield _describe(entry, int(kept[worst]), off[worst], float(sds[worst]))
        kept = np.delete(kept, worst)


def _describe(entry: ListedInsertion, index: int, off: Floats, sds: float) -> ResultWarning:
    """Return a warning that names the row of a point, and the coordinate that is off most.

    `index`: from the entry. `off` (2,): across the needle, from the curve of its neighbours, mm.
    """
    insertion = entry.insertion
    away_mm = insertion.frame.rotation[:, 1:] @ off
    axis = int(np.argmax(np.abs(away_mm)))
    place = {0: "the first point", len(insertion.points) - 1: "the tip"}.get(index, f"point {index + 1}")
    problem = f"{place} of {insertion.id} is off the curve of its neighbours by "
    problem += f"{away_mm[axis]:+.2g} mm along {'xyz'[axis]} ({sds:.0f} SD)"
    fix = "compare this row with its source"
    return ResultWarning("point_outlier", problem, where=entry.points.where(index), fix=fix)
