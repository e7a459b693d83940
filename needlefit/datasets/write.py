"""Write a dataset in the layout of `data/README.md`: the same data gives the same bytes."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BASE_SHIFT_COLUMN,
    BEVEL_COLUMNS,
    BOUNDARIES_COLUMN,
    CURVATURE_COLUMNS,
    DIRECTION_COLUMNS,
    ENTRY_COLUMNS,
    HOLE_COLUMN,
    INSERTION_COLUMNS,
    NEEDLE_COLUMN,
    NO_BOUNDARY,
    NUMBER_COLUMNS,
    OBSERVATION_COLUMN,
    OBSERVATION_PREFIX,
    POINT_COLUMNS,
    POINT_SD_COLUMN,
    ROLL_COLUMNS,
    SCAN_COLUMNS,
    SCAN_ROTATION_COLUMNS,
    SCAN_SHIFT_COLUMNS,
    SD_COLUMN,
    SHARED_COLUMN,
    TEXT_COLUMNS,
    TIP_COLUMNS,
    TURN_COLUMNS,
    InsertionRow,
)
from needlefit.datasets.sections import format_sections
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.surfaces import Surface, write_surface
from needlefit.project.folders import sha256
from needlefit.project.toml import dumps
from needlefit.schemas.dataset import DatasetRecord

# Columns that are written where a row states anything else than the default of their field.
OPTIONAL_COLUMNS = (
    *(NEEDLE_COLUMN, BOUNDARIES_COLUMN, SHARED_COLUMN, HOLE_COLUMN),
    *(*TIP_COLUMNS, POINT_SD_COLUMN, OBSERVATION_COLUMN, BASE_SHIFT_COLUMN),
)


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

    Lengths are rounded to 1e-4 mm, directions and the angles of scans to 1e-6. `dataset.toml` is written
    last, so that a folder with one is complete. Files of an earlier dataset in `folder` that this one does
    not name stay there.

    `record`: with `insertions.file` and, but of tips or curvatures alone, `centerlines.pattern` (a .csv with
    `{id}`) set (`insertions.csv`, `centerlines/{id}.csv`); its checksums are replaced by those of the files
    written.
    `rows`: in the order in which the table shall list them.
    `centerlines`: (N, 3) or (N, 4); world points from entry to tip, and, where it is known, the standard
    deviation of each in any one direction across the needle; mm; of a row without one a tip or curvatures
    were measured.
    `surfaces`: the files that `record.media` names, e.g. `layers/phantom1_top.stl`; one for every row of the
    medium where the name holds `{id}`.
    `checksums`: False for files that are there to be edited.
    `sections`: of every row, world, where `record.measurement.sections` names files of them.
    """
    surfaces, sections = surfaces or {}, sections or {}
    listed = record.insertions
    pattern = None if record.centerlines is None else record.centerlines.pattern
    assert (pattern is None) == (record.centerlines is None), "a file for each"
    files = {} if listed.file is None else {listed.file: _format_rows(rows)}
    if (turns := listed.turns) is not None:
        turned = ((row.id, depth, math.degrees(roll)) for row in rows for depth, roll in row.turns)
        cells = ((name, _format_number(depth), _format_number(roll)) for name, depth, roll in turned)
        files[turns] = _to_csv([TURN_COLUMNS, *cells])
    if (curvature := listed.curvature) is not None:
        sensed = ((row.id, row.curvature) for row in rows if row.curvature is not None)
        lines = (
            (name, *(f"{value:.7g}" for value in sensor)) for name, ones in sensed for sensor in ones.tolist()
        )
        files[curvature] = _to_csv([CURVATURE_COLUMNS, *lines])
    drawn = None if record.measurement is None else record.measurement.sections
    if drawn is not None:
        files |= {drawn.replace("{id}", row.id): format_sections(sections[row.id]) for row in rows}
    for row in (row for row in rows if row.id in centerlines):
        values = np.asarray(centerlines[row.id], dtype=np.float64)
        columns = (*POINT_COLUMNS, SD_COLUMN)[: values.shape[1]]
        table_rows = [columns, *(_format_vector(point, 4) for point in values)]
        files[str(pattern).replace("{id}", row.id)] = _to_csv(table_rows)
    for name, text in files.items():
        _write_text(folder / name, text)
    for name, surface in surfaces.items():
        write_surface(surface, folder / name)
    sums = {name: sha256(folder / name) for name in sorted([*files, *surfaces])}
    record = record.model_copy(update={"checksums": sums if checksums else {}})
    _write_text(folder / "dataset.toml", dumps(record.model_dump(mode="json", by_alias=True)))
    return folder / "dataset.toml"


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode("utf-8"))  # bytes: no line ending of the platform's own


def _to_csv(lines: Sequence[Sequence[str]]) -> str:
    return "".join(f"{','.join(cells)}\n" for cells in lines)


def _format_rows(rows: Sequence[InsertionRow]) -> str:
    columns = list(INSERTION_COLUMNS)
    for name in OPTIONAL_COLUMNS:
        field = NUMBER_COLUMNS[name][0] if name in NUMBER_COLUMNS else name.removesuffix("_mm")
        columns += [name] * any(getattr(row, field) != getattr(InsertionRow, field) for row in rows)
    columns += dict.fromkeys(OBSERVATION_PREFIX + name for row in rows for name in row.observation_values)
    columns += ROLL_COLUMNS if any(row.roll is not None or row.turns for row in rows) else []
    columns += SCAN_COLUMNS if any(row.patient is not None for row in rows) else []
    return _to_csv(
        [columns, *([cells.get(name, "") for name in columns] for cells in map(format_cells, rows))]
    )


def format_cells(row: InsertionRow) -> dict[str, str]:
    alternative = row.layers if row.layers_alternative is None else row.layers_alternative
    turn = shift = None
    if row.patient is not None:
        turn, shift = Rotation.from_matrix(row.patient.rotation).as_rotvec(degrees=True), row.patient.origin
    cells = {name: getattr(row, name) for name in TEXT_COLUMNS} | {
        "specimen": row.specimen or row.hole or row.id,
        BOUNDARIES_COLUMN: _format_boundaries(row.boundaries),
        "layers": str(row.layers),
        "layers_alternative": str(alternative),
        "bevel_side": f"{row.side:+d}" if row.roll is None else "",
    }
    for names, vector, digits in (
        (ENTRY_COLUMNS, row.entry, 4),
        (DIRECTION_COLUMNS, row.direction, 6),
        (BEVEL_COLUMNS, row.bevel, 6),
        (SCAN_ROTATION_COLUMNS, turn, 6),
        (SCAN_SHIFT_COLUMNS, shift, 4),
    ):
        cells |= dict(zip(names, _format_vector(vector, digits), strict=True))
    cells |= {OBSERVATION_PREFIX + name: f"{value:.9g}" for name, value in row.observation_values.items()}
    for name, (field, _) in NUMBER_COLUMNS.items():
        value = getattr(row, field)
        value = math.degrees(value) if name.endswith("_deg") and value is not None else value
        cells[name] = "" if value is None else _format_number(value)
    return cells


def _format_boundaries(depths: tuple[float, ...] | None) -> str:
    return "" if depths is None else ";".join(map(_format_number, depths)) or NO_BOUNDARY


def _format_vector(values: Floats | None, digits: int) -> tuple[str, ...]:
    return ("", "", "") if values is None else tuple(_format_number(float(value), digits) for value in values)


def _format_number(value: float, digits: int = 4) -> str:
    """Return `value` with fixed digits; never "-0.0000"."""
    return f"{value:z.{digits}f}"
