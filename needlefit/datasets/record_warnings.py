"""Warn about what a dataset states: placeholders, names, units, boundaries, surfaces, errors."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from itertools import combinations
from pathlib import Path

import numpy as np

from needlefit.datasets.columns import BOUNDARIES_COLUMN, NUMBER_COLUMNS, ROLL_COLUMNS
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import MISSED_FIX, Checked, name_small_unit
from needlefit.datasets.scatter import SD_MM, find_scatter_warnings
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.project.unit_warnings import (
    ANGLE_SD_DEG,
    ANGLE_UNITS,
    LENGTH_UNITS,
    Doubt,
    FormatPlace,
    doubt_layers,
    doubt_range,
    format_place,
    needle_warnings,
    warn,
)
from needlefit.schemas.dataset import DatasetRecord, needle_key
from needlefit.schemas.mapping import MappingRecord

PLACEHOLDER = "TO FILL IN"  # mark of values that a template cannot know
MAPPING_FILE = "mapping.toml"  # file beside dataset.toml that states how an import read its files

MAX_ROLL_SD_DEG = 45.0  #: largest SD of a roll (degrees) that means anything: a uniform one has 104
#: smallest fraction of matching letters of two names of which one was mistyped: all but one of seven
MIN_ALIKE = 0.85
MIN_LETTERS = 3  #: smallest number of letters of a name that may be mistyped: shorter names are labels
#: largest SD of points over the largest deflection: beyond it no needle bends by more than 2 SD
MAX_NOISE_PART = 0.5


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
        problem = f'"{PLACEHOLDER}" is left in {", ".join(f"`{key}`" for key in keys)}'
        fix = "write what was measured; reports print it"
        yield ResultWarning("placeholder", problem, where(keys[0]), fix)
    needles = record.all_needles
    for name, needle in needles.items():
        yield from needle_warnings(needle, where, needle_key(name))
    if record.import_ is not None and (examples := record.import_.examples):
        problem = f"simulated examples of the workbook are among the needles: {', '.join(examples)}"
        fix = "delete their rows, and import again"
        yield ResultWarning("examples", problem, where("import.examples"), fix)
    if assumed:
        listed = ", ".join(f"{key} {why.partition(': ')[0]}" for key, why in assumed.items())
        fix = "correct it, or import again with --set; then remove its line, which has the reason"
        yield ResultWarning("assumed", f"the import assumed {listed}", MAPPING_FILE, fix)
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


def find_spelling_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning for each two media, and specimens, that are most likely one."""
    for key in ("medium", "specimen"):
        places = {getattr(entry.insertion, key): entry.where for entry in reversed(checked.listed)}
        for name, other in find_spellings(sorted(places)):
            problem = f"{name!r} and {other!r} may be one {key} in two spellings"
            yield ResultWarning("spelling", problem, places[other], "if they mean one, write one name")


def find_depth_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning if the deepest insertion is so shallow that depths are likely in another unit."""
    deepest = max(checked.insertions, key=lambda insertion: insertion.depth, default=None)
    if deepest is not None and (unit := name_small_unit(deepest)):
        problem = f"the deepest insertion is {deepest.depth:.3g} mm deep: this looks like {unit}"
        fix = f"check the unit of all lengths; they are read in mm ({unit} times {LENGTH_UNITS[unit]:g})"
        yield ResultWarning("units", problem, checked.listed[0].where, fix)


def find_boundary_warnings(
    record: DatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with boundaries at depths that no tissue has."""
    for name, medium in record.media.items():
        depths = [insertion.depth for insertion in insertions if insertion.medium == name]
        if medium.boundaries_mm and depths:
            key = f"media.{name}.boundaries_mm"
            yield from warn(doubt_layers(medium.boundaries_mm, max(depths), key), where)


def find_own_boundary_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield the same of boundaries of media, and of those that rows of insertions state."""
    record = checked.record
    yield from find_boundary_warnings(record, checked.insertions, checked.where)
    column = record.insertions.columns.get(BOUNDARIES_COLUMN, BOUNDARIES_COLUMN)
    for name in record.media:
        group = [entry for entry in checked.listed if entry.insertion.medium == name]
        deepest = max((entry.insertion.depth for entry in group), default=0.0)
        doubts = [[*doubt_layers(entry.row.boundaries or (), deepest, column)] for entry in group]
        yield from _warn_of_rows(doubts, [entry.where for entry in group], f" of {name}")


def _warn_of_rows(
    doubts: Sequence[Sequence[Doubt]], places: Sequence[str], whose: str = ""
) -> Iterator[ResultWarning]:
    """Yield the doubts about the first row that has any, with how many rows have."""
    doubtful = [number for number, row_doubts in enumerate(doubts) if row_doubts]
    for _, problem, fix in doubts[doubtful[0]] if doubtful else ():
        counted = f"{problem} ({len(doubtful)} of {len(places)} rows{whose})"
        yield ResultWarning("units", counted, places[doubtful[0]], fix)


def find_surface_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield the warnings about insertions that miss surfaces, or meet them in another order."""
    insertions = checked.insertions
    for name in dict.fromkeys(insertion.medium for insertion in insertions if insertion.surfaces):
        group = [insertion for insertion in insertions if insertion.medium == name]
        yield from _find_surface_warnings(name, group, checked.where(f"media.{name}.surfaces"))


def _find_surface_warnings(name: str, group: Sequence[Insertion], where: str) -> Iterator[ResultWarning]:
    """Yield a warning if insertions miss the surfaces of their medium, or meet sheets in another order."""
    meeting = [one for one in group if len(one.sequence) > 1]
    sheets = [surface.into for surface in group[0].surfaces if surface.kind == "sheet"]
    least = max((float(one.boundaries[0]) for one in meeting), default=0.0)
    missed = [one for one in group if one not in meeting and one.depth > least]
    # the tissue's own surface leads into no other layer, and beside a solid a needle may pass
    beyond = any(surface.into > 1 for surface in group[0].surfaces)
    if missed and beyond and (not meeting or len(sheets) == len(group[0].surfaces)):
        points = np.vstack([one.centerline[:1] for one in missed])
        places = [surface.vertices for surface in group[0].surfaces]
        within = any(((one.min(axis=0) <= points) & (points <= one.max(axis=0))).all() for one in places)
        fix = "they begin within its bounds: close the hole where they enter" if within else MISSED_FIX
        problem = f"{len(missed)} of {len(group)} insertions into {name} meet none of its surfaces"
        yield ResultWarning("surfaces", problem, where, fix)
    orders = [[layer for layer in dict.fromkeys(one.sequence) if layer in sheets] for one in meeting]
    turned = [order != sorted(order) for order in orders if len(order) > 1]
    if turned and all(turned):
        order = " > ".join(map(str, max(orders)))
        problem = f"needles into {name} meet its layers in the order {order}"
        fix = "number `into` (at an import: name the files) in the order of the surfaces"
        yield ResultWarning("surfaces", problem, where, fix)


def find_number_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield a warning for each column of deviations of the table that holds values hard to believe."""
    source, listed = checked.record.insertions, checked.listed
    for name, plausible in {
        "pose_shift_sd_mm": SD_MM,
        "pose_angle_sd_deg": ANGLE_SD_DEG,
        ROLL_COLUMNS[1]: (0.0, MAX_ROLL_SD_DEG),
    }.items():
        values = np.array([getattr(insertion, NUMBER_COLUMNS[name][0]) for insertion in checked.insertions])
        values = np.degrees(values) if (unit := name.rpartition("_")[2]) == "deg" else values
        header = source.columns.get(name, name)
        doubts = [[*doubt_range(value, plausible, {}, header, unit)] if value else [] for value in values]
        is_constant = name in source.constants and name not in source.columns
        constant = [checked.where(f"insertions.constants.{name}")] * len(listed)
        yield from _warn_of_rows(doubts, constant if is_constant else [entry.where for entry in listed])


def find_noise_warnings(checked: Checked) -> Iterator[ResultWarning]:
    """Yield the warnings that follow from stated errors and insertions together."""
    record, _, noise, where, _ = checked
    insertions = checked.insertions
    largest = max((abs(insertion.deflection) for insertion in insertions), default=0.0)
    sd = float(np.hypot(noise.point_sd, noise.correlated_sd))
    if not noise.stated and not all(insertion.states_errors for insertion in insertions):
        problem = "no noise of the points is stated: there is no noise floor and no predictive interval"
        fix = "write `noise.point_sd_mm`, the standard deviation of a point per axis"
        yield ResultWarning("no_noise", problem, where("noise.point_sd_mm"), fix)
    if sd > MAX_NOISE_PART * largest:
        problem = f"the noise of the points, {sd:g} mm, hides deflections of {largest:.3g} mm at most"
        fix = "check its unit, mm, and that of the measurements"
        yield ResultWarning("noise", problem, where(_name_larger_sd(noise)), fix)
    else:
        is_smoothed = record.measurement is not None and record.measurement.operator != "none"
        curves = [curve.insertion for curve in checked.curves if not curve.insertion.independent]
        yield from find_scatter_warnings(curves, noise, where(_name_larger_sd(noise)), is_smoothed)


def _name_larger_sd(noise: Noise) -> str:
    return f"noise.{'point' if noise.point_sd >= noise.correlated_sd else 'correlated'}_sd_mm"


# ---- spellings


def find_spellings(names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of names that differ by a letter inside, or by two neighbours that are exchanged.

    Numbers distinguish names, and so do their last letters: pork a and pork b are two.
    """
    for name, other in combinations(dict.fromkeys(names), 2):
        (a, numbers), (b, its_numbers) = _split(name), _split(other)
        if numbers == its_numbers and (a == b or _are_alike(a, b)):
            yield name, other


def _split(name: str) -> tuple[str, list[str]]:
    """Return the letters of a name, and its numbers."""
    return re.sub(r"[\W\d_]", "", name.casefold()), re.findall(r"\d+", name)


def _are_alike(name: str, other: str) -> bool:
    is_label = name[:-1] == other[:-1] or name.startswith(other) or other.startswith(name)
    if is_label or min(len(name), len(other)) < MIN_LETTERS:
        return False
    exchanged = (name[:k] + name[k + 1 : k + 2] + name[k] + name[k + 2 :] for k in range(len(name)))
    return other in exchanged or SequenceMatcher(None, name, other, autojunk=False).ratio() >= MIN_ALIKE
