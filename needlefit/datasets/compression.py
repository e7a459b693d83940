"""Read a compression test: its columns of stretch and stress, and the loading of each specimen."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import CsvTable, list_columns, parse_numbers, read_table
from needlefit.errors import DataError
from needlefit.mechanics.compression import STRESS_MEASURES, StressMeasure
from needlefit.project.folders import sha256
from needlefit.project.input_files import is_file
from needlefit.schemas.names import EXPECTED_NAME, name_fault

MIN_STRETCHES = 6  # least number of different stretches of a loading: two of them determine mu and alpha
# An unloaded stretch may differ from 1 by this: the zero of a testing machine is not exact.
STRETCH_TOLERANCE = 2e-3
# A movement back by more than this fraction of the whole range is a reversal of the machine, not noise.
MIN_TURN_FRACTION = 0.05
# A stress at stretch 1 above this part of the largest is reported: it biases mu and alpha.
MIN_PRELOAD_FRACTION = 0.03
# Stresses of the other sign above this fraction of the largest are not noise around zero.
MAX_OPPOSITE_FRACTION = 0.05
# A longer loading is averaged over neighbouring rows, so that noise of single readings does not hide slower
# errors.
MAX_LOADING_POINTS = 200
MAX_STRESS = 1e12
STRESS_UNITS_MPA = {"pa": 1e-6, "kpa": 1e-3, "mpa": 1.0}
SPECIMEN_COLUMNS = ("sample", "id")

STRETCH_COLUMNS = (("stretch",), ("displacement_mm", "height_mm"))
STRESS_COLUMNS = (
    *((f"{kind}stress_{unit}",) for kind in ("nominal_", "true_", "") for unit in STRESS_UNITS_MPA),
    *(("force_n", "area_mm2"), ("force_n", "diameter_mm")),
)

STRETCH_HELP = "`stretch`, or `displacement_mm` (the way of the plate) with `height_mm`"
STRESS_HELP = (
    "`nominal_stress_kpa` or `true_stress_kpa` (or _pa, _mpa), or `force_n` with `area_mm2` or `diameter_mm`"
)


@dataclass(frozen=True)
class SpecimenLoading:
    """The loading of one specimen."""

    name: str
    stretch: Floats  # (N,); from the largest, about 1, downward
    stress: Floats  # (N,); MPa, negative in compression


@dataclass(frozen=True)
class CompressionTest:
    """The measured loading curves of one material, read from one file."""

    path: Path
    digest: str  # SHA-256 of the file
    measure: StressMeasure  # of all its stresses
    columns: tuple[str, ...]  # the columns that were read
    specimens: tuple[SpecimenLoading, ...]
    warnings: tuple[str, ...]  # what was left out or reversed, in sentences


def read_compression(path: Path, stated: StressMeasure | None = None) -> CompressionTest:
    """Read a compression test; `stated` is the stress measure (true or nominal) of a column `stress_kpa`.

    Columns: `stretch`, or `displacement_mm` and `height_mm`; `nominal_stress_kpa` or `true_stress_kpa` (or
    _pa, _mpa), or `force_n` and `area_mm2` or `diameter_mm`; `sample` or `id` tells specimens apart.
    DataError listing every fault: missing or doubtful columns, cells, strains for stretches, tension, cycles.
    """
    if not is_file(path):
        raise DataError("there is no such file", where=str(path), fix="check the path")
    table, found = read_table(path), list[Fault]()
    stretch_columns, stress_columns = _find_columns(table, found)
    are_there = stretch_columns and stress_columns
    measure = _find_measure(stress_columns[0], stated, table, found) if are_there else None
    if measure is None:
        raise as_error(found, path)
    sample = next((name for name in SPECIMEN_COLUMNS if name in table.cells), "")
    names = np.array(table.cells[sample] if sample else [path.stem] * len(table.lines), dtype=str)
    stretch = _read_stretches(table, stretch_columns, names, found)
    stress = _read_stresses(table, stress_columns, names, found)
    if "" in names:
        row = int(np.flatnonzero(names == "")[0])
        found.append(Fault(table.where(row), f"{sample} is empty", "a name", "name the specimen"))
    for n, name in enumerate(map(str, names)):
        if fault := name_fault(name):
            found.append(Fault(table.where(n), f"specimen is {name!r}: {fault}", EXPECTED_NAME, "rename it"))
    if found:
        raise as_error(found, path)
    records = [
        SpecimenRows(name, [table.where(int(n)) for n in rows], stretch[rows], stress[rows])
        for name in dict.fromkeys(names.tolist())
        for rows in [np.flatnonzero(names == name)]
    ]
    faults = [fault for record in records for fault in find_loading_faults(record)]
    if faults:
        raise as_error(faults, path)
    return CompressionTest(
        path=path,
        digest=sha256(path),
        measure=measure,
        columns=(*([sample] if sample else []), *stretch_columns, *stress_columns),
        specimens=tuple(extract_loading(record) for record in records),
        warnings=tuple(_describe_readings(records)),
    )


# ---- columns


def _find_columns(table: CsvTable, found: list[Fault]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns that stretch and stress are made from; an empty tuple after a fault."""
    names, where = list(map(str, table.cells.columns)), f"{table.path}:1"
    chosen = []
    for what, options, expected, words, fix in (
        (
            "stretch",
            STRETCH_COLUMNS,
            STRETCH_HELP,
            ("strain",),
            "add stretch = 1 - strain (in compression): `{}` does not say its sign, or percent",
        ),
        (
            "stress",
            STRESS_COLUMNS,
            STRESS_HELP,
            ("stress", "force"),
            "rename `{}`: its name must say the unit, and a force needs the specimen's area",
        ),
    ):
        there = [option for option in options if set(option) <= set(names)]
        if not there:
            near = next((name for name in names if any(word in name.lower() for word in words)), None)
            what = f"no columns give the {what}; there are {list_columns(names)}"
            fix = "name the column so, or add it" if near is None else fix.format(near)
            found.append(Fault(where, what, expected, fix))
        if len(there) > 1:
            listed = " and by ".join(f"`{'`, `'.join(option)}`" for option in there)
            fix = "remove the columns that shall not be used"
            found.append(Fault(where, f"the {what} is given by {listed}", "one of them", fix))
        chosen.append(there[0] if len(there) == 1 else ())
    return chosen[0], chosen[1]


def _find_measure(
    column: str, stated: StressMeasure | None, table: CsvTable, found: list[Fault]
) -> StressMeasure | None:
    """Return the measure that the column states, or else the option; None after a fault."""
    where = f"{table.path}:1"
    named = next((kind for kind in STRESS_MEASURES if column.startswith(f"{kind}_")), None)
    named = "nominal" if column == "force_n" else named  # over the area before, by the columns' meaning
    if named is None and stated is None:
        expected = "nominal (force over the area before compression) or true (over the area at that moment)"
        fix = f"rename it to nominal_{column} or true_{column}, or give --stress nominal|true"
        found.append(Fault(where, f"`{column}` does not say which stress it is", expected, fix))
    elif named is not None and stated not in (None, named):
        what = f"`{column}` is the {named} stress, but --stress is {stated}"
        found.append(Fault(where, what, "one of the two", "leave --stress out, or rename the column"))
        return None
    return named or stated


def _read_stretches(
    table: CsvTable, columns: tuple[str, ...], names: NDArray[np.str_], found: list[Fault]
) -> Floats:
    """Return the stretch (N,); NaN where a cell is faulty."""
    values = parse_numbers(table, columns[0], found)
    return values if len(columns) == 1 else 1 - values / _read_size(table, columns[1], names, found)


def _read_stresses(
    table: CsvTable, columns: tuple[str, ...], names: NDArray[np.str_], found: list[Fault]
) -> Floats:
    """Return the stress (N,), MPa, with the sign of the file; NaN where a cell is faulty."""
    values = parse_numbers(table, columns[0], found, largest=MAX_STRESS)
    if len(columns) == 1:
        return values * STRESS_UNITS_MPA[columns[0].rpartition("_")[2]]
    size = _read_size(table, columns[1], names, found)
    return values / (size if columns[1] == "area_mm2" else math.pi * size**2 / 4)


def _read_size(table: CsvTable, column: str, names: NDArray[np.str_], found: list[Fault]) -> Floats:
    """Return a size of the specimen for each row (N,); NaN where it is not one number above 0."""
    given = parse_numbers(table, column, found, optional=True)
    sizes = np.full(len(given), np.nan)
    for name in dict.fromkeys(names.tolist()):
        rows = np.flatnonzero(names == name)
        stated = np.unique(given[rows][np.isfinite(given[rows])])
        if len(stated) == 1 and stated[0] > 0:
            sizes[rows] = stated[0]
            continue
        what = f"{column} of specimen {name} is {', '.join(f'{v:g}' for v in stated) or 'nowhere'}"
        fix = "give the size that it had before it was compressed, in its first row or in all of them"
        found.append(Fault(table.where(int(rows[0])), what, "one number above 0 for each specimen", fix))
    return sizes


# ---- the loading of a specimen


@dataclass(frozen=True)
class SpecimenRows:
    """The rows of one specimen as they are in the file: positions, stretch (N,), stress (N,) in MPa."""

    name: str
    where: list[str]
    stretch: Floats
    stress: Floats

    @property
    def end(self) -> int:
        """The row at which the loading ends; 0 where the table begins at the largest compression."""
        return (_find_turns(self.stretch) or [len(self.stretch) - 1])[0]


def _find_turns(stretch: Floats) -> list[int]:
    """Return the rows at which the testing machine reverses; reversals within noise do not count."""
    wide = MIN_TURN_FRACTION * float(np.ptp(stretch))
    # -1: loading comes first, and stretch falls as the specimen is compressed.
    found, extreme, direction = [], 0, -1
    for n in range(1, len(stretch)):
        if direction * (stretch[n] - stretch[extreme]) > 0:
            extreme = n
        elif direction * (stretch[extreme] - stretch[n]) > wide:
            found.append(extreme)
            direction, extreme = -direction, n
    return found


def find_loading_faults(rows: SpecimenRows) -> list[Fault]:
    """Return why the rows are neither a loading, nor a loading and an unloading, in compression."""
    where, name = rows.where[0], rows.name
    count = len(np.unique(rows.stretch))
    if count < MIN_STRETCHES:
        fix = "give more of the curve, or leave the specimen out"
        what = f"specimen {name} has {count} different stretches"
        return [Fault(where, what, f"at least {MIN_STRETCHES}", fix)]
    found = [*_find_stretch_faults(rows), *_find_stress_faults(rows)]
    turns = _find_turns(rows.stretch)
    if len(turns) > 1:
        what = f"specimen {name} turns round {len(turns)} times, first here"
        fix = "keep one loading (the last, if the first ones were to condition it), and sort scattered rows"
        found.append(Fault(rows.where[turns[0]], what, "one loading, or a loading and its unloading", fix))
    elif 0 < rows.end < MIN_STRETCHES - 1:
        what = f"specimen {name} is loaded in {rows.end + 1} rows only, then it is unloaded"
        expected = f"at least {MIN_STRETCHES} rows of loading"
        found.append(Fault(where, what, expected, "give the rows of its loading"))
    return found


def _find_stretch_faults(rows: SpecimenRows) -> Iterator[Fault]:
    """Yield the first reason why the numbers cannot be stretches of a compression test."""
    low, high = float(rows.stretch.min()), float(rows.stretch.max())
    unloaded = abs(float(rows.stretch[int(np.argmin(np.abs(rows.stress)))]))
    at_most_1, falls = high <= 1 + STRETCH_TOLERANCE, low < 1 - STRETCH_TOLERANCE
    reasons = (
        (high > 3, ": this looks like percent", "divide the column by 100"),
        (
            unloaded < 0.5 and high < 1 + STRETCH_TOLERANCE,  # nearer to 0 than to 1
            " and is about 0 where the stress is: this looks like strain",
            "stretch = 1 - strain, where the strain is positive in compression",
        ),
        (low <= 0, "", "a height cannot reach 0: check height_mm, or the unit"),
        (not falls and at_most_1, ": it is hardly compressed", "compress it further, or check the unit"),
        (
            not falls,
            ": this is tension",
            "measure in compression: the model's tissue is compressed only (stretch at most 1)",
        ),
        (
            not at_most_1,
            ": tension and compression in one test",
            "keep the rows in compression; displacement_mm, if it is that, is positive toward the specimen",
        ),
    )
    for is_so, reason, fix in reasons:
        if is_so:
            what = f"stretch of specimen {rows.name} goes from {low:g} to {high:g}{reason}"
            expected = "height now over height before: 1 unloaded, falling to e.g. 0.8"
            yield Fault(rows.where[0], what, expected, fix)
            return


def _find_stress_faults(rows: SpecimenRows) -> Iterator[Fault]:
    """Yield the reason why the numbers cannot be stresses of one sign."""
    low, high = float(rows.stress.min()), float(rows.stress.max())
    here = f"stress of specimen {rows.name}"
    if low == high == 0:
        yield Fault(rows.where[0], f"{here} is 0 throughout", "a measured stress", "check the column")
    elif low < 0 < high and min(-low, high) > MAX_OPPOSITE_FRACTION * max(-low, high):
        what = f"{here} goes from {low:.3g} to {high:.3g} MPa, through zero"
        fix = "remove the offset of the load cell, or the rows in which the specimen is pulled"
        yield Fault(rows.where[0], what, "one sign: all positive or all negative in compression", fix)


def extract_loading(rows: SpecimenRows) -> SpecimenLoading:
    """Return the loading alone: sorted, averaged to at most `MAX_LOADING_POINTS`, with negative stresses."""
    loading_rows = slice(0, rows.end + 1) if rows.end else slice(None)
    stretch, stress = rows.stretch[loading_rows], rows.stress[loading_rows]
    # Stable: rows with equal stretch keep the order of the file.
    order = np.argsort(-stretch, kind="stable")
    sign = -1.0 if stress.sum() > 0 else 1.0
    pieces = np.array_split(order, min(len(order), MAX_LOADING_POINTS))
    means = np.array([(np.mean(stretch[piece]), sign * np.mean(stress[piece])) for piece in pieces])  # (N, 2)
    return SpecimenLoading(rows.name, means[:, 0], means[:, 1])


# ---- what is reported


def _describe_readings(specimens: Sequence[SpecimenRows]) -> Iterator[str]:
    """Yield sentences on what was reversed or left out, and on what distorts the fit."""
    positive = [rows.name for rows in specimens if rows.stress.sum() > 0]
    if positive:
        which = "" if len(positive) == len(specimens) else f" of {', '.join(positive)}"
        yield f"the stresses{which} are positive in the file: read as compression"
    for rows in specimens:
        if rows.end == 0:
            yield f"specimen {rows.name} runs from its smallest stretch up: read as a loading all the same"
        elif rows.end < len(rows.stretch) - 1:
            lost = 100 * _compute_lost_work(rows.stretch, rows.stress, rows.end)
            yield (
                f"specimen {rows.name} is unloaded from {rows.where[rows.end]} on and does not give back "
                f"{lost:.0f} % of the work: only its loading is used; an elastic law knows no such loss"
            )
    long = [f"specimen {rows.name}" for rows in specimens if len(rows.stretch) > MAX_LOADING_POINTS]
    if long:
        yield f"{', '.join(long)}: neighbouring rows averaged to {MAX_LOADING_POINTS} points"
    for rows in specimens:
        part = abs(_estimate_preload(extract_loading(rows)))
        if part >= MIN_PRELOAD_FRACTION:
            yield (
                f"specimen {rows.name} bears {100 * part:.0f} % of its largest stress at stretch 1 already: "
                "take the preload or the cell's offset off, or let the stretch begin where the stress does"
            )


def _compute_lost_work(stretch: Floats, stress: Floats, turn: int) -> float:
    """Return the fraction of the loading work that the unloading after row `turn` does not return."""
    parts = (slice(0, turn + 1), slice(turn, None))
    at = np.linspace(float(stretch[turn]), min(float(stretch[part].max()) for part in parts), 200)
    works = []
    for part in parts:
        order = np.argsort(stretch[part], kind="stable")
        works.append(np.trapezoid(np.interp(at, stretch[part][order], stress[part][order]), at))
    return float(1 - works[1] / works[0])


def _estimate_preload(loading: SpecimenLoading) -> float:
    """Return the stress at stretch 1 of a sorted loading, as a fraction of its largest stress.

    It is read from a line through the first tenth; 0 for a loading that begins far from stretch 1.
    """
    stretch, stress = loading.stretch, loading.stress
    first = max(MIN_STRETCHES, len(stretch) // 10)
    if abs(1 - stretch[0]) > STRETCH_TOLERANCE:
        return 0.0
    if np.ptp(stretch[:first]) == 0:  # the machine waited: there is no line through one stretch
        at_one = stress[:first].mean()
    else:
        _, at_one = np.polyfit(stretch[:first] - 1, stress[:first], 1)
    return float(at_one / np.max(np.abs(stress)))
