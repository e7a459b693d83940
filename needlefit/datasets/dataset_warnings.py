"""Warn about a dataset that can be fitted all the same: placeholders, units, copies, columns, bevel sides."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial import KDTree

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BASE_SHIFT_COLUMN,
    HOLE_COLUMN,
    INSERTION_COLUMNS,
    NUMBER_COLUMNS,
    POINT_COLUMNS,
    POSE_COLUMNS,
    SCAN_COLUMNS,
    SD_COLUMN,
    SHARED_COLUMN,
)
from needlefit.datasets.formats.csv import CsvTable
from needlefit.datasets.insertion import Dataset, Insertion, Noise, TipTrack
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.geometry.frames import normalize
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import (
    ANGLE_SD_DEG,
    ANGLE_UNITS,
    FormatPlace,
    doubt_layers,
    doubt_range,
    format_place,
    needle_warnings,
    warn,
)
from needlefit.schemas.dataset import DatasetRecord, TrackDatasetRecord

PLACEHOLDER = "TO FILL IN"  # marks values that a template cannot know
_PLACEHOLDER_PATTERN = re.compile(r"to[ _-]?fill[ _-]?in", re.IGNORECASE)
_PLACEHOLDER_FIX = "write what was measured; reports print it"

# Least plausible standard deviation of a centreline's points; a smaller one was written in another unit.
MIN_POINT_SD_MM = 5e-4
# Least and greatest plausible standard deviation of registration and entry pose: a smaller one was written in
# another unit, with a greater one curves cannot be compared.
MIN_POSE_SD_MM, MAX_POSE_SD_MM = 1e-3, 5.0
MAX_NOISE_FRACTION = 0.5  # fraction of the largest deflection above which noise hides the deflections
CHECK_UNIT = "check its unit, mm"

SIGNIFICANT_SD = 3.0  # standard deviations beyond which a bend is not a measurement error
# Least bend over depth that counts: entry directions are hardly known better than 0.3 degrees.
MIN_BEND_SLOPE = 0.005
# Standard deviations of a medium's insertions together beyond which bevels count as reversed; the weight of a
# single one is limited to this.
REVERSED_SD = 4.0
MIN_SAME_DIRECTION = 0.95  # length of the mean of unit vectors from which they are one direction
MAX_NAMED_INSERTIONS = 8  # number of insertions that a warning names
COPY_TOLERANCE_MM = 1e-6  # largest distance, per axis, of two points that count as the same
# Standard deviations of a point by which two measurements differ at least, and the same in mm at most.
MIN_LIKENESS_SD, MAX_LIKENESS_MM = 0.2, 0.01
SMOOTH_ORDER, MAX_SCATTER_RATIO = 3, 2.0  # of the polynomial, and scatter about it over the stated one
MIN_SIMILARITY = 0.8  # ratio of `difflib` above which a name counts as a mistyped version of another
_UNIT = re.compile(r"_(mm|deg)$")
# Decisions of an import that change the scale of mu and b, and hardly the shapes that are predicted.
_SCALES = frozenset(["needle length", "diameter", "inner diameter", "modulus"])
# Those on which a verdict depends most: which way a needle bends, and the errors of which its noise floor is.
_DECISIVE = ("bevel side", "bevel", "pose angle sd", "pose shift sd", "point sd", "pose")

# Whether it is so, and the warning then: its kind, the key that it is about, what, and how to fix it.
Check = tuple[bool, str, str, str, str]


def _warn(checks: Iterable[Check], where: FormatPlace) -> Iterator[ResultWarning]:
    return (ResultWarning(kind, what, where(key), fix) for is_so, kind, key, what, fix in checks if is_so)


# ---- the record


def list_assumptions(record: DatasetRecord | TrackDatasetRecord) -> list[tuple[str, str]]:
    """Return what the import assumed without evidence, and the values taken."""
    decisions = () if record.import_ is None else record.import_.decisions
    return [(one.what, one.value) for one in decisions if one.source == "assumption"]


def list_decisive_assumptions(record: DatasetRecord | TrackDatasetRecord) -> tuple[str, ...]:
    """Return the assumptions that a verdict depends on, all but those that only scale the parameters.

    The most decisive come first.
    """
    found = [(what, value) for what, value in list_assumptions(record) if what not in _SCALES]
    found.sort(key=lambda one: _DECISIVE.index(one[0]) if one[0] in _DECISIVE else len(_DECISIVE))
    return tuple(f"{what} = {value}" for what, value in found)


def find_record_warnings(record: DatasetRecord | TrackDatasetRecord, file: Path) -> Iterator[ResultWarning]:
    """Yield the warnings about a `dataset.toml`, without regard to its tables."""
    where = format_place(file)
    keys = list(_iterate_placeholder_keys(record.model_dump(by_alias=True)))
    assumed = [f"{what} = {value}" for what, value in list_assumptions(record)]
    left = f'"{PLACEHOLDER}" is left in {", ".join(f"`{key}`" for key in keys)}'
    yield from _warn([(bool(keys), "placeholder", "".join(keys[:1]), left, _PLACEHOLDER_FIX)], where)
    yield from needle_warnings(record.needle, where)
    what = f"the import assumed {'; '.join(assumed)}"
    fix = 'correct what is wrong, and write source = "confirmed" in its line of [import]'
    yield from _warn([(bool(assumed), "assumed", "import.decisions", what, fix)], where)
    noise = record.noise
    for name in ("heading_sd_deg", "slope_sd_deg"):
        if sd := getattr(noise, name, 0.0):
            yield from warn(doubt_range(sd, ANGLE_SD_DEG, ANGLE_UNITS, f"noise.{name}", "degrees"), where)
    point, shift = max(noise.point_sd_mm, noise.correlated_sd_mm), noise.registration_mean_mm
    length, needle = noise.correlation_length_mm, record.needle.length_mm
    metres = "mm, less than any needle is measured to: this looks like metres"
    um = "mm, more than any error of registration: this looks like um"
    point_key = "point_sd_mm" if point == noise.point_sd_mm else "correlated_sd_mm"
    for is_so, name, value, fix in (
        (0 < point < MIN_POINT_SD_MM, point_key, f"{point:g} {metres}", f"write {1e3 * point:g}"),
        (0 < shift < MIN_POSE_SD_MM, "registration_mean_mm", f"{shift:g} {metres}", f"write {1e3 * shift:g}"),
        (shift > MAX_POSE_SD_MM, "registration_mean_mm", f"{shift:g} {um}", f"write {1e-3 * shift:g}"),
        (
            noise.correlated_sd_mm > 0 and length > needle,
            "correlation_length_mm",
            f"{length:g}, longer than the needle, {needle:g} mm",
            CHECK_UNIT,
        ),
    ):
        yield from _warn([(is_so, "units", key := f"noise.{name}", f"`{key}` is {value}", fix)], where)


def find_placeholder_cells(table: CsvTable) -> Iterator[ResultWarning]:
    """Yield a warning if cells of a table still contain the placeholder."""
    found = {
        str(name): rows
        for name, column in table.cells.items()
        if _PLACEHOLDER_PATTERN.search("\n".join(column))  # one search a column: a table may be long
        and (rows := [n for n, cell in enumerate(column) if _PLACEHOLDER_PATTERN.search(cell)])
    }
    if found:
        named = ", ".join(f"`{name}`" for name in found)
        what = f'"{PLACEHOLDER}" is left in {sum(map(len, found.values()))} cells of {named}'
        where = table.where(min(rows[0] for rows in found.values()))
        yield ResultWarning("placeholder", what, where, _PLACEHOLDER_FIX)


def _iterate_placeholder_keys(value: object, key: str = "") -> Iterator[str]:
    """Yield the keys of the texts that hold the mark, however deep."""
    if isinstance(value, str) and _PLACEHOLDER_PATTERN.search(value):
        yield key
    members: Iterable[tuple[object, object]] = ()
    if isinstance(value, Mapping):
        members = value.items()
    elif isinstance(value, list | tuple):
        members = enumerate(value, start=1)
    for name, inner in members:
        yield from _iterate_placeholder_keys(inner, f"{key}.{name}" if key else str(name))


# ---- bevel sides

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
    """Return the bend result of an insertion; `where` is its position in the files, for messages.

    The deviation of `z` allows for noise of points and pose, and for entry directions off by a third of
    `MIN_BEND_SLOPE`.
    """
    z = math.nan
    if insertion.pose_source != "none" and not insertion.base_moved:
        slope = MIN_BEND_SLOPE * insertion.depth / SIGNIFICANT_SD
        z = insertion.deflection / math.hypot(_compute_deflection_sd(insertion, noise), slope)
    return BendResult(insertion.id, where, find_bend_side(insertion, noise), insertion.medium, z)


def _compute_deflection_sd(insertion: Insertion, noise: Noise) -> float:
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    pose = math.hypot(shift, insertion.pose_angle_sd * insertion.depth)
    return math.hypot(pose, noise.point_sd, noise.correlated_sd)


def find_bend_side(insertion: Insertion, noise: Noise) -> BendSide:
    """Return to which side of its bevel an insertion or a run of a tip track bends.

    Both the tip's deflection from the entry line and the curve's own bend, which no error of the entry pose
    changes, must say so. Of a run the bend alone counts: its readings are known up to a shift and a slope. A
    free shape lies by its bend, and a base or guide that moved bends the needle too: they say nothing.
    """
    track = insertion if isinstance(insertion, TipTrack) else None
    if track.guided if track else insertion.pose_source == "none" or insertion.base_moved:
        return "unknown"
    x, y = insertion.planar[:, 0], insertion.side * insertion.planar[:, 1]
    parabola = np.polyfit(x - x[0], y, 2)
    bend = float(parabola[0] * (x[-1] - x[0]) ** 2)  # the deflection from its first tangent
    scatter = float(np.sqrt(np.mean((y - np.polyval(parabola, x - x[0])) ** 2)))
    noise_sd = SIGNIFICANT_SD * float(np.hypot(scatter, np.hypot(noise.point_sd, noise.correlated_sd)))
    least = MIN_BEND_SLOPE * insertion.depth
    measures = [(bend, max(least if track else 0.5 * least, noise_sd))]
    if track is None:
        limit = max(least, SIGNIFICANT_SD * _compute_deflection_sd(insertion, noise))
        measures.append((insertion.deflection, limit))
    if all(value > limit for value, limit in measures):
        return "toward"
    return "away" if all(value < -limit for value, limit in measures) else "unknown"


def measure_out_of_plane(dataset: Dataset) -> list[tuple[str, float, float]]:
    """Return how far each tip is out of the plane of its bevel, mm, and in standard deviations; worst first.

    None of free shapes and tracks: their plane is that of the shape itself.
    """
    known = [one for one in dataset.insertions if one.pose_source != "none" and dataset.pose == "known"]
    sds = [_compute_deflection_sd(one, dataset.noise) or math.nan for one in known]
    away = [abs(float(one.out_of_plane[-1])) for one in known]
    found = [(one.id, gap, gap / sd) for one, gap, sd in zip(known, away, sds, strict=True)]
    return sorted(found, key=lambda one: -one[2])


def find_plane_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions whose tips leave the planes of their bevels.

    It proposes the direction of side 1 that fits their tips; one for each where those of single insertions
    differ.
    """
    tips: dict[str, Floats] = {}  # across the needle, turned to side 1, in the world
    places, worst = [], 0.0
    for insertion, where in ((one.insertion, one.where) for one in listed):
        away = abs(float(insertion.out_of_plane[-1])) if insertion.pose_source != "none" else 0.0
        errors = SIGNIFICANT_SD * _compute_deflection_sd(insertion, noise)
        if away > max(errors, MIN_BEND_SLOPE * insertion.depth):
            across = np.array([0.0, insertion.planar[-1, 1], insertion.out_of_plane[-1]])
            tips[insertion.id] = insertion.side * insertion.frame.rotation @ across
            places.append(where)
            worst = max(worst, away)
    if tips:
        units = [normalize(tip) for tip in tips.values()]
        is_one = float(np.linalg.norm(np.mean(units, axis=0))) > MIN_SAME_DIRECTION
        found = {"of all": np.sum([*tips.values()], axis=0)} if is_one else tips
        shown = [
            f"{', '.join(f'{value:z.2f}' for value in normalize(tip).round(2))} ({name})"
            for name, tip in found.items()
        ]
        what = (
            f"{join_names([*tips], MAX_NAMED_INSERTIONS)} leave the planes of their bevels, by up to "
            f"{worst:.1f} mm at the tip, more than {SIGNIFICANT_SD:g} standard deviations of points and pose"
        )
        fix = f"check the bevel direction and the frame; what fits: {join_names(shown, MAX_NAMED_INSERTIONS)}"
        yield ResultWarning("bevel_plane", what, places[0], fix)


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
            what = (
                f"the bevel sides of medium {medium} are probably all reversed: its {len(group)} insertions "
                f"together bend away from their bevels by {-z:.1f} standard deviations, most of all "
                f"{join_names([one.id for one in worst], MAX_NAMED_INSERTIONS)}"
            )
            yield ResultWarning("bevel_side", what, worst[0].where, f"change the sign of `{column}` there")


# ---- insertions


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same centreline, point by point."""
    a, b = one.centerline, other.centerline
    # tips differ in nearly every pair
    if a.shape != b.shape or np.abs(a[-1] - b[-1]).max() > COPY_TOLERANCE_MM:
        return False
    return bool(np.abs(a - b).max() <= COPY_TOLERANCE_MM)


def measure_scatter(insertions: Sequence[Insertion]) -> float:
    """Return the standard deviation of points about smooth curves across the planes of the needles, mm.

    No needle bends there, so that a cubic takes away all but the errors of single points. 0 of few points,
    and of free shapes.
    """
    squares, count = 0.0, 0
    for one in insertions:
        if (
            one.sd is None
            and one.pose_source != "none"
            and (free := len(one.planar) - SMOOTH_ORDER - 1) > SMOOTH_ORDER
        ):
            x = one.planar[:, 0] / one.depth
            fitted = np.polyval(np.polyfit(x, one.out_of_plane, SMOOTH_ORDER), x)
            squares, count = squares + float(np.sum((one.out_of_plane - fitted) ** 2)), count + free
    return math.sqrt(squares / count) if count else 0.0


def measure_likeness(one: Insertion, other: Insertion) -> float:
    """Return the median distance of points of the shorter curve from the nearest ones of the other, mm.

    Each curve lies in the frame of its own entry; one may be the mirror image of the other.
    """
    a, b = (np.column_stack([curve.planar, curve.out_of_plane]) for curve in (one, other))
    short, tree = (a, KDTree(b)) if len(a) < len(b) else (b, KDTree(a))
    mirrors = ([1, 1, 1], [1, -1, 1], [1, 1, -1], [1, -1, -1])
    return min(float(np.median(tree.query(short * mirror)[0])) for mirror in mirrors)


def find_insertion_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, file: Path
) -> Iterator[ResultWarning]:
    """Yield the warnings about insertions that have no fault."""
    where, insertions = format_place(file), [one.insertion for one in listed]
    column = record.insertions.columns.get("bevel_side", "bevel_side")
    results = [classify_insertion(one.insertion, one.where, noise) for one in listed]
    yield from find_side_warnings(results, column, "insertions")
    yield from find_pooled_side_warnings(results, column)
    yield from find_plane_warnings(listed, noise)
    for n, later in enumerate(listed):
        first = next((one for one in listed[:n] if is_copy(one.insertion, later.insertion)), None)
        if first is not None:
            what = f"{later.insertion.id} has the same centreline as {first.insertion.id}, point by point"
            yield ResultWarning("copy", what, later.where, "remove one of the two, or restore its own file")
            continue
        for one in (one.insertion for one in listed[:n]):
            if abs(one.depth - later.insertion.depth) > noise.point_sd:
                continue
            gap = measure_likeness(one, later.insertion)
            if gap < min(MIN_LIKENESS_SD * noise.point_sd, MAX_LIKENESS_MM):
                what = f"{later.insertion.id} and {one.id} differ by {gap:.2g} mm, which noise does not allow"
                fix = "remove one of the two if it was exported twice; else correct `noise.point_sd_mm`"
                yield ResultWarning("copy", what, later.where, fix)
                break
    yield from find_boundary_warnings(record, insertions, where)
    for name in dict.fromkeys(one.medium for one in insertions):
        group = [one for one in insertions if one.medium == name]
        if all(one.surfaces and one.sequence == (1,) for one in group):
            what = f"none of the {len(group)} insertions into {name} meets any of its surfaces"
            points = np.vstack([one.centerline[:1] for one in group])
            bounds = [surface.mesh.bounds for surface in group[0].surfaces]
            within = any(((low <= points) & (points <= high)).all() for low, high in bounds)
            fix = "check that surfaces and centrelines are in one frame (LPS, RAS?), or leave them out"
            fix = "they begin within its bounds: close the hole where they enter" if within else fix
            yield ResultWarning("surfaces_missed", what, where(f"media.{name}.surfaces"), fix)
    yield from _find_noise_warnings(record, listed, noise, where)


def _find_noise_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield the warnings that follow from stated errors and insertions together."""
    insertions = [one.insertion for one in listed]
    largest = max((abs(one.deflection) for one in insertions), default=0.0)
    sd = float(np.hypot(noise.point_sd, noise.correlated_sd))
    larger = "point_sd_mm" if noise.point_sd >= noise.correlated_sd else "correlated_sd_mm"
    shift, shift_key = record.noise.registration_mean_mm, "noise.registration_mean_mm"
    hides = (
        sd > MAX_NOISE_FRACTION * largest,
        "noise",
        f"noise.{larger}",
        f"the noise of the points, {sd:g} mm, hides deflections of {largest:.3g} mm at most",
        "check its unit, mm; such data determine nothing",
    )
    exceeds = (
        record.frame.pose == "known" and largest < shift <= MAX_POSE_SD_MM,
        "noise",
        shift_key,
        f"`{shift_key}` is {shift:g} mm, more than the largest deflection, {largest:.3g} mm",
        CHECK_UNIT,
    )
    scatter = measure_scatter(insertions)
    contradicts = (
        scatter > MAX_SCATTER_RATIO * sd > 0,
        "noise",
        f"noise.{larger}",
        f"points scatter by {scatter:.2g} mm about smooth curves, and `noise.{larger}` is {sd:.2g} mm",
        "state the noise that the points have; too little of it narrows every interval",
    )
    yield from _warn([hides, exceeds, contradicts], where)
    yield from find_spacing_warnings(noise, [one.planar[:, 0] for one in insertions], where)
    yield from _find_number_warnings(record, listed, largest, where)
    key = "noise.point_sd_mm"
    missing = (
        not noise.stated and any(one.sd is None for one in insertions),
        "no_noise",
        key,
        "no noise of the points is stated, so fits have neither noise floor nor predictive intervals",
        f"write `{key}`, the standard deviation of a point per axis; calibrate and comparisons need it",
    )
    yield from _warn([missing], where)


def find_boundary_warnings(
    record: DatasetRecord | TrackDatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with boundaries at depths that no tissue has."""
    for name, medium in record.media.items():
        depths = [one.depth for one in insertions if one.medium == name]
        if medium.boundaries_mm and depths:
            key = f"media.{name}.boundaries_mm"
            yield from warn(doubt_layers(medium.boundaries_mm, max(depths), key), where)


def find_spacing_warnings(
    noise: Noise, depths: Sequence[Floats], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning if the correlation length is below the distance of points, at `depths` (N,) each."""
    if noise.correlated_sd <= 0 or not depths:
        return
    spacing = min(float(np.median(np.abs(np.diff(one)))) for one in depths)
    if noise.correlation_length < spacing:
        key = "noise.correlation_length_mm"
        what = f"`{key}` is {noise.correlation_length:g}, shorter than points are apart, {spacing:.3g} mm"
        fix = "check its unit, mm, or state `noise.point_sd_mm`: such noise is independent"
        yield ResultWarning("units", what, where(key), fix)


def _find_number_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], largest: float, where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each column of deviations of the table that holds values hard to believe.

    `largest` is the largest deflection, mm.
    """
    source, limit = record.insertions, MAX_POSE_SD_MM
    shift, angle = "pose_shift_sd_mm", "pose_angle_sd_deg"
    few = "less than any pose is measured to, as if in metres"
    many = "more than any error of a measured pose"
    radians = "less than any direction is measured to: this looks like radians"
    least, most = ANGLE_SD_DEG
    beyond, deeper = f"more than the largest deflection, {largest:.3g} mm", "more than the insertion is deep"
    depths = [one.insertion.depth for one in listed]
    # column, from which (one for all rows, or one each) to which values are hard to believe, why, how to fix
    for name, above, up_to, why, fix in (
        (shift, 0.0, MIN_POSE_SD_MM, few, "multiply by 1000"),
        (shift, largest, limit, beyond, CHECK_UNIT),
        (shift, limit, np.inf, f"{many}: this looks like um", CHECK_UNIT),
        (angle, most, np.inf, many, "check it"),
        (angle, 0.0, least, radians, "multiply by 57.3"),
        ("boundary_sd_mm", depths, np.inf, deeper, CHECK_UNIT),
        ("depth_sd_mm", depths, np.inf, deeper, CHECK_UNIT),
    ):
        values = np.array([getattr(one.insertion, NUMBER_COLUMNS[name][0]) for one in listed])
        values = np.degrees(values) if name == angle else values
        bad = np.flatnonzero((above < values) & (values < up_to))
        if len(bad):
            constant = name in source.constants and name not in source.columns
            place = where(f"insertions.constants.{name}") if constant else listed[bad[0]].where
            what = f"`{source.columns.get(name, name)}` is {values[bad[0]]:g}, {why} "
            yield ResultWarning("units", f"{what}({len(bad)} of {len(listed)} rows)", place, fix)


# ---- columns


def find_column_warnings(
    record: DatasetRecord, names: Iterable[str], path: Path, of_points: bool = False
) -> Iterator[ResultWarning]:
    """Yield a warning for each of these columns of the table of insertions that looks mistyped.

    `of_points`: they are those of a centreline.
    """
    rows, points = record.insertions, record.centerlines
    of_curve, one_table = (*POINT_COLUMNS, SD_COLUMN), rows.file is None
    of_row = (*INSERTION_COLUMNS, SHARED_COLUMN, HOLE_COLUMN, BASE_SHIFT_COLUMN, *SCAN_COLUMNS)
    if of_points and points.file is not None and one_table:
        return  # one table, which was looked through with the insertions
    ours: list[str] = []
    given: set[str] = set()
    used: set[str] = set()
    if not of_points:
        ours += [name for name in of_row if record.frame.pose != "free" or name not in POSE_COLUMNS]
        given |= {*rows.columns, *rows.constants, *(("id",) if one_table else ())}
        used |= {*rows.columns.values()}
    if of_points or one_table:  # the rows are groups of the centreline table
        ours += of_curve
        given |= {*points.columns}
        used |= {*points.columns.values(), *points.group_by}
    there = set(names)
    absent = [name for name in ours if name not in given and name not in there]
    for name in sorted(there - {*of_row, *of_curve, *used}):
        closest = max(absent, key=lambda our, name=name: _compute_similarity(name, our), default="")  # type: ignore[misc]
        if closest and _compute_similarity(name, closest) >= MIN_SIMILARITY:
            what = f"column `{name[:60]}` is not used; did you mean `{closest}`?"
            fix = "rename it, or map it under `columns` in dataset.toml"
            yield ResultWarning("column", what, f"{path}:1", fix)


def _compute_similarity(one: str, other: str) -> float:
    """Return the similarity of two names, 0 to 1; a unit at the end of both does not count."""
    first, second = (re.sub(r"[\W_]", "", _UNIT.sub("", name.strip().lower())) for name in (one, other))
    if first == second:
        return 1.0
    return SequenceMatcher(None, first, second).ratio() if min(len(first), len(second)) > 2 else 0.0
