"""Warn about needles that can be fitted all the same: bevel sides, copies, order, entries."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import bdtrc, ndtr

from needlefit.arrays import Floats
from needlefit.datasets.bend_sides import measure_bends
from needlefit.datasets.compared import MAX_NAMED_INSERTIONS, MIN_BEND_SLOPE, MIN_LOG_ODDS, compute_entry_sd
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import (
    LENGTH_TOLERANCE_MM,
    MAX_START_DISTANCE_MM,
    SAME_POINT_MM,
    Checked,
    ListedInsertion,
)
from needlefit.datasets.outlying_points import MAX_OUTLYING_PART, OUTLIER_SD
from needlefit.datasets.points import find_rounding
from needlefit.datasets.scatter import AXIS_COSINE, measure_scatter
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

# ---- bevel sides


def find_side_warnings(
    listed: Sequence[tuple[Insertion, str]], noise: Noise, column: str
) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions, with their places, that bend away from their bevels."""
    bends = measure_bends([one for one, _ in listed], noise)
    away = [(one, where) for (one, where), bend in zip(listed, bends, strict=True) if bend.is_away]
    clear = len(away) + sum(bend.is_toward for bend in bends)
    if not away:
        return
    names = tuple(one.id for one, _ in away)
    what = f"bent away from the bevel side: {join_names(names, MAX_NAMED_INSERTIONS)}"
    what += f" ({len(away)} of {clear} that bend clearly)"
    fix = f"compare `{column}`, the bevel direction and the sign of the points with their source"
    if len(away) == clear > 1:
        what, names = f"all {clear} insertions that bend clearly bend away from their bevel side", ()
        fix = f"check whether `{column}` is flipped: a needle of side 1 bends along the bevel direction"
    yield ResultWarning("bevel_side", what, f"{away[0][1]}", fix, names)


# ---- insertions


def find_repeated_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning for each two needles that are most likely one, measured twice.

    Two needles differ by the errors of points and poses of both; one needle by errors of points, which it has
    in part in common. None where many are so near: then the stated errors are too large; nor where the errors
    of the poses were assumed: a precise stage may put two needles in one place.
    """
    listed, noise = checked.curves, checked.noise
    is_assumed = any(key in checked.assumed for key in ("pose_shift_sd", "pose_angle_sd"))
    if is_assumed or not _is_finer_than_noise([entry.points.values for entry in listed], noise):
        return
    scatters = [scatter for entry in listed if (scatter := measure_scatter(entry.insertion)) > 0]
    sd = min(noise.point_sd, math.hypot(*scatters) / math.sqrt(max(1, len(scatters))))
    ends = np.array([entry.points.values[-1] for entry in listed])
    is_close = np.linalg.norm(ends[:, None] - ends, axis=-1) < 2 * OUTLIER_SD * sd
    limit = MIN_LOG_ODDS + math.log(max(1, math.comb(len(listed), 2)))
    pairs = ((listed[m], listed[n]) for m, n in np.argwhere(np.triu(is_close, 1)))
    near = [pair for pair in pairs if _weigh_repeated(*pair, sd) >= limit]
    for earlier, later in near if len(near) <= MAX_OUTLYING_PART * len(listed) else ():
        names = (later.insertion.id, earlier.insertion.id)
        what = f"{' and '.join(names)} lie closer together than two needles can"
        yield ResultWarning("copy", what, later.where, "check whether one was measured twice", names)


def _weigh_repeated(earlier: ListedInsertion, later: ListedInsertion, sd: float) -> float:
    """Return the log odds that two curves are of one needle, by their distance across it at each point."""
    insertion, (points, others) = earlier.insertion, (earlier.points.values, later.points.values)
    if len(points) != len(others):
        return -math.inf
    x, apart = insertion.points[:, 0], ((others - points) @ insertion.frame.rotation)[:, 1:] / sd
    if not 0 < np.mean(apart**2) <= 2:  # that two measurements of one needle have; a copy has 0
        return -math.inf
    pose = insertion.pose_shift_sd**2 + insertion.pose_angle_sd**2 * np.outer(x, x)
    of_two = 2 * (np.eye(len(x)) + pose / sd**2)
    squares = np.sum(apart * np.linalg.solve(of_two, apart)) - np.sum(apart**2)
    return float(squares / 2 + np.linalg.slogdet(of_two)[1])  # of two axes


def find_copied_curves(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning for each two curves with the same points, or the same coordinate across."""
    listed = [(entry.insertion, entry.where, entry.points.values) for entry in checked.curves]
    return find_copy_warnings(listed, checked.noise)


def find_copy_warnings(
    listed: Sequence[tuple[Insertion, str, Floats]], noise: Noise
) -> Iterator[ResultWarning]:
    """Yield a warning for each two insertions, of places and points, with the same points, or the same
    coordinate across.

    Errors alone make rounded coordinates differ: they are equal with a probability of at most the step over
    2 sqrt(pi) SD.
    """
    values = [points for *_, points in listed]
    if not _is_finer_than_noise(values, noise):
        return
    step = max(find_rounding(values), SAME_POINT_MM)
    chance = min(1.0, step / (2 * math.sqrt(math.pi) * noise.point_sd)) if noise.point_sd else 1.0
    least_chance = ndtr(-OUTLIER_SD) / max(1, math.comb(len(values), 2))  # of any two needles
    counts = np.array([len(points) for points in values])
    padded = np.full((len(values), max(counts), 3), np.nan)
    for points, row in zip(values, padded, strict=True):
        row[: len(points)] = points
    places = [set(map(tuple, (points / SAME_POINT_MM).round().tolist())) for points in values]
    for n, (later, where, _) in enumerate(listed):
        entry = later.frame.rotation[:, 0]
        same = np.sum(np.abs(padded[:n] - padded[n]) < SAME_POINT_MM, axis=1)  # (n, 3)
        common = np.minimum(counts[:n], counts[n])[:, None]
        # along the needles all may be sampled alike, and what does not vary is no measurement
        is_measured = (np.abs(entry) < AXIS_COSINE) & (np.ptp(values[n], axis=0) > 0)
        is_same = is_measured & (same > common / 2) & (bdtrc(same - 1, common, chance) < least_chance)
        for m, axes in enumerate(is_same):
            if is_copy := places[m] <= places[n] or places[n] <= places[m]:
                axes[:] = True
            if axes.any():
                names = (later.id, listed[m][0].id)
                count = len(places[m] & places[n]) if is_copy else same[m, axes].min()
                named = " and ".join(np.array(list("xyz"))[axes])
                what = f"{' and '.join(names)} have the same {named} at {count} points"
                fix = "look whether one was exported twice"
                yield ResultWarning("copy", what, where, fix, names)
                break  # of ten equal needles nine are copies of the first, not 45 pairs


def find_order_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning if the last points lie in one plane across the needles, and the first ones do not."""
    listed = checked.curves
    if len(listed) < 3:
        return
    ends = np.array([entry.insertion.centerline[[0, -1]] for entry in listed])
    along = (ends[:, 1] - ends[:, 0]).sum(axis=0)
    first, last = np.ptp(ends @ along, axis=0) / (np.linalg.norm(along) or 1.0)
    if first > MAX_START_DISTANCE_MM and last < LENGTH_TOLERANCE_MM:
        what = "curves seem to run from tip to entry"
        fix = "check the order of the points; at an import: `--set entry=last`"
        yield ResultWarning("reversed", what, where=listed[0].where, fix=fix)


def find_constant_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning for each needle with one value in a coordinate that varies along most others."""
    listed = checked.curves
    if not _is_finer_than_noise([one.points.values for one in listed], checked.noise):
        return
    varies = np.mean([np.ptp(one.points.values, axis=0) > 0 for one in listed], axis=0) > 0.5  # (3,)
    for one in listed:
        for axis in np.flatnonzero(varies & (np.ptp(one.points.values, axis=0) == 0)):
            value = one.points.values[0, axis]
            what = f"{one.insertion.id}: {'xyz'[axis]} is {value:g} at all points, and varies along others"
            fix = "export its points again"
            yield ResultWarning("axis_unit", what, one.points.where(), fix, (one.insertion.id,))


def find_entry_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions that begin off their stated entries.

    Soft tissue gives way at the entry by nearly as much as a needle bends.
    """
    found = []
    for entry in (curve for curve in checked.curves if curve.insertion.is_posed):
        insertion = entry.insertion
        off, slope = insertion.points[0], MIN_BEND_SLOPE * insertion.depth
        give = np.array([LENGTH_TOLERANCE_MM, slope + np.ptp(insertion.points[:, 1]), slope])
        if np.any(np.abs(off) > OUTLIER_SD * compute_entry_sd(insertion, checked.noise) + give):
            by = ", ".join(f"{x:z.1f}" for x in off)
            found.append((f"{insertion.id} by {by} mm", entry.points.where()))
    if found:
        names = join_names([name for name, _ in found], MAX_NAMED_INSERTIONS)
        what = f"needles begin off their stated entries (along, toward the bevel, out of plane): {names}"
        fix = "check their entries and first points, the frame, and pose_shift_sd_mm"
        yield ResultWarning("entry_offset", what, where=found[0][1], fix=fix)


def find_bevel_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions of a table that bend away from their bevels."""
    column = checked.record.insertions.columns.get("bevel_side", "bevel_side")
    pairs = [(entry.insertion, entry.where) for entry in checked.listed]
    yield from find_side_warnings(pairs, checked.noise, column)


def _is_finer_than_noise(values: Sequence[Floats], noise: Noise) -> bool:
    """Whether points are rounded by less than their noise: else those of two needles may well be equal."""
    return bool(values) and find_rounding(values) <= max(noise.point_sd, noise.correlated_sd)
