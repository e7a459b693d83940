"""Warn about a dataset that can be fitted all the same: placeholders, units, copies, bevel sides."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import scipy

from needlefit.arrays import Floats
from needlefit.datasets.columns import BOUNDARIES_COLUMN, NUMBER_COLUMNS, ROLL_COLUMNS
from needlefit.datasets.curve_lengths import find_length_warnings
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import MISSED_FIX, SAME_POINT_MM, ListedInsertion, name_small_unit
from needlefit.datasets.outlying_needles import find_needle_warnings
from needlefit.datasets.outlying_points import (
    drop_outlying_points,
    find_axis_warnings,
    find_constant_warnings,
    find_outlying_points,
    find_point_warnings,
)
from needlefit.datasets.planes import (
    MAX_NAMED_INSERTIONS,
    MIN_BEND_SLOPE,
    SIGNIFICANT_SD,
    compute_deflection_sd,
    find_curvature_warnings,
    find_plane_warnings,
)
from needlefit.datasets.points import find_rounding
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.project.unit_warnings import (
    ANGLE_SD_DEG,
    ANGLE_UNITS,
    LENGTH_UNITS,
    FormatPlace,
    doubt_layers,
    doubt_range,
    format_place,
    needle_warnings,
    warn,
)
from needlefit.schemas.dataset import DatasetRecord, TrackDatasetRecord, needle_key
from needlefit.schemas.mapping import MappingRecord

PLACEHOLDER = "TO FILL IN"  # marks values that a template cannot know

# Least plausible standard deviation of a centreline's points; a smaller one was written in another unit.
MIN_POINT_SD_MM = 5e-4
# Least and greatest plausible standard deviation of registration and entry pose.
MIN_POSE_SD_MM = 1e-3  # mm; a smaller one was written in another unit
MAX_POSE_SD_MM = 5.0  # mm; with a greater one curves cannot be compared
MAX_ROLL_SD_DEG = 45.0  # standard deviation of a roll beyond which nothing is known of it
MAX_NOISE_FRACTION = 0.5  # fraction of the largest deflection above which noise hides the deflections

# Standard deviations of a medium's insertions together beyond which bevels count as reversed; the weight of a
# single one is limited to this.
REVERSED_SD = 4.0
# By how much two measurements of one curve differ at least.
MIN_LIKENESS = 0.3  # scatters of a point
MIN_LIKENESS_POINTS = 15  # points of a curve from which its scatter is known
MIN_LIKENESS_MM = 0.003  # mm, of curves of fewer points, or that were smoothed
MIN_COPY_SD_MM = 0.02  # mm, least scatter of a measurement
MAX_COPY_CHANCE = 1e-6  # that points are rounded alike: a greater one explains a likeness
MIRRORS = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # of the coordinates across a needle
SMOOTH_ORDER = 3  # of a polynomial across the plane of a needle, where it does not bend
BEND_ORDER = 6  # of one in its plane
# Scatter of points about it, over the stated errors of points, that does not contradict them.
MIN_SCATTER_RATIO = 1 / 3  # least
MAX_SCATTER_RATIO = 2.0  # most

# Curves begin at the tips of which the first points spread along the needles, and the last ones do not.
MIN_LEVEL_MM = 5.0  # mm, least spread of the first points
MAX_LEVEL_PART = 0.1  # of that, most spread of the last ones

# ---- the record


MAPPING_FILE = "mapping.toml"  # beside dataset.toml: how an import read its files


def read_assumed(record: DatasetRecord | TrackDatasetRecord, file: Path) -> dict[str, str]:
    """Return what the import of a dataset assumed, by key, with its value and the reason."""
    path = file.parent / MAPPING_FILE
    if record.import_ is None or record.import_.mapping is None or not path.is_file():
        return {}
    mapping = load(path, MappingRecord)
    return {key: f"{mapping.values[key]}: {why}" if key in mapping.values else why
            for key, why in mapping.assumed.items()}  # fmt: skip


def find_record_warnings(
    record: DatasetRecord | TrackDatasetRecord, file: Path, assumed: Mapping[str, str]
) -> Iterator[ResultWarning]:
    """Yield the warnings about a `dataset.toml`, without regard to its tables.

    `assumed`: what its import assumed, by key.
    """
    where = format_place(file)
    texts = {key: getattr(record, key) for key in ("title", "license", "source", "notes")}
    if keys := [key for key, text in texts.items() if PLACEHOLDER in text]:
        yield ResultWarning(
            kind="placeholder",
            what=f'"{PLACEHOLDER}" is left in {", ".join(f"`{key}`" for key in keys)}',
            where=where(keys[0]),
            fix="write what was measured; reports print it",
        )
    needles = record.all_needles
    for name, needle in needles.items():
        yield from needle_warnings(needle, where, needle_key(name))
    if record.import_ is not None and (examples := record.import_.examples):
        yield ResultWarning(
            kind="examples",
            what=(
                "simulated examples of the workbook are among the needles: "
                f"{join_names(examples, len(examples))}"
            ),
            where=where("import.examples"),
            fix="delete their rows in the imported file, and import it again",
        )
    if assumed:
        listed = "; ".join(f"{key} ({why})" for key, why in assumed.items())
        yield ResultWarning(
            kind="assumed",
            what=f"the import assumed {listed}",
            where=MAPPING_FILE,
            fix="correct what is wrong, or import again with --set; then remove its line from [assumed]",
        )
    pose_sd, noise = (MIN_POSE_SD_MM, MAX_POSE_SD_MM), record.noise
    larger = "point" if noise.point_sd_mm >= noise.correlated_sd_mm else "correlated"
    for name, plausible, units in (
        ("registration_mean_mm", pose_sd, LENGTH_UNITS),
        (f"{larger}_sd_mm", (MIN_POINT_SD_MM, MAX_POSE_SD_MM), LENGTH_UNITS),
        ("heading_sd_deg", ANGLE_SD_DEG, ANGLE_UNITS),
        ("slope_sd_deg", ANGLE_SD_DEG, ANGLE_UNITS),
    ):
        if value := getattr(noise, name):
            yield from warn(
                doubt_range(value, plausible, units, f"noise.{name}", name[-3:].strip("_")), where
            )
    longest = (0.0, max(needle.length_mm for needle in needles.values()))
    if noise.correlated_sd_mm:
        key = "noise.correlation_length_mm"
        yield from warn(doubt_range(noise.correlation_length_mm, longest, LENGTH_UNITS, key, "mm"), where)


# ---- bevel sides

BendSide = Literal["toward", "away", "unknown"]


def find_bend_side(insertion: Insertion, noise: Noise) -> BendSide:
    """Return to which side of its bevel an insertion or a run of a tip track bends.

    Both the tip's deflection from the entry line and the curve's own bend, which no error of the entry pose
    changes, must show it. Of a run the bend alone counts: its readings are known up to a shift and a slope. A
    free shape lies by its bend, and a base or guide that moved, or a bevel that was turned, bends the needle
    too: they show nothing.
    """
    guide = insertion.guide
    if guide.moved if guide else insertion.pose_source == "none" or insertion.base_moved:
        return "unknown"
    if insertion.turns:
        return "unknown"
    x, y = insertion.points[:, 0], insertion.side * insertion.points[:, 1]
    least, measures = MIN_BEND_SLOPE * insertion.depth, []
    if len(x) > 2:  # more than a tip
        parabola = np.polyfit(x - x[0], y, 2)
        bend = float(parabola[0] * (x[-1] - x[0]) ** 2)  # the deflection from its first tangent
        scatter = float(np.sqrt(np.mean((y - np.polyval(parabola, x - x[0])) ** 2)))
        noise_sd = SIGNIFICANT_SD * float(np.hypot(scatter, np.hypot(noise.point_sd, noise.correlated_sd)))
        measures.append((bend, max(least if guide else 0.5 * least, noise_sd)))
    if guide is None:
        limit = max(least, SIGNIFICANT_SD * compute_deflection_sd(insertion, noise))
        measures.append((insertion.deflection, limit))
    if all(value > limit for value, limit in measures):
        return "toward"
    return "away" if all(value < -limit for value, limit in measures) else "unknown"


def find_side_warnings(
    listed: Sequence[tuple[Insertion, str]], noise: Noise, column: str
) -> Iterator[ResultWarning]:
    """Yield warnings that name the insertions, with their places, that bend away from their bevels.

    Those of a medium that bend too little to be judged alone are judged together.
    """
    sides = [find_bend_side(one, noise) for one, _ in listed]
    clear = sum(side != "unknown" for side in sides)
    away = [(one, where) for (one, where), side in zip(listed, sides, strict=True) if side == "away"]
    if len(away) == clear > 1:
        yield ResultWarning(
            kind="bevel_side",
            what=f"all {clear} insertions that bend clearly bend away from their bevel side",
            where=f"{away[0][1]}",
            fix=(
                f"check whether the convention of `{column}` is flipped: a needle of side 1 "
                "bends along the bevel direction"
            ),
        )
        return
    if away:
        names = join_names([one.id for one, _ in away], MAX_NAMED_INSERTIONS)
        yield ResultWarning(
            kind="bevel_side",
            what=f"{names} bend away from the bevel side ({len(away)} of {clear} that bend clearly)",
            where=f"{away[0][1]}",
            fix=f"check `{column}` and the bevel direction of these rows",
        )
    for medium in dict.fromkeys(one.medium for one, _ in listed):
        group = [(_compute_bend_z(one, noise), where) for one, where in listed if one.medium == medium]
        group = [(z, where) for z, where in group if not math.isnan(z)]
        total = sum(max(-REVERSED_SD, min(z, REVERSED_SD)) for z, _ in group)
        if len(group) > 1 and total < -REVERSED_SD * math.sqrt(len(group)):
            yield ResultWarning(
                kind="bevel_side",
                what=f"the {len(group)} insertions into {medium} together bend away from their bevels",
                where=min(group)[1],
                fix=f"check `{column}` and the bevel direction of these rows",
            )


def _compute_bend_z(insertion: Insertion, noise: Noise) -> float:
    """Return the deflection toward the bevel in standard deviations; NaN where it cannot be judged.

    They allow for noise of points and pose, and for entry directions off by a third of `MIN_BEND_SLOPE`.
    """
    if insertion.pose_source == "none" or insertion.base_moved or insertion.turns:
        return math.nan
    slope = MIN_BEND_SLOPE * insertion.depth / SIGNIFICANT_SD
    return insertion.deflection / math.hypot(compute_deflection_sd(insertion, noise), slope)


# ---- insertions


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same centreline, point by point."""
    a, b = one.centerline, other.centerline
    return a.shape == b.shape and bool(np.abs(a - b).max() <= SAME_POINT_MM)


def measure_scatter(one: Insertion) -> float:
    """Return the standard deviation of points about a smooth curve across the plane of the needle, mm.

    No needle bends there, so that a cubic takes away all but the errors of single points. Points of a plane,
    and free shapes, are taken to scatter in their plane. NaN of few points.
    """
    is_flat = one.pose_source == "none" or float(np.ptp(one.points[:, 2])) < SAME_POINT_MM
    order, values = (BEND_ORDER, one.points[:, 1]) if is_flat else (SMOOTH_ORDER, one.points[:, 2])
    if (free := len(values) - order - 1) <= order:
        return math.nan
    x = one.points[:, 0] / one.depth
    left = values - np.polynomial.Polynomial.fit(x, values, order)(x)
    return math.sqrt(float(left @ left) / free)


def measure_likeness(one: Insertion, other: Insertion) -> Floats:
    """Return the distances of points of one curve from the line through those of the other, mm.

    Each curve lies in the frame of its own entry, where one may be the mirror image of the other, or both in
    the frame of one. They may have other points of the same line, of which ends may be cut. The pair with the
    least median counts.
    """
    curve, again = (each.points for each in (one, other))
    there = one.frame.to_local(other.centerline)
    found = np.array([math.inf])
    for pair, signs in (((curve, again), MIRRORS), ((curve, there), MIRRORS[:1])):
        for a, b in (pair, pair[::-1]):
            a = a[(a[:, 0] >= b[0, 0]) & (a[:, 0] <= b[-1, 0])]
            if len(a) > 2:
                line = np.column_stack([np.interp(a[:, 0], b[:, 0], axis) for axis in b[:, 1:].T])
                gaps = [np.linalg.norm(a[:, 1:] * sign - line, axis=1) for sign in signs]
                found = min(found, *gaps, key=np.median)
    return found


def find_chance_of_rounding(step: float, sd: float) -> float:
    """Return the probability that a coordinate, measured twice with `sd`, is rounded to the same step, mm."""
    ratio = step / (math.sqrt(2) * sd)  # over the SD of a difference
    inside = math.erf(ratio / math.sqrt(2))
    return inside - math.sqrt(2 / math.pi) * (1 - math.exp(-(ratio**2) / 2)) / ratio if ratio else 0.0


def _find_copy_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning for each insertion of which more points lie on an earlier curve than noise allows.

    Where coordinates are rounded, it must be more than rounding of two measurements explains.
    """
    insertions = [one.insertion for one in listed]
    gaps = [float(np.diff(one.measure_arc("plane")).max()) for one in insertions]
    scatters = [
        min(noise.point_sd, measure_scatter(one)) if len(one.points) >= MIN_LIKENESS_POINTS else 0.0
        for one in insertions
    ]
    step = find_rounding([one.points.values for one in listed]) if listed else 0.0
    sd = max(math.hypot(noise.point_sd, noise.correlated_sd), MIN_COPY_SD_MM)
    for n, (later, place) in enumerate((one.insertion, one.where) for one in listed):
        for k, one in enumerate(insertions[:n]):
            if abs(one.depth - later.depth) > max(gaps[k], gaps[n]) + noise.point_sd:
                continue  # a copy of which a point is left out is shorter by a gap
            least = MIN_LIKENESS * min(scatters[k], scatters[n])
            least = max(SAME_POINT_MM, least, min(MIN_LIKENESS_MM, noise.point_sd / 30))
            away = measure_likeness(one, later)
            same, count = int(np.sum(away <= least)), len(away)
            axes = 1 + any(float(np.ptp(each.points[:, 2])) > 0 for each in (one, later))
            chance = find_chance_of_rounding(step, sd) ** axes if step > least else 0.0
            if np.median(away) <= least and scipy.special.bdtrc(same - 1, count, chance) < MAX_COPY_CHANCE:
                yield ResultWarning(
                    kind="copy",
                    what=(
                        f"{later.id} and {one.id} are the same in {same} of {count} points, "
                        f"within {least:.1g} mm, which "
                        f"noise{' and rounding do' if step > least else ' does'} not explain"
                    ),
                    where=place,
                    fix="check whether one was exported twice, and `noise.point_sd_mm`",
                )
                break


def find_insertion_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, file: Path
) -> Iterator[ResultWarning]:
    """Yield the warnings about insertions that have no fault."""
    where = format_place(file)
    curves, others = ([one for one in listed if one.is_curve is part] for part in (True, False))
    if others:
        yield from _find_side_warnings(record, others, noise)
    if curves:
        outlying = find_outlying_points(curves, noise)
        yield from find_point_warnings(curves, outlying)
        yield from find_axis_warnings(curves, noise)
        yield from find_constant_warnings(curves, noise)
        # what is wrong with a point alone is no finding about its needle
        curves = [drop_outlying_points(one, outlying) for one in curves]
        yield from _find_shape_warnings(record, curves, noise, outlying)
    kept = {one.insertion.id: one for one in (*curves, *others)}
    listed = [kept[one.insertion.id] for one in listed]
    insertions = [one.insertion for one in listed]
    yield from find_boundary_warnings(record, insertions, where)
    yield from _find_own_boundary_warnings(record, listed)
    deepest = max(insertions, key=lambda one: one.depth, default=None)
    if deepest is not None and (unit := name_small_unit(deepest)):
        yield ResultWarning(
            kind="units",
            what=f"the deepest insertion is {deepest.depth:.3g} mm deep: this looks like {unit}",
            where=f"{listed[0].where}",
            fix=f"check the unit of all lengths; they are read in mm ({unit} times {LENGTH_UNITS[unit]:g})",
        )
    for name in dict.fromkeys(one.medium for one in insertions if one.surfaces):
        group = [one for one in insertions if one.medium == name]
        yield from _find_surface_warnings(name, group, where(f"media.{name}.surfaces"))
    yield from _find_noise_warnings(record, listed, noise, where)


def _find_side_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise
) -> list[ResultWarning]:
    column = record.insertions.columns.get("bevel_side", "bevel_side")
    return list(find_side_warnings([(one.insertion, one.where) for one in listed], noise, column))


def _find_shape_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, outlying: Collection[str]
) -> Iterator[ResultWarning]:
    """Yield the warnings about whole curves; those whose ids are `outlying` have points that are not."""
    sides = _find_side_warnings(record, listed, noise)
    yield from sides
    # wrong sides look like needles that lean alike, and like one that differs
    needles = [] if sides else list(find_needle_warnings(listed, noise))
    yield from needles
    if not any(one.kind == "common_pose" for one in needles):
        yield from find_plane_warnings(listed, noise)
    yield from find_curvature_warnings(listed, noise)
    yield from _find_reversed_warnings(listed, noise)
    measured = [one for one in listed if one.insertion.id not in outlying]  # their ends are points
    yield from find_length_warnings(measured, noise, record.insertions.columns.get("depth_mm", "depth_mm"))
    yield from _find_copy_warnings(listed, noise)


def _find_surface_warnings(name: str, group: Sequence[Insertion], where: str) -> Iterator[ResultWarning]:
    """Yield a warning if insertions miss the surfaces of their medium, or meet sheets in another order."""
    meeting = [one for one in group if len(one.sequence) > 1]
    sheets = [surface.into for surface in group[0].surfaces if surface.kind == "sheet"]
    least = max((float(one.boundaries[0]) for one in meeting), default=0.0)
    missed = [one for one in group if one not in meeting and one.depth > least]
    if missed and (not meeting or len(sheets) == len(group[0].surfaces)):  # beside a solid a needle may pass
        points = np.vstack([one.centerline[:1] for one in missed])
        bounds = [surface.mesh.bounds for surface in group[0].surfaces]
        within = any(((low <= points) & (points <= high)).all() for low, high in bounds)
        fix = "they begin within its bounds: close the hole where they enter" if within else MISSED_FIX
        yield ResultWarning(
            kind="surfaces",
            what=f"{len(missed)} of {len(group)} insertions into {name} meet none of its surfaces",
            where=where,
            fix=fix,
        )
    orders = [[layer for layer in dict.fromkeys(one.sequence) if layer in sheets] for one in meeting]
    turned = [order != sorted(order) for order in orders if len(order) > 1]
    if turned and all(turned):
        yield ResultWarning(
            kind="surfaces",
            what=f"needles into {name} meet its layers in the order {' > '.join(map(str, max(orders)))}",
            where=where,
            fix=(
                "number `into` (at an import: name the files) in the order in which needles meet the surfaces"
            ),
        )


def _find_reversed_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning if curves seem to begin at the tips; of at least one insertion.

    Either their last points lie in one plane across them, and their first ones do not, or they begin off the
    entry direction, beyond errors, and end along it: a bevel bends a needle the more, the deeper it is.
    """
    own = [one.insertion for one in listed]
    ends = np.array([one.centerline[[0, -1]] for one in own])
    along = (ends[:, 1] - ends[:, 0]).sum(axis=0)
    first, last = np.ptp(ends @ along, axis=0) / (np.linalg.norm(along) or 1.0)
    is_level = len(own) > 2 and first > MIN_LEVEL_MM and last < MAX_LEVEL_PART * first
    slopes = [(0.0, 0.0, 0.0)]  # at the first and last points, about the entry, and their deviation, rad
    for one in own:
        if one.pose_source != "none" and not one.turns and not one.base_moved:
            s = one.measure_arc("space")
            bend, slope, _ = np.polyfit(s, one.points[:, 1:], 2)
            sd = math.hypot(one.pose_angle_sd, 4 * math.hypot(noise.point_sd, noise.correlated_sd) / s[-1])
            begin, end = (float(np.linalg.norm(one)) for one in (slope, slope + 2 * bend * s[-1]))
            slopes.append((begin, end, sd))
    begin, end, sd = np.linalg.norm(slopes, axis=0) / math.sqrt(max(len(slopes) - 1, 1))
    if (is_turned := begin > max(2 * end, SIGNIFICANT_SD * sd, MIN_BEND_SLOPE)) or is_level:
        why = "begin off the entry direction, and end along it" if is_turned else "end in a plane across them"
        yield ResultWarning(
            kind="reversed",
            what=f"curves seem to run from the tip to the entry: they {why}",
            where=f"{listed[0].where}",
            fix="check the order of the points; at an import `--set entry=last` states this one",
        )


def _find_noise_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield the warnings that follow from stated errors and insertions together."""
    insertions = [one.insertion for one in listed]
    largest = max((abs(one.deflection) for one in insertions), default=0.0)
    sd = float(np.hypot(noise.point_sd, noise.correlated_sd))
    if not noise.stated and not all(one.states_errors for one in insertions):
        yield ResultWarning(
            kind="no_noise",
            what=(
                "no noise of the points is stated, so fits have neither noise floor nor predictive intervals"
            ),
            where=where("noise.point_sd_mm"),
            fix="write `noise.point_sd_mm`, the standard deviation of a point per axis",
        )
    if sd > MAX_NOISE_FRACTION * largest:
        yield ResultWarning(
            kind="noise",
            what=f"the noise of the points, {sd:g} mm, hides deflections of {largest:.3g} mm at most",
            where=where(_name_larger_sd(noise)),
            fix="check its unit, mm; such data determine nothing",
        )
    else:
        is_smoothed = record.measurement is not None and record.measurement.operator != "none"
        curves = [one.insertion for one in listed if one.is_curve]
        yield from find_scatter_warnings(curves, noise, where, is_smoothed)
    yield from _find_number_warnings(record, listed, where)


def _name_larger_sd(noise: Noise) -> str:
    return f"noise.{'point' if noise.point_sd >= noise.correlated_sd else 'correlated'}_sd_mm"


def find_scatter_warnings(
    insertions: Sequence[Insertion], noise: Noise, where: FormatPlace, is_smoothed: bool = False
) -> Iterator[ResultWarning]:
    """Yield a warning if points scatter about smooth curves by more, or less, than their stated errors.

    `is_smoothed`: the measurement smoothed the points, so that they may scatter less.
    """
    found = []
    for one in insertions:
        own = 0.0 if one.sd is None else float(np.sqrt(np.mean(one.sd**2)))
        stated = math.hypot(own, noise.point_sd, noise.correlated_sd)
        if stated >= MIN_POINT_SD_MM and not math.isnan(scatter := measure_scatter(one)):
            found.append((scatter, stated))
    if found:
        scatter, stated = np.sqrt(np.mean(np.square(found), axis=0))
        # errors that neighbours share, and those of a column, need not scatter
        too_large = scatter < MIN_SCATTER_RATIO * noise.point_sd and not is_smoothed
        if too_large or scatter > MAX_SCATTER_RATIO * stated:
            fix = "state the noise that the points have; too little of it narrows every interval"
            fix = "state the noise, or under [measurement] what smoothed the points" if too_large else fix
            yield ResultWarning(
                kind="noise",
                what=(
                    f"points scatter by {scatter:.2g} mm about smooth curves, and {stated:.2g} mm are stated"
                ),
                where=where(_name_larger_sd(noise)),
                fix=fix,
            )


def find_boundary_warnings(
    record: DatasetRecord | TrackDatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with boundaries at depths that no tissue has."""
    for name, medium in record.media.items():
        depths = [one.depth for one in insertions if one.medium == name]
        if medium.boundaries_mm and depths:
            key = f"media.{name}.boundaries_mm"
            yield from warn(doubt_layers(medium.boundaries_mm, max(depths), key), where)


def _find_own_boundary_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion]
) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with insertions whose own boundaries lie at depths that none has."""
    column = record.insertions.columns.get(BOUNDARIES_COLUMN, BOUNDARIES_COLUMN)
    for name in record.media:
        group = [one for one in listed if one.insertion.medium == name]
        deepest = max((one.insertion.depth for one in group), default=0.0)
        found = [
            (doubts, one.where)
            for one in group
            if (doubts := list(doubt_layers(one.row.boundaries or (), deepest, column)))
        ]
        for _, what, fix in found[0][0] if found else ():
            yield ResultWarning(
                kind="units",
                what=f"{what} ({len(found)} of {len(group)} rows of {name})",
                where=f"{found[0][1]}",
                fix=fix,
            )


def _find_number_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each column of deviations of the table that holds values hard to believe."""
    source = record.insertions
    for name, (least, most) in {
        "pose_shift_sd_mm": (MIN_POSE_SD_MM, MAX_POSE_SD_MM),
        "pose_angle_sd_deg": ANGLE_SD_DEG,
        ROLL_COLUMNS[1]: (0.0, MAX_ROLL_SD_DEG),
    }.items():
        values = np.array([getattr(one.insertion, NUMBER_COLUMNS[name][0]) for one in listed])
        values = np.degrees(values) if name.endswith("_deg") else values
        bad = np.flatnonzero((values > 0) & ((values < least) | (values > most)))
        if len(bad):
            constant = name in source.constants and name not in source.columns
            place = where(f"insertions.constants.{name}") if constant else listed[bad[0]].where
            yield ResultWarning(
                kind="units",
                what=(
                    f"`{source.columns.get(name, name)}` is {values[bad[0]]:g}, not "
                    f"{least:g} to {most:g} ({len(bad)} of {len(listed)} rows)"
                ),
                where=place,
                fix="check its unit",
            )
