"""Write an import as a dataset; its faults are those of the imported files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.datasets.columns import HOLE_COLUMN, NEEDLE_COLUMN, POINT_SD_COLUMN, make_id
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.importing.kinds import ImportedCurve
from needlefit.datasets.importing.meanings import VALUES
from needlefit.datasets.importing.place import ImportPlan
from needlefit.datasets.importing.read import ImportContent, make_unique
from needlefit.datasets.importing.stated import name_set
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.read import inspect
from needlefit.datasets.record_warnings import MAPPING_FILE, PLACEHOLDER
from needlefit.datasets.write import write_dataset
from needlefit.geometry.surfaces import Surface
from needlefit.project.toml import check as check_record
from needlefit.project.toml import dumps
from needlefit.schemas.dataset import DatasetRecord, ImportRecord
from needlefit.schemas.mapping import MappingRecord

TRACKS_FILE = "tracks.csv"
TURNS_FILE = "turns.csv"
CURVATURE_FILE = "curvature.csv"
TRACK_COLUMNS = ("depth_mm", "tip_mm", "tip_z_mm", "guide_mm", "guide_z_mm")
OPTIONAL = (NEEDLE_COLUMN, HOLE_COLUMN, "bevel_roll_deg", POINT_SD_COLUMN, *TRACK_COLUMNS[2:])
_NOTE = (
    f"# Made by `needlefit import`; {MAPPING_FILE} states how the files were read, and what was assumed.\n"
)


def write_plan(folder: Path, content: ImportContent, plan: ImportPlan, mapping: MappingRecord) -> Dataset:
    """Write the dataset of a plan, and its mapping, into an empty folder; return it as it is read.

    DataError listing the faults that `check` finds, at their places in the imported files.
    """
    first = content.curves[0].points.path
    imported = ImportRecord(files=dict(content.files), mapping=MAPPING_FILE, examples=plan.examples)
    slope_sd, session_sd = plan.slope_sds_deg
    draft: dict[str, object] = {
        "schema": 1,
        "name": folder.name,
        "title": f"{PLACEHOLDER}: what was inserted into what",
        "origin": mapping.origin,
        "license": PLACEHOLDER,
        "source": f"{PLACEHOLDER}: who measured this, when, how",
        "needle": plan.needle.model_dump(),
        "noise": {
            "point_sd_mm": plan.point_sd_mm,
            "slope_sd_deg": slope_sd,
            **({} if session_sd is None else {"session_slope_sd_deg": session_sd}),
            "note": f"see {MAPPING_FILE}",
        },
        "import": imported.model_dump(),
        **{
            key: text for key, text in mapping.values.items() if key in VALUES and VALUES[key].of == "dataset"
        },
    }
    if plan.needles:
        draft["needles"] = {name: needle.model_dump() for name, needle in plan.needles.items()}
    rows = [curve.row for curve in content.curves if not curve.kind.is_track]
    tracks = [curve for curve in content.curves if curve.kind.is_track]
    surfaces = dict[str, Surface]()
    for surface in plan.surfaces:
        surfaces[make_unique(f"layers/{make_id(surface.name, 'surface')}", surfaces)] = surface
    surfaces = {f"{name}.stl": surface for name, surface in surfaces.items()}
    parts = [{"file": name, "kind": surface.kind, "into": surface.into} for name, surface in surfaces.items()]
    media: dict[str, dict[str, object]] = {
        medium: {"surfaces": parts} if parts else {"boundaries_mm": [*depths]}
        for medium, depths in plan.boundaries_mm.items()
    }
    curves = {curve.name: curve.points.to_columns() for curve in content.curves if curve.kind.has_shape}
    if rows:
        beside = {"turns": TURNS_FILE} if any(row.turns for row in rows) else {}
        if any(row.curvature is not None for row in rows):
            beside["curvature"] = CURVATURE_FILE
        draft |= {"frame": {"pose": plan.pose}, "insertions": {"file": "insertions.csv", **beside}}
    if curves:
        draft["centerlines"] = {"pattern": "centerlines/{id}.csv"}
    if tracks:
        draft["tip_tracks"] = _write_tracks(folder, tracks, media)
    record = check_record(draft | {"media": media}, DatasetRecord, str(first))
    file = write_dataset(folder, record, rows, curves, surfaces, checksums=False)
    file.write_bytes((_NOTE + file.read_text(encoding="utf-8")).encode("utf-8"))
    write_mapping(folder / MAPPING_FILE, mapping)
    inspection = inspect(file)
    if inspection.dataset is None:
        raise as_error([_trace_fault(fault, content.curves, folder) for fault in inspection.faults], first)
    return inspection.dataset


def write_mapping(file: Path, mapping: MappingRecord) -> None:
    """Write a mapping: what differs from the defaults."""
    keys = {"schema": mapping.schema_} | mapping.model_dump(
        mode="json", exclude_defaults=True, exclude={"schema_"}
    )
    file.write_bytes(dumps(keys, arrays=("tables",)).encode("utf-8"))


def _trace_fault(fault: Fault, curves: Sequence[ImportedCurve], folder: Path) -> Fault:
    """Return a fault of the dataset in `folder` as one of the imported files: where a row comes from."""
    name, _, line = Path(fault.where).as_posix().removeprefix(f"{folder.as_posix()}/").rpartition(":")
    rows = list[tuple[str, str, str]]()  # place, subject, needle
    for curve in curves:
        is_track, start, points = curve.kind.is_track, f"curve {curve.name}", curve.points
        if name == (TRACKS_FILE if is_track else f"centerlines/{curve.name}.csv"):
            rows += [(points.where(n), f"{start} ", curve.name) for n in range(len(curve.line))]
        elif name == "insertions.csv" and not is_track:
            rows.append((points.where(), f"{start}: ", curve.name))
        elif name == TURNS_FILE:
            rows += [(cell.where, "", curve.name) for _, cell in curve.turns]
        elif name == CURVATURE_FILE:
            sensors = range(1, len(curve.sensors) + 1)
            rows += [(f"curvature {n} of needle {curve.name}", "", curve.name) for n in sensors]
    if not (rows and line.isdecimal()):
        return fault.at(fault.where.replace(f"{folder}/", ""))
    where, subject, needle = rows[int(line) - 2]  # below one header line
    fix = f"{fault.fix.removesuffix(', or leave it out')}; or leave it out: {name_set('leave_out', needle)}"
    return fault.replace(what=f"{subject}{fault.what.removeprefix(subject)}", where=where, fix=fix)


def _write_tracks(
    folder: Path, tracks: Sequence[ImportedCurve], media: dict[str, dict[str, object]]
) -> dict[str, object]:
    """Write the table of tip tracks, and into `media` what they meet; return what the dataset states."""
    tables = list[pd.DataFrame]()
    for curve in tracks:
        row, depths = curve.row, curve.boundaries
        layers = [*range(1, len(depths) + 2)]
        media[row.medium] |= {"layers": layers, "boundaries_mm": [*depths], "specimen": row.specimen}
        guide = np.zeros_like(curve.line) if curve.guide is None else curve.guide
        cells = {
            "id": row.id,
            "medium": row.medium,
            NEEDLE_COLUMN: row.needle,
            HOLE_COLUMN: row.hole,
            "bevel_side": row.side,
            "bevel_roll_deg": np.degrees(curve.rolls),
            POINT_SD_COLUMN: row.point_sd,
        }
        numbers = zip(TRACK_COLUMNS, (curve.depths, *curve.line.T[:2], *guide.T[:2]), strict=True)
        tables.append(pd.DataFrame({**cells, **dict(numbers)}))
    table = pd.concat(tables)
    source: dict[str, object] = {"file": TRACKS_FILE, "depth_zero": "tissue"}
    left_out = [name for name in OPTIONAL if table[name].isin([0, "", None, np.nan]).all()]
    if "guide_mm" in left_out:
        source["constants"] = {"guide_mm": 0.0}  # at rest
    table = table.drop(columns=left_out)
    table.to_csv(folder / TRACKS_FILE, index=False, float_format="%.4f", lineterminator="\n")
    return source
