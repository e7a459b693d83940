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
from needlefit.project.input_files import is_file
from needlefit.project.manifest import sha256
from needlefit.schemas.names import EXPECTED_NAME, name_fault

MIN_STRETCHES = 6
"""Least number of different stretches of a loading: two of them determine mu and alpha."""

STRETCH_TOLERANCE = 2e-3
"""An unloaded stretch may differ from 1 by this: the zero of a testing machine is not exact."""

MIN_TURN_FRACTION = 0.05
"""A movement back by more than this fraction of the whole range is a reversal of the machine, not noise."""

MIN_PRELOAD_FRACTION = 0.03
"""A stress at stretch 1 above this part of the largest is reported: it biases mu and alpha."""

MAX_OPPOSITE_FRACTION = 0.05
"""Stresses of the other sign above this fraction of the largest are not noise around zero."""


def find_stretch_faults(stretch: Floats, stress: Floats, where: str, name: str) -> Iterator[Fault]:
    """Yield the reasons why the numbers (N,) cannot be stretches of a compression test."""
    low, high = float(stretch.min()), float(stretch.max())
    here = f"stretch of specimen {name} goes from {low:g} to {high:g}"
    expected = "height now over height before: 1 unloaded, falling to e.g. 0.8"
    if high > 3:
        yield Fault(where, f"{here}: this looks like percent", expected, "divide the column by 100")
    elif _looks_like_strain(stretch, stress) and high < 1 + STRETCH_TOLERANCE:
        fix = "stretch = 1 - strain, where the strain is positive in compression"
        yield Fault(
            where, f"{here} and is about 0 where the stress is: this looks like strain", expected, fix
        )
    elif low <= 0:
        yield Fault(where, here, expected, "a height cannot reach 0: check height_mm, or the unit")
    elif low >= 1 - STRETCH_TOLERANCE and high <= 1 + STRETCH_TOLERANCE:
        yield Fault(
            where, f"{here}: it is hardly compressed", expected, "compress it further, or check the unit"
        )
    elif low >= 1 - STRETCH_TOLERANCE:
        fix = "measure in compression: the model's tissue is compressed only (stretch at most 1)"
        yield Fault(where, f"{here}: this is tension", expected, fix)
    elif high > 1 + STRETCH_TOLERANCE:
        fix = "keep the rows in compression; displacement_mm, if it is that, is positive toward the specimen"
        yield Fault(where, f"{here}: tension and compression in one test", expected, fix)


def find_stress_faults(stress: Floats, where: str, name: str) -> Iterator[Fault]:
    """Yield the reasons why the numbers (N,) cannot be stresses of one sign."""
    low, high = float(stress.min()), float(stress.max())
    largest = max(abs(low), abs(high))
    if largest == 0:
        yield Fault(
            where, f"stress of specimen {name} is 0 throughout", "a measured stress", "check the column"
        )
    elif min(abs(low), abs(high)) > MAX_OPPOSITE_FRACTION * largest and low < 0 < high:
        yield Fault(
            where,
            f"stress of specimen {name} goes from {low:.3g} to {high:.3g} MPa, through zero",
            "one sign: all positive or all negative in compression",
            "remove the offset of the load cell, or the rows in which the specimen is pulled",
        )


def find_turns(stretch: Floats) -> list[int]:
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


def compute_lost_work(stretch: Floats, stress: Floats, turn: int) -> float:
    """Return the fraction of the loading work that the unloading after row `turn` does not return."""
    back = slice(turn, None)
    low, high = float(stretch[turn]), min(float(stretch[: turn + 1].max()), float(stretch[back].max()))
    at = np.linspace(low, high, 200)
    loading, unloading = (
        np.trapezoid(np.interp(at, *_sort_by_stretch(stretch[part], stress[part])), at)
        for part in (slice(0, turn + 1), back)
    )
    return float(1 - unloading / loading)


def estimate_preload(stretch: Floats, stress: Floats) -> float:
    """Return the stress at stretch 1 of a sorted loading (N,), as a fraction of its largest stress.

    It is read from a line through the first tenth; 0 for a loading that begins far from stretch 1.
    """
    first = max(MIN_STRETCHES, len(stretch) // 10)
    if abs(1 - stretch[0]) > STRETCH_TOLERANCE:
        return 0.0
    if np.ptp(stretch[:first]) == 0:  # the machine waited: there is no line through one stretch
        at_one = stress[:first].mean()
    else:
        _, at_one = np.polyfit(stretch[:first] - 1, stress[:first], 1)
    return float(at_one / np.max(np.abs(stress)))


def _sort_by_stretch(stretch: Floats, stress: Floats) -> tuple[Floats, Floats]:
    order = np.argsort(stretch, kind="stable")
    return stretch[order], stress[order]


def _looks_like_strain(stretch: Floats, stress: Floats) -> bool:
    """Say whether the `stretch` of the least stressed row is nearer to 0 than to 1."""
    rest = abs(float(stretch[int(np.argmin(np.abs(stress)))]))
    return rest < 0.5


MAX_LOADING_POINTS = 200
"""A longer loading is averaged over neighbouring rows, so that noise of single readings does not hide slower
errors."""


@dataclass(frozen=True)
class SpecimenLoading:
    """The loading of one specimen, from the largest stretch to the smallest.

    Attributes
    ----------
    stretch : (N,) array
        Falling.
    stress : (N,) array
        MPa, negative in compression.
    """

    name: str
    stretch: Floats
    stress: Floats


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
        return (find_turns(self.stretch) or [len(self.stretch) - 1])[0]


def find_loading_faults(rows: SpecimenRows) -> list[Fault]:
    """Return why the rows are neither a loading, nor a loading and an unloading, in compression."""
    where, name = rows.where[0], rows.name
    if len(np.unique(rows.stretch)) < MIN_STRETCHES:
        what = f"specimen {name} has {len(np.unique(rows.stretch))} different stretches"
        return [
            Fault(
                where, what, f"at least {MIN_STRETCHES}", "give more of the curve, or leave the specimen out"
            )
        ]
    found = [*find_stretch_faults(rows.stretch, rows.stress, where, name)]
    found += find_stress_faults(rows.stress, where, name)
    at = find_turns(rows.stretch)
    if len(at) > 1:
        what = f"specimen {name} turns round {len(at)} times, first here"
        fix = "keep one loading (the last, if the first ones were to condition it), and sort scattered rows"
        found.append(Fault(rows.where[at[0]], what, "one loading, or a loading and its unloading", fix))
    elif 0 < rows.end < MIN_STRETCHES - 1:
        what = f"specimen {name} is loaded in {rows.end + 1} rows only, then it is unloaded"
        found.append(
            Fault(where, what, f"at least {MIN_STRETCHES} rows of loading", "give the rows of its loading")
        )
    return found


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


def describe_readings(specimens: Sequence[SpecimenRows]) -> list[str]:
    """Return sentences on what was reversed or left out, and on what distorts the fit."""
    turn_notes = [sentence for rows in specimens for sentence in _describe_turn(rows)]
    preloaded = [sentence for rows in specimens for sentence in _describe_preload(extract_loading(rows))]
    long = [f"specimen {r.name}" for r in specimens if len(r.stretch) > MAX_LOADING_POINTS]
    averaged = (
        [f"{', '.join(long)}: neighbouring rows averaged to {MAX_LOADING_POINTS} points"] if long else []
    )
    return [*_describe_sign(specimens), *turn_notes, *averaged, *preloaded]


def _describe_sign(specimens: Sequence[SpecimenRows]) -> list[str]:
    positive = [rows.name for rows in specimens if rows.stress.sum() > 0]
    if not positive:
        return []
    which = "" if len(positive) == len(specimens) else f" of {', '.join(positive)}"
    return [f"the stresses{which} are positive in the file: read as compression"]


def _describe_turn(rows: SpecimenRows) -> list[str]:
    last = len(rows.stretch) - 1
    if rows.end == last:
        return []
    if rows.end == 0:
        return [f"specimen {rows.name} runs from its smallest stretch up: read as a loading all the same"]
    lost_fraction = compute_lost_work(rows.stretch, rows.stress, rows.end)
    return [
        f"specimen {rows.name} is unloaded from {rows.where[rows.end]} on and does not give back "
        f"{100 * lost_fraction:.0f} % of the work: only its loading is used; an elastic law knows no such "
        f"loss"
    ]


def _describe_preload(one: SpecimenLoading) -> list[str]:
    part = estimate_preload(one.stretch, one.stress)
    if abs(part) < MIN_PRELOAD_FRACTION:
        return []
    return [
        f"specimen {one.name} bears {100 * abs(part):.0f} % of its largest stress at stretch 1 already: "
        "take the preload or the cell's offset off, or let the stretch begin where the stress does"
    ]


STRESS_UNITS_MPA = {"pa": 1e-6, "kpa": 1e-3, "mpa": 1.0}
SPECIMEN_COLUMNS = ("sample", "id")

STRETCH_COLUMNS = (("stretch",), ("displacement_mm", "height_mm"))
FORCE_COLUMNS = (("force_n", "area_mm2"), ("force_n", "diameter_mm"))
MAX_STRESS = 1e12

STRETCH_HELP = "`stretch`, or `displacement_mm` (the way of the plate) with `height_mm`"
STRESS_HELP = (
    "`nominal_stress_kpa` or `true_stress_kpa` (or _pa, _mpa), or `force_n` with `area_mm2` or `diameter_mm`"
)


@dataclass(frozen=True)
class CompressionColumns:
    """The columns of a compression table, by what they contain.

    Attributes
    ----------
    stretch, stress : tuple of str
        The columns each is made from.
    measure : "nominal" or "true"
        Of the stress.
    unit : float
        What the column of stresses is multiplied by to give MPa; 1 where force and area make it.
    sample : str
        Column with the specimen's name; empty: all rows are one specimen.
    """

    stretch: tuple[str, ...]
    stress: tuple[str, ...]
    measure: StressMeasure
    unit: float
    sample: str


def find_columns(
    table: CsvTable, stated: StressMeasure | None, found: list[Fault]
) -> CompressionColumns | None:
    """Return the columns of a compression table; None after a fault. `stated`: measure of `stress_kpa`."""
    names, where = list(map(str, table.cells.columns)), f"{table.path}:1"
    stretch = _select_columns(
        [option for option in STRETCH_COLUMNS if set(option) <= set(names)], "the stretch", where, found
    )
    if stretch is None:
        _note_missing_stretch(names, where, found)
    alternatives = [
        (f"{kind}stress_{unit}",) for kind in ("nominal_", "true_", "") for unit in STRESS_UNITS_MPA
    ]
    stress = _select_columns(
        [option for option in (*alternatives, *FORCE_COLUMNS) if set(option) <= set(names)],
        "the stress",
        where,
        found,
    )
    if stress is None:
        _note_missing_stress(names, where, found)
    samples = [name for name in SPECIMEN_COLUMNS if name in names]
    if not stretch or not stress:
        return None
    measure = _find_measure(stress[0], stated, where, found)
    unit = STRESS_UNITS_MPA.get(stress[0].rpartition("_")[2], 1.0)
    return (
        None
        if measure is None
        else CompressionColumns(stretch, stress, measure, unit, samples[0] if samples else "")
    )


def read_specimens(table: CsvTable, column: str) -> NDArray[np.str_]:
    """Return the specimen's name for each row (N,)."""
    if not column:
        return np.full(len(table.lines), table.path.stem)
    names: NDArray[np.str_] = table.cells[column].to_numpy(dtype=str)
    return names


def read_stretches(
    table: CsvTable, columns: CompressionColumns, names: NDArray[np.str_], found: list[Fault]
) -> Floats:
    """Return the stretch (N,); NaN where a cell is faulty."""
    if columns.stretch == ("stretch",):
        return parse_numbers(table, "stretch", found)
    displacement = parse_numbers(table, "displacement_mm", found)
    stretch: Floats = 1 - displacement / _read_size(table, "height_mm", names, found)
    return stretch


def read_stresses(
    table: CsvTable, columns: CompressionColumns, names: NDArray[np.str_], found: list[Fault]
) -> Floats:
    """Return the stress (N,), MPa, with the sign of the file; NaN where a cell is faulty."""
    values = parse_numbers(table, columns.stress[0], found, largest=MAX_STRESS)
    if len(columns.stress) == 1:
        return values * columns.unit
    size = _read_size(table, columns.stress[1], names, found)
    return values / (size if columns.stress[1] == "area_mm2" else math.pi * size**2 / 4)


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
        named = ", ".join(f"{value:g}" for value in stated) or "nowhere"
        what = f"{column} of specimen {name} is {named}"
        fix = "give the size that it had before it was compressed, in its first row or in all of them"
        found.append(Fault(table.where(int(rows[0])), what, "one number above 0 for each specimen", fix))
    return sizes


def _select_columns(
    alternatives: Sequence[tuple[str, ...]], what: str, where: str, found: list[Fault]
) -> tuple[str, ...] | None:
    """Return the only option; an empty one after a fault (several options), None if there is none."""
    if len(alternatives) < 2:
        return alternatives[0] if alternatives else None
    listed = " and by ".join(f"`{'`, `'.join(option)}`" for option in alternatives)
    found.append(
        Fault(
            where, f"{what} is given by {listed}", "one of them", "remove the columns that shall not be used"
        )
    )
    return ()


def _note_missing_stretch(names: list[str], where: str, found: list[Fault]) -> None:
    strains = [name for name in names if "strain" in name.lower()]
    fix = "name the column so, or add it"
    if strains:
        fix = f"add stretch = 1 - strain (in compression): `{strains[0]}` does not say its sign, or percent"
    found.append(Fault(where, _describe_missing("stretch", names), STRETCH_HELP, fix))


def _note_missing_stress(names: list[str], where: str, found: list[Fault]) -> None:
    near = [name for name in names if "stress" in name.lower() or "force" in name.lower()]
    fix = "name the column so, or add it"
    if near:
        fix = f"rename `{near[0]}`: its name must say the unit, and a force needs the specimen's area"
    found.append(Fault(where, _describe_missing("stress", names), STRESS_HELP, fix))


def _describe_missing(what: str, names: list[str]) -> str:
    return f"no columns give the {what}; there are {list_columns(names)}"


def _find_measure(
    column: str, stated: StressMeasure | None, where: str, found: list[Fault]
) -> StressMeasure | None:
    """Return the measure that the column states, or else the option; None after a fault."""
    named = next((kind for kind in STRESS_MEASURES if column.startswith(f"{kind}_")), None)
    named = "nominal" if column == "force_n" else named  # over the area before, by the columns' meaning
    if named is None and stated is None:
        expected = "nominal (force over the area before compression) or true (over the area at that moment)"
        fix = f"rename it to nominal_{column} or true_{column}, or give --stress nominal|true"
        found.append(Fault(where, f"`{column}` does not say which stress it is", expected, fix))
    elif named is not None and stated not in (None, named):
        fix = "leave --stress out, or rename the column"
        what = f"`{column}` is the {named} stress, but --stress is {stated}"
        found.append(Fault(where, what, "one of the two", fix))
        return None
    return named or stated


@dataclass(frozen=True)
class CompressionTest:
    """The measured loading curves of one material, read from one file.

    Attributes
    ----------
    digest : str
        SHA-256 of the file.
    measure : "nominal" or "true"
        Of all its stresses.
    columns : tuple of str
        The columns that were read.
    specimens : tuple of Specimen
    warnings : tuple of str
        What was left out or reversed, in sentences.
    """

    path: Path
    digest: str
    measure: StressMeasure
    columns: tuple[str, ...]
    specimens: tuple[SpecimenLoading, ...]
    warnings: tuple[str, ...]


def read_compression(path: Path, stated: StressMeasure | None = None) -> CompressionTest:
    """Read a compression test; `stated` is the stress measure (true or nominal) of a column `stress_kpa`.

    Columns: `stretch`, or `displacement_mm` and `height_mm`; `nominal_stress_kpa` or `true_stress_kpa` (or
    _pa, _mpa), or `force_n` and `area_mm2` or `diameter_mm`; `sample` or `id` tells specimens apart.

    Raises
    ------
    DataError
        Listing every fault: missing or doubtful columns, cells, strains for stretches, tension, cycles.
    """
    if not is_file(path):
        raise DataError("there is no such file", where=str(path), fix="check the path")
    table, found = read_table(path), list[Fault]()
    columns = find_columns(table, stated, found)
    if columns is None:
        raise as_error(found, path)
    specimen_names = read_specimens(table, columns.sample)
    stretch, stress = (
        read_stretches(table, columns, specimen_names, found),
        read_stresses(table, columns, specimen_names, found),
    )
    if "" in specimen_names:
        row = int(np.flatnonzero(specimen_names == "")[0])
        found.append(Fault(table.where(row), f"{columns.sample} is empty", "a name", "name the specimen"))
    for n, name in enumerate(specimen_names):
        if fault := name_fault(str(name)):
            found.append(
                Fault(table.where(n), f"specimen is {str(name)!r}: {fault}", EXPECTED_NAME, "rename it")
            )
    if found:
        raise as_error(found, path)
    records = [
        SpecimenRows(name, [table.where(int(n)) for n in rows], stretch[rows], stress[rows])
        for name in dict.fromkeys(specimen_names.tolist())
        for rows in [np.flatnonzero(specimen_names == name)]
    ]
    faults = [fault for record in records for fault in find_loading_faults(record)]
    if faults:
        raise as_error(faults, path)
    return CompressionTest(
        path=path,
        digest=sha256(path),
        measure=columns.measure,
        columns=(*([columns.sample] if columns.sample else []), *columns.stretch, *columns.stress),
        specimens=tuple(extract_loading(record) for record in records),
        warnings=tuple(describe_readings(records)),
    )
