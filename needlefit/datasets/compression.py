"""Compression tests of a material: a table of stretch and stress -> the loading of each specimen."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.compression_columns import (
    find_columns,
    specimens,
    stresses,
    stretches,
)
from needlefit.datasets.compression_faults import (
    FEWEST,
    lost_work,
    stress_faults,
    stretch_faults,
    turns,
)
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import read_table
from needlefit.errors import DataError
from needlefit.mechanics.compression import Measure

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Specimen:
    """The loading of one specimen, from the largest stretch to the smallest.

    Attributes
    ----------
    name : str
    stretch : (N,) array
        Falling.
    stress : (N,) array
        MPa, negative in compression.
    """

    name: str
    stretch: Floats
    stress: Floats


@dataclass(frozen=True)
class CompressionTest:
    """What a file says of one material.

    Attributes
    ----------
    path : Path
    digest : str
        SHA-256 of the file.
    measure : "nominal" or "true"
        Of all its stresses.
    columns : tuple of str
        The columns that were read.
    specimens : tuple of Specimen
    remarks : tuple of str
        What was left out, or turned, in sentences.
    """

    path: Path
    digest: str
    measure: Measure
    columns: tuple[str, ...]
    specimens: tuple[Specimen, ...]
    remarks: tuple[str, ...]


def read_compression(path: Path, stated: Measure | None = None) -> CompressionTest:
    """Read a compression test; `stated` says which stress a column `stress_kpa` holds.

    Columns: `stretch`, or `displacement_mm` and `height_mm`; `nominal_stress_kpa` or `true_stress_kpa` (or
    _pa, _mpa), or `force_n` and `area_mm2` or `diameter_mm`; `sample` or `id` tells specimens apart.

    Raises
    ------
    DataError
        Listing every fault: missing or doubtful columns, cells, strains for stretches, tension, cycles.
    """
    if not path.is_file():
        raise DataError("there is no such file", where=str(path), mend="check the path")
    table, found = read_table(path), list[Fault]()
    columns = find_columns(table, stated, found)
    if columns is None:
        raise as_error(found, path)
    who = specimens(table, columns.sample)
    stretch, stress = stretches(table, columns, who, found), stresses(table, columns, who, found)
    if "" in who:
        row = int(np.flatnonzero(who == "")[0])
        found.append(Fault(table.where(row), f"{columns.sample} is empty", "a name", "name the specimen"))
    if found:
        raise as_error(found, path)
    records = [
        _Record(name, [table.where(int(n)) for n in rows], stretch[rows], stress[rows])
        for name in dict.fromkeys(who.tolist())
        for rows in [np.flatnonzero(who == name)]
    ]
    faults = [fault for record in records for fault in _faults(record)]
    if faults:
        raise as_error(faults, path)
    return CompressionTest(
        path=path,
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
        measure=columns.measure,
        columns=(*([columns.sample] if columns.sample else []), *columns.stretch, *columns.stress),
        specimens=tuple(_loading(record) for record in records),
        remarks=(*_sign_said(records), *(said for record in records for said in _turn_said(record))),
    )


@dataclass(frozen=True)
class _Record:
    """The rows of one specimen as they stand in the file: places, stretch (N,), stress (N,) in MPa."""

    name: str
    where: list[str]
    stretch: Floats
    stress: Floats

    @property
    def end(self) -> int:
        """The row at which the loading ends; 0 where the table runs from the deepest row up."""
        return (turns(self.stretch) or [len(self.stretch) - 1])[0]


def _faults(record: _Record) -> list[Fault]:
    where, name = record.where[0], record.name
    if len(np.unique(record.stretch)) < FEWEST:
        what = f"specimen {name} has {len(np.unique(record.stretch))} different stretches"
        return [Fault(where, what, f"at least {FEWEST}", "give more of the curve, or leave the specimen out")]
    found = [*stretch_faults(record.stretch, record.stress, where, name)]
    found += stress_faults(record.stress, where, name)
    at = turns(record.stretch)
    if len(at) > 1:
        what = f"specimen {name} turns round {len(at)} times, first here"
        mend = "keep one loading (the last, if the first ones were to condition it), and sort scattered rows"
        found.append(Fault(record.where[at[0]], what, "one loading, or a loading and its unloading", mend))
    elif 0 < record.end < FEWEST - 1:
        what = f"specimen {name} is loaded in {record.end + 1} rows only, then it is unloaded"
        found.append(Fault(where, what, f"at least {FEWEST} rows of loading", "give the rows of its loading"))
    return found


def _loading(record: _Record) -> Specimen:
    """Return the loading alone, sorted, its stresses negative."""
    kept = slice(0, record.end + 1) if record.end else slice(None)
    stretch, stress = record.stretch[kept], record.stress[kept]
    order = np.argsort(-stretch, kind="stable")
    sign = -1.0 if stress.sum() > 0 else 1.0
    return Specimen(record.name, stretch[order], sign * stress[order])


def _sign_said(records: list[_Record]) -> list[str]:
    positive = [record.name for record in records if record.stress.sum() > 0]
    if not positive:
        return []
    which = "" if len(positive) == len(records) else f" of {', '.join(positive)}"
    return [f"the stresses{which} are positive in the file: read as compression"]


def _turn_said(record: _Record) -> list[str]:
    last = len(record.stretch) - 1
    if record.end == last:
        return []
    if record.end == 0:
        return [f"specimen {record.name} runs from its smallest stretch up: read as a loading all the same"]
    lost = lost_work(record.stretch, record.stress, record.end)
    return [
        f"specimen {record.name} is unloaded from {record.where[record.end]} on and does not give back "
        f"{100 * lost:.0f} % of the work: only its loading is used; an elastic law knows no such loss"
    ]
