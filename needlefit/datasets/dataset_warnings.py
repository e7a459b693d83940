"""Warn about a dataset that can be fitted all the same: placeholders, units, copies, bevel sides."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.special import bdtrc

from needlefit.datasets.columns import BOUNDARIES_COLUMN, NUMBER_COLUMNS, ROLL_COLUMNS
from needlefit.datasets.compared import (
    MAX_NAMED_INSERTIONS,
    MIN_BEND_SLOPE,
    SIGNIFICANT_SD,
    compute_deflection_sd,
    compute_entry_sd,
)
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.interpolated import find_interpolated_warnings
from needlefit.datasets.layers import (
    LENGTH_TOLERANCE_MM,
    MAX_START_DISTANCE_MM,
    MISSED_FIX,
    SAME_POINT_MM,
    ListedInsertion,
    name_small_unit,
)
from needlefit.datasets.outlying_points import OUTLIER_SD, find_point_warnings
from needlefit.datasets.planes import find_curvature_warnings, find_plane_warnings
from needlefit.datasets.points import find_rounding
from needlefit.datasets.scatter import AXIS_COSINE, SD_MM, find_axis_warnings, find_scatter_warnings
from needlefit.datasets.spellings import find_spellings
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
from needlefit.schemas.dataset import DatasetRecord, needle_key
from needlefit.schemas.mapping import MappingRecord

PLACEHOLDER = "TO FILL IN"  # marks values that a template cannot know

MAX_ROLL_SD_DEG = 45.0  #: SD of a roll beyond which nothing is known of it: a uniform one has 104
MAX_NOISE_PART = 0.5  #: SD of points over the largest deflection: beyond it no needle bends by more than 2 SD
#: of a coordinate that two needles share by errors alone, for so many pairs as a thousand datasets have
MAX_PASTED_CHANCE = 1e-9

# ---- the record


MAPPING_FILE = "mapping.toml"  # beside dataset.toml: how an import read its files


def read_assumed(record: DatasetRecord, file: Path) -> dict[str, str]:
    """Return what the import of a dataset assumed, by key, with its value and the reason."""
    path = file.parent / MAPPING_FILE
    if record.import_ is None or record.import_.mapping is None or not path.is_file():
        return {}
    mapping = load(path, MappingRecord)
    return {key: f"{mapping.values[key]}: {why}" if key in mapping.values else why
            for key, why in mapping.assumed.items()}  # fmt: skip


def find_record_warnings(
    record: DatasetRecord, file: Path, assumed: Mapping[str, str]
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
    noise = record.noise
    larger = "point" if noise.point_sd_mm >= noise.correlated_sd_mm else "correlated"
    for name, plausible, units in (
        ("registration_mean_mm", SD_MM, LENGTH_UNITS),
        (f"{larger}_sd_mm", SD_MM, LENGTH_UNITS),
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
    if guide.moved if guide else not insertion.is_posed or insertion.base_moved:
        return "unknown"
    if insertion.turns:
        return "unknown"
    x, y = insertion.points[:, 0], insertion.side * insertion.points[:, 1]
    least, measures = MIN_BEND_SLOPE * insertion.depth, []
    if len(x) > 2:  # more than a tip
        parabola = np.polyfit(x - x[0], y, 2)
        bend = float(parabola[0] * (x[-1] - x[0]) ** 2)  # the deflection from its first tangent
        scatter = float(np.sqrt(np.mean((y - np.polyval(parabola, x - x[0])) ** 2)))
        noise_sd = SIGNIFICANT_SD * float(
            np.hypot(scatter, np.hypot(noise.of(insertion).point_sd, noise.correlated_sd))
        )
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
    """Yield a warning that names the insertions, with their places, that bend away from their bevels."""
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
            what=f"bent away from the bevel side: {names} ({len(away)} of {clear} that bend clearly)",
            where=f"{away[0][1]}",
            fix=f"check `{column}` and the bevel direction of these rows",
            insertions=tuple(one.id for one, _ in away),
        )


# ---- insertions


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same centreline, point by point."""
    a, b = one.centerline, other.centerline
    return a.shape == b.shape and bool(np.abs(a - b).max() <= SAME_POINT_MM)


def _find_copy_warnings(listed: Sequence[ListedInsertion]) -> Iterator[ResultWarning]:
    """Yield a warning for each insertion that has all points of an earlier one, or whose points that has."""
    places = (entry.insertion.centerline / SAME_POINT_MM for entry in listed)
    points = [set(map(tuple, place.round().tolist())) for place in places]
    for n, later in enumerate(listed):
        same = (m for m in range(n) if points[m] <= points[n] or points[n] <= points[m])
        if (m := next(same, None)) is not None:
            names = (later.insertion.id, listed[m].insertion.id)
            what, fix = f"{' and '.join(names)} have the same points", "check whether one was exported twice"
            yield ResultWarning("copy", what, later.where, fix, names)


def _find_pasted_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning for each two needles with the same coordinate across, though not the same points.

    Errors alone make rounded coordinates differ: they are equal with a probability of at most the step over
    2 sqrt(pi) SD.
    """
    values = [one.points.values for one in listed]
    step = max(find_rounding(values), SAME_POINT_MM)
    chance = step / (2 * math.sqrt(math.pi) * noise.point_sd) if noise.point_sd else 1.0
    counts = np.array([len(points) for points in values])
    padded = np.full((len(values), max(counts), 3), np.nan)
    for points, row in zip(values, padded, strict=True):
        row[: len(points)] = points
    for n, later in enumerate(listed if chance < 1 else ()):
        entry = later.insertion.frame.rotation[:, 0]
        same = np.sum(np.abs(padded[:n] - padded[n]) < SAME_POINT_MM, axis=1)  # (n, 3)
        common = np.minimum(counts[:n], counts[n])[:, None]
        # along the needles all may be sampled alike, and what does not vary is no measurement
        is_measured = (np.abs(entry) < AXIS_COSINE) & (np.ptp(values[n], axis=0) > 0)
        is_pasted = is_measured & (same > common / 2) & (bdtrc(same - 1, common, chance) < MAX_PASTED_CHANCE)
        for m in np.flatnonzero(is_pasted.any(axis=1) & ~(same == common).all(axis=1)).tolist():
            axis = int(np.argmax(is_pasted[m]))
            names = (later.insertion.id, listed[m].insertion.id)
            what = f"{' and '.join(names)} have the same {'xyz'[axis]} at {same[m, axis]} points"
            fix = "look whether it was pasted from one into the other"
            yield ResultWarning("copy", what, later.where, fix, names)


def _find_order_warnings(listed: Sequence[ListedInsertion]) -> Iterator[ResultWarning]:
    """Yield a warning if the last points lie in one plane across the needles, and the first ones do not."""
    if len(listed) < 3:
        return
    ends = np.array([one.insertion.centerline[[0, -1]] for one in listed])
    along = (ends[:, 1] - ends[:, 0]).sum(axis=0)
    first, last = np.ptp(ends @ along, axis=0) / (np.linalg.norm(along) or 1.0)
    if first > MAX_START_DISTANCE_MM and last < LENGTH_TOLERANCE_MM:
        what = "curves seem to run from the tip to the entry: they end in a plane across them"
        fix = "check the order of the points; at an import `--set entry=last` states this one"
        yield ResultWarning("reversed", what, where=listed[0].where, fix=fix)


def _find_constant_warnings(listed: Sequence[ListedInsertion]) -> Iterator[ResultWarning]:
    """Yield a warning for each needle with one value in a coordinate that varies along most others."""
    varies = np.mean([np.ptp(one.points.values, axis=0) > 0 for one in listed], axis=0) > 0.5  # (3,)
    for one in listed:
        for axis in np.flatnonzero(varies & (np.ptp(one.points.values, axis=0) == 0)):
            value = one.points.values[0, axis]
            what = f"{one.insertion.id}: {'xyz'[axis]} is {value:g} at all points, and varies along others"
            fix = "look at its column in the source, and export its points again"
            yield ResultWarning("axis_unit", what, one.points.where(), fix, (one.insertion.id,))


def _find_entry_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield a warning that names the insertions that begin off their stated entries.

    Soft tissue gives way at the entry by nearly as much as a needle bends.
    """
    found = []
    for one in (each for each in listed if each.insertion.is_posed):
        insertion = one.insertion
        off, slope = insertion.points[0], MIN_BEND_SLOPE * insertion.depth
        give = np.array([LENGTH_TOLERANCE_MM, slope + np.ptp(insertion.points[:, 1]), slope])
        if np.any(np.abs(off) > OUTLIER_SD * compute_entry_sd(insertion, noise) + give):
            by = ", ".join(f"{x:z.1f}" for x in off)
            found.append((f"{insertion.id} by {by} mm", one.points.where()))
    if found:
        names = join_names([name for name, _ in found], MAX_NAMED_INSERTIONS)
        what = f"needles begin off their stated entries (along, toward the bevel, out of plane): {names}"
        fix = "check how their entries and first points were measured, in which frame, and pose_shift_sd_mm"
        yield ResultWarning("entry_offset", what, where=found[0][1], fix=fix)


def _find_spelling_warnings(listed: Sequence[ListedInsertion]) -> Iterator[ResultWarning]:
    """Yield a warning for each two media, and specimens, that are most likely one."""
    for what in ("medium", "specimen"):
        places = {getattr(one.insertion, what): one.where for one in reversed(listed)}
        for one, other in find_spellings(sorted(places)):
            yield ResultWarning(
                kind="spelling",
                what=f"{one!r} and {other!r} count as two, and may be one {what} in two spellings",
                where=places[other],
                fix="look at both rows; if they mean one, write one name",
            )


def find_insertion_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, file: Path
) -> Iterator[ResultWarning]:
    """Yield the warnings about insertions that have no fault."""
    where = format_place(file)
    yield from _find_spelling_warnings(listed)
    outlying = find_point_warnings([one for one in listed if one.is_curve], noise)
    yield from chain.from_iterable(outlying.values())
    # what is wrong with a point is no finding about its needle
    sound = [one for one in listed if one.insertion.id not in outlying]
    column = record.insertions.columns.get("bevel_side", "bevel_side")
    yield from find_side_warnings([(one.insertion, one.where) for one in sound], noise, column)
    yield from _find_shape_warnings([one for one in sound if one.is_curve], noise)
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
    yield from _find_noise_warnings(record, sound, noise, where)
    yield from _find_number_warnings(record, listed, where)


def _find_shape_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield the warnings about whole curves."""
    yield from find_axis_warnings(listed, noise)
    yield from _find_entry_warnings(listed, noise)
    yield from find_plane_warnings(listed, noise)
    yield from find_curvature_warnings(listed, noise)
    yield from _find_order_warnings(listed)
    yield from find_interpolated_warnings(listed)
    # values that are rounded by more than their noise may well be equal
    values = [one.points.values for one in listed]
    if values and find_rounding(values) <= max(noise.point_sd, noise.correlated_sd):
        yield from _find_copy_warnings(listed)
        yield from _find_pasted_warnings(listed, noise)
        yield from _find_constant_warnings(listed)


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
    if sd > MAX_NOISE_PART * largest:
        yield ResultWarning(
            kind="noise",
            what=f"the noise of the points, {sd:g} mm, hides deflections of {largest:.3g} mm at most",
            where=where(_name_larger_sd(noise)),
            fix="check its unit, mm; such data determine nothing",
        )
    else:
        is_smoothed = record.measurement is not None and record.measurement.operator != "none"
        curves = [one.insertion for one in listed if one.is_curve and not one.insertion.independent]
        yield from find_scatter_warnings(curves, noise, where(_name_larger_sd(noise)), is_smoothed)


def _name_larger_sd(noise: Noise) -> str:
    return f"noise.{'point' if noise.point_sd >= noise.correlated_sd else 'correlated'}_sd_mm"


def find_boundary_warnings(
    record: DatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
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
        "pose_shift_sd_mm": SD_MM,
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
