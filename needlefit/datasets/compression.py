"""Compression tests of a material: a table of stretch and stress -> the loading of each specimen."""

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
from needlefit.datasets.compression_loading import Record, Specimen, loading, record_faults, remarks
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import read_table
from needlefit.errors import DataError
from needlefit.mechanics.compression import Measure
from needlefit.project.files import sha256
from needlefit.project.input_files import is_file
from needlefit.schemas.names import EXPECTED_NAME, name_fault

Floats = NDArray[np.float64]


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
    if not is_file(path):
        raise DataError("there is no such file", where=str(path), fix="check the path")
    table, found = read_table(path), list[Fault]()
    columns = find_columns(table, stated, found)
    if columns is None:
        raise as_error(found, path)
    who = specimens(table, columns.sample)
    stretch, stress = stretches(table, columns, who, found), stresses(table, columns, who, found)
    if "" in who:
        row = int(np.flatnonzero(who == "")[0])
        found.append(Fault(table.where(row), f"{columns.sample} is empty", "a name", "name the specimen"))
    for n, name in enumerate(who):
        if fault := name_fault(str(name)):
            found.append(
                Fault(table.where(n), f"specimen is {str(name)!r}: {fault}", EXPECTED_NAME, "rename it")
            )
    if found:
        raise as_error(found, path)
    records = [
        Record(name, [table.where(int(n)) for n in rows], stretch[rows], stress[rows])
        for name in dict.fromkeys(who.tolist())
        for rows in [np.flatnonzero(who == name)]
    ]
    faults = [fault for record in records for fault in record_faults(record)]
    if faults:
        raise as_error(faults, path)
    return CompressionTest(
        path=path,
        digest=sha256(path),
        measure=columns.measure,
        columns=(*([columns.sample] if columns.sample else []), *columns.stretch, *columns.stress),
        specimens=tuple(loading(record) for record in records),
        remarks=tuple(remarks(records)),
    )
