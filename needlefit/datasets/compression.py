"""Read a compression test: find the columns of stretch and stress, and the loading of each specimen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.compression_loading import (
    SpecimenLoading,
    SpecimenRows,
    describe_readings,
    extract_loading,
    find_loading_faults,
)
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import CsvTable, list_columns, parse_numbers, read_table
from needlefit.errors import DataError
from needlefit.mechanics.compression import STRESS_MEASURES, StressMeasure
from needlefit.project.files import sha256
from needlefit.project.input_files import is_file
from needlefit.schemas.names import EXPECTED_NAME, name_fault

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
