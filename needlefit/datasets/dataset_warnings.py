"""Warn about a dataset that can still be fitted: placeholders, copies, mistyped columns, bevel sides."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BASE_SHIFT_COLUMN,
    INSERTION_COLUMNS,
    POINT_COLUMNS,
    POSE_COLUMNS,
    SCAN_COLUMNS,
    SD_COLUMN,
    SHARED_COLUMN,
)
from needlefit.datasets.formats.csv import CsvTable
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.noise import MEAN_NORM_PER_SD, find_noise_warnings, find_stated_warnings
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import FormatPlace, format_place, layer_warnings, needle_warnings
from needlefit.schemas.dataset import DatasetRecord, SourceRecord, TrackDatasetRecord

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


COPY_TOLERANCE_MM = 1e-6
"""Largest distance, per axis, of two points that count as the same."""


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same centreline, point by point."""
    a, b = one.centerline, other.centerline
    if (
        a.shape != b.shape or np.abs(a[-1] - b[-1]).max() > COPY_TOLERANCE_MM
    ):  # tips differ in nearly every pair
        return False
    return bool(np.abs(a - b).max() <= COPY_TOLERANCE_MM)


def find_copy_warnings(listed: Sequence[ListedInsertion]) -> Iterator[ResultWarning]:
    """Yield a warning for each insertion that is a copy of an earlier one."""
    for n, later in enumerate(listed):
        first = next((one for one in listed[:n] if is_copy(one.insertion, later.insertion)), None)
        if first is not None:
            what = f"{later.insertion.id} has the same centreline as {first.insertion.id}, point by point"
            yield ResultWarning("copy", what, later.where, "remove one of the two, or restore its own file")


PLACEHOLDER = "TO FILL IN"
"""Marks values that a template cannot know."""

_PLACEHOLDER_PATTERN = re.compile(r"to[ _-]?fill[ _-]?in", re.IGNORECASE)
_PLACEHOLDER_FIX = "write what was measured; reports print it"


def find_record_warnings(record: DatasetRecord | TrackDatasetRecord, file: Path) -> list[ResultWarning]:
    """Return the warnings about a `dataset.toml`, without regard to its tables."""
    where = format_place(file)
    found = [*find_placeholder_keys(record, where), *needle_warnings(record.needle, where)]
    if isinstance(record, DatasetRecord):
        decisions = () if record.import_ is None else record.import_.decisions
        assumed = [f"{one.what} = {one.value}" for one in decisions if one.source == "assumption"]
        if assumed:
            what = f"the import assumed {'; '.join(assumed)}"
            fix = 'correct what is wrong, and write source = "confirmed" in its line of [import]'
            found.append(ResultWarning("assumed", what, where("import.decisions"), fix))
    return [*found, *find_stated_warnings(record.noise, record.needle.length_mm, where)]


def find_placeholder_keys(record: SourceRecord, where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning if texts of a template were not replaced."""
    keys = list(_iterate_placeholder_keys(record.model_dump(by_alias=True)))
    if keys:
        named = ", ".join(f"`{key}`" for key in keys)
        what = f'"{PLACEHOLDER}" is left in {named}'
        yield ResultWarning("placeholder", what, where(keys[0]), _PLACEHOLDER_FIX)


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
    members: Iterator[tuple[object, object]] = iter(())
    if isinstance(value, Mapping):
        members = iter(value.items())
    elif isinstance(value, list | tuple):
        members = iter(enumerate(value, start=1))
    for name, inner in members:
        yield from _iterate_placeholder_keys(inner, f"{key}.{name}" if key else str(name))


def find_insertion_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, file: Path
) -> list[ResultWarning]:
    """Return the warnings about insertions that have no fault."""
    where, insertions = format_place(file), [one.insertion for one in listed]
    column = record.insertions.columns.get("bevel_side", "bevel_side")
    results = [classify_insertion(one.insertion, one.where, noise) for one in listed]
    return [
        *find_side_warnings(results, column, "insertions"),
        *find_pooled_side_warnings(results, column),
        *find_copy_warnings(listed),
        *find_boundary_warnings(record, insertions, where),
        *_find_missed_surfaces(insertions, where),
        *find_noise_warnings(record, listed, noise, where),
    ]


def find_boundary_warnings(
    record: DatasetRecord | TrackDatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with boundaries at depths that no tissue has."""
    for name, medium in record.media.items():
        depths = [one.depth for one in insertions if one.medium == name]
        key = f"media.{name}.boundaries_mm"
        if medium.boundaries_mm and depths:
            yield from layer_warnings(medium.boundaries_mm, max(depths), where, key)


def _find_missed_surfaces(insertions: Sequence[Insertion], where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with surfaces of which no insertion meets any."""
    for name in dict.fromkeys(one.medium for one in insertions):
        group = [one for one in insertions if one.medium == name]
        if all(one.surfaces and one.sequence == (1,) for one in group):
            what = f"none of the {len(group)} insertions into {name} meets any of its surfaces"
            fix = "check that surfaces and centrelines are in one frame (LPS, RAS?), or leave them out"
            yield ResultWarning("surfaces_missed", what, where(f"media.{name}.surfaces"), fix)


MIN_SIMILARITY = 0.8
"""Ratio of `difflib` above which a name counts as a mistyped version of another."""

_UNIT = re.compile(r"_(mm|deg)$")


def find_insertion_column_warnings(
    record: DatasetRecord, names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each of these columns of the table of insertions that looks mistyped."""
    source = record.insertions
    ours = [*INSERTION_COLUMNS, SHARED_COLUMN, BASE_SHIFT_COLUMN, *SCAN_COLUMNS]
    if record.frame.pose == "free":
        ours = [name for name in ours if name not in POSE_COLUMNS]
    given = {*source.columns, *source.constants}
    used = {*source.columns.values()}
    if source.file is None:  # the rows are groups of the centreline table
        ours += [*POINT_COLUMNS, SD_COLUMN]
        given |= {*record.centerlines.columns, "id"}
        used |= {*record.centerlines.columns.values(), *record.centerlines.group_by}
    yield from _find_mistyped([name for name in ours if name not in given], used, names, path)


def find_centerline_column_warnings(
    record: DatasetRecord, names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each column of a centreline that looks mistyped."""
    source = record.centerlines
    if source.file is not None and record.insertions.file is None:
        return  # one table, which was looked through with the insertions
    missing = [name for name in (*POINT_COLUMNS, SD_COLUMN) if name not in source.columns]
    yield from _find_mistyped(missing, {*source.columns.values(), *source.group_by}, names, path)


def _find_mistyped(
    ours: Iterable[str], used: set[str], names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each name that is not used and is like one of `ours` that is absent."""
    there = set(names)
    absent = [name for name in ours if name not in there]
    known = {
        *INSERTION_COLUMNS,
        SHARED_COLUMN,
        BASE_SHIFT_COLUMN,
        *SCAN_COLUMNS,
        *POINT_COLUMNS,
        SD_COLUMN,
        *used,
    }
    for name in sorted(there - known):
        closest = max(absent, key=lambda our: _compute_similarity(name, our), default="")
        if closest and _compute_similarity(name, closest) >= MIN_SIMILARITY:
            what = f"column `{name[:60]}` is not used; did you mean `{closest}`?"
            yield ResultWarning(
                "column", what, f"{path}:1", "rename it, or map it under `columns` in dataset.toml"
            )


def _compute_similarity(one: str, other: str) -> float:
    """Return the similarity of two names, 0 to 1; a unit at the end of both does not count."""
    first, second = (re.sub(r"[\W_]", "", _UNIT.sub("", name.strip().lower())) for name in (one, other))
    if first == second:
        return 1.0
    return SequenceMatcher(None, first, second).ratio() if min(len(first), len(second)) > 2 else 0.0
