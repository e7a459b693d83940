"""Write a dataset in the layout of `data/README.md`: the same data gives the same bytes."""

import math
from collections.abc import Mapping, Sequence, Set
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BASE_SHIFT_COLUMN,
    INSERTION_COLUMNS,
    POINT_COLUMNS,
    SCAN_COLUMNS,
    SD_COLUMN,
    SHARED_COLUMN,
    InsertionRow,
)
from needlefit.datasets.sections import format_sections
from needlefit.errors import DataError
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.surfaces import Surface, write_surface
from needlefit.project.manifest import sha256
from needlefit.project.toml_text import dumps
from needlefit.schemas.dataset import DatasetRecord


def write_dataset(
    folder: Path,
    record: DatasetRecord,
    rows: Sequence[InsertionRow],
    centerlines: Mapping[str, ArrayLike],
    surfaces: Mapping[str, Surface] | None = None,
    checksums: bool = True,
    sections: Mapping[str, SplineSections] | None = None,
) -> Path:
    """Write a dataset into `folder` and return its `dataset.toml`.

    Parameters
    ----------
    record : DatasetRecord
        With `insertions.file` and `centerlines.pattern` (a .csv with `{id}`) set
        (`insertions.csv`, `centerlines/{id}.csv`); its checksums are replaced by those of the files written.
    rows : sequence of InsertionRow
        In the order in which the table shall list them.
    centerlines : mapping of id to (N, 3) or (N, 4) array
        World points from entry to tip, and, where it is known, the standard deviation of each in any one
        direction across the needle; mm; one for every row.
    surfaces : mapping of file to Surface
        The files that `record.media` names, e.g. `layers/phantom1_top.stl`; one for every row of the medium
        where the name holds `{id}`.
    checksums : bool
        False for files that are there to be edited.
    sections : mapping of id to SplineSections
        Of every row, world, where `record.measurement.sections` names files of them.

    Notes
    -----
    Lengths are rounded to 1e-4 mm, directions and the angles of scans to 1e-6. `dataset.toml` is written
    last, so that a folder with one is complete. Files of an earlier dataset in `folder` that this one does
    not name stay there.

    Raises
    ------
    DataError
        If a row has no centreline, or a surface that the record names is not given.
    """
    surfaces, sections = surfaces or {}, sections or {}
    table, pattern = _get_file_names(folder, record)
    _require_files(folder, record, rows, {*centerlines, *surfaces})
    files = {table: _format_rows(rows)}
    drawn = None if record.measurement is None else record.measurement.sections
    if drawn is not None:
        files |= {drawn.replace("{id}", row.id): format_sections(sections[row.id]) for row in rows}
    files |= {pattern.replace("{id}", row.id): _format_points(centerlines[row.id]) for row in rows}
    for name, text in files.items():
        _write_text(folder / name, text)
    for name, surface in surfaces.items():
        write_surface(surface, folder / name)
    sums = {name: sha256(folder / name) for name in sorted([*files, *surfaces])}
    record = record.model_copy(update={"checksums": sums if checksums else {}})
    _write_text(folder / "dataset.toml", dumps(record.model_dump(mode="json", by_alias=True)))
    return folder / "dataset.toml"


def _get_file_names(folder: Path, record: DatasetRecord) -> tuple[str, str]:
    """Return the table of insertions and the pattern of centrelines; DataError if one is not named."""
    table, pattern = record.insertions.file, record.centerlines.pattern
    if table is None or pattern is None:
        raise DataError(
            "nothing to write for the table of insertions or the centrelines",
            where=str(folder),
            expected="insertions.file and centerlines.pattern",
        )
    return table, pattern


def _require_files(
    folder: Path, record: DatasetRecord, rows: Sequence[InsertionRow], given: Set[str]
) -> None:
    """See that there is a centreline for every row, and every surface that the record names."""
    listed = [(name, surface) for name, medium in record.media.items() for surface in medium.surfaces]
    named = {surface.file for _, surface in listed if not surface.own}
    named |= {surface.file_of(row.id) for name, surface in listed for row in rows if row.medium == name}
    missing = sorted({row.id for row in rows} - given) + sorted(named - given)
    if missing:
        raise DataError(
            f"nothing to write for {', '.join(missing)}",
            where=str(folder),
            expected="a centreline for every row, every surface named",
        )


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode("utf-8"))  # bytes: no line ending of the platform's own


def _format_rows(rows: Sequence[InsertionRow]) -> str:
    lines: list[tuple[str, ...]] = [INSERTION_COLUMNS, *map(_format_cells, rows)]
    if any(row.boundary_shared_sd is not None for row in rows):
        stated = ["" if (sd := row.boundary_shared_sd) is None else _format_number(sd) for row in rows]
        lines = [(*line, more) for line, more in zip(lines, [SHARED_COLUMN, *stated], strict=True)]
    if any(row.base_moved for row in rows):
        lines = [
            (*line, more)
            for line, more in zip(lines, [BASE_SHIFT_COLUMN, *map(_format_base_moved, rows)], strict=True)
        ]
    if any(row.patient is not None for row in rows):
        lines = [
            (*line, *more) for line, more in zip(lines, [SCAN_COLUMNS, *map(_format_scan, rows)], strict=True)
        ]
    return "".join(",".join(cells) + "\n" for cells in lines)


def _format_base_moved(row: InsertionRow) -> str:
    return _format_number(row.base_moved)


def _format_scan(row: InsertionRow) -> tuple[str, ...]:
    """Return the cells of a row under `SCAN_COLUMNS`."""
    if row.patient is None:
        return ("",) * len(SCAN_COLUMNS)
    turn = Rotation.from_matrix(row.patient.rotation).as_rotvec(degrees=True)
    return *_format_vector(turn, 6), *_format_vector(row.patient.origin, 4)


def _format_cells(row: InsertionRow) -> tuple[str, ...]:
    """Return the cells of a row in the order of `INSERTION_COLUMNS`."""
    alternative = row.layers if row.layers_alternative is None else row.layers_alternative
    return (
        *(row.id, row.medium, row.specimen or row.id, str(row.layers), str(alternative)),
        *(_format_number(row.depth), f"{row.side:+d}"),
        *_format_vector(row.entry, 4),
        *_format_vector(row.direction, 6),
        *_format_vector(row.bevel, 6),
        *(
            row.pose_source,
            _format_number(row.pose_shift_sd),
            _format_number(math.degrees(row.pose_angle_sd)),
        ),
        *(_format_number(row.boundary_sd), _format_number(row.depth_sd)),
        "" if row.guide_distance is None else _format_number(row.guide_distance),
    )


def _format_points(points: ArrayLike) -> str:
    values = np.asarray(points, dtype=np.float64)
    columns = (*POINT_COLUMNS, SD_COLUMN)[: values.shape[1]]
    return "\n".join([",".join(columns), *(",".join(_format_vector(point, 4)) for point in values)]) + "\n"


def _format_vector(values: Floats | None, digits: int) -> tuple[str, ...]:
    return ("", "", "") if values is None else tuple(_format_number(float(value), digits) for value in values)


def _format_number(value: float, digits: int = 4) -> str:
    """Return `value` with fixed digits; never "-0.0000"."""
    return f"{round(value, digits) + 0.0:.{digits}f}"
