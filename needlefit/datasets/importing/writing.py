"""Write an import as a dataset; its faults are those of the imported files."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.answers import QUESTIONS, Answers
from needlefit.datasets.importing.curves import ImportContent
from needlefit.datasets.importing.planning import ImportPlan
from needlefit.datasets.points import trace_fault
from needlefit.datasets.read import check
from needlefit.datasets.template import draft_record
from needlefit.datasets.write import write_dataset
from needlefit.geometry.surfaces import Surface, make_sheet
from needlefit.project.folders import sha256
from needlefit.project.toml import check as check_record
from needlefit.project.toml import dumps
from needlefit.schemas.dataset import DatasetRecord, ImportRecord, TrackDatasetRecord

PLANE_MM = 100.0  # length and width of the boundary of one needle that is stated as a depth
TRACKS_FILE = "tracks.csv"

_NOTE = "# Made by `needlefit import`. [import] lists every decision and its origin; correct what is wrong.\n"


def write_plan(folder: Path, content: ImportContent, plan: ImportPlan, answers: Answers) -> Path:
    """Write the dataset of a plan into an empty folder; return its `dataset.toml`.

    DataError listing the faults that `check` finds, at their places in the imported files.
    """
    imported = ImportRecord(
        files={one.name: sha256(one) for one in content.files}, decisions=tuple(answers.made)
    )
    draft = draft_record(
        folder.name,
        plan.pose,
        needle=plan.needle.model_dump(),
        noise={"point_sd_mm": plan.point_sd_mm, "note": "see the table import of dataset.toml"},
        **{"import": imported.model_dump()},
        **{what: one.text for what, one in answers.stated.items() if not QUESTIONS[what].is_asked},
    )
    points = {row.id: one for row, one in zip(plan.rows, plan.points, strict=True)}
    if plan.readings:
        file = _write_tracks(folder, plan, draft)
    else:
        media, surfaces = _make_media(plan)
        record = check_record(draft | {"media": media}, DatasetRecord, str(content.files[0]))
        curves = {name: one.to_columns() for name, one in points.items()}
        file = write_dataset(folder, record, plan.rows, curves, surfaces, checksums=False)
    file.write_bytes((_NOTE + file.read_text(encoding="utf-8")).encode("utf-8"))
    faults = [trace_fault(fault, points, folder) for fault in check(file)]
    for n, fault in enumerate(faults):
        if " goes back" in fault.what:  # points of several needles may have been taken for one
            hint = "state the column that tells needles apart with --columns needle=HEADER"
            faults[n] = replace(fault, fix=f"{fault.fix}; or {hint}")
    if faults:
        raise as_error(faults, content.files[0])
    return file


def _make_media(plan: ImportPlan) -> tuple[dict[str, object], dict[str, Surface]]:
    """Return the media of a plan, and the surfaces of their files."""
    surfaces: dict[str, Surface] = {}
    medium: dict[str, object] = {"note": "no boundaries of layers were imported"}
    depths = [*dict.fromkeys(plan.depths_mm.values())]
    if plan.surfaces:
        for n, surface in enumerate(plan.surfaces, 1):
            plain = re.sub(r"[^A-Za-z0-9_-]+", "_", surface.name).strip("_")[:60]
            surfaces[f"layers/{f'{n}_{plain}' if plain else n}.stl"] = surface
        medium = {
            "surfaces": [{"file": f, "kind": one.kind, "into": one.into} for f, one in surfaces.items()]
        }
    elif len(depths) == 1:
        medium = {"boundaries_mm": [*depths[0]]}
    elif depths:  # of each needle its own: planes across the entry directions
        files = [(f"layers/{n}_{{id}}.stl", n + 1) for n in range(1, len(depths[0]) + 1)]
        medium = {"surfaces": [{"file": file, "kind": "sheet", "into": into} for file, into in files]}
        for row in plan.rows:
            if row.entry is None or row.direction is None:
                raise ValueError(f"{row.id} has no entry pose")
            for (file, into), depth in zip(files, plan.depths_mm[row.id], strict=True):
                place = row.entry + depth * row.direction
                surfaces[file.replace("{id}", row.id)] = make_sheet(
                    "boundary", place, row.direction, PLANE_MM, into
                )
    return dict.fromkeys((row.medium for row in plan.rows), medium), surfaces


def _write_tracks(folder: Path, plan: ImportPlan, draft: dict[str, object]) -> Path:
    """Write a dataset of tip tracks; a medium for each specimen, if there are several."""
    names = {row.id: row.medium for row in plan.rows}
    if len({row.specimen for row in plan.rows}) > 1:
        names = {row.id: f"{row.medium} {row.specimen}" for row in plan.rows}
    depths = plan.depths_mm
    media = {
        names[row.id]: {
            "layers": [*range(1, len(depths.get(row.id, ())) + 2)],
            "boundaries_mm": [*depths.get(row.id, ())],
            "specimen": row.specimen,
        }
        for row in plan.rows
    }
    lines = ["id,medium,depth_mm,tip_mm,guide_mm,bevel_side\n"]
    for row, one, points in zip(plan.rows, plan.readings, plan.points, strict=True):
        guide = np.zeros(len(one.depth)) if one.guide is None else one.guide
        for depth, tip, place in zip(one.depth, points.values[:, 0], guide, strict=True):
            lines.append(f"{row.id},{names[row.id]},{depth:.4f},{tip:.4f},{place:.4f},{row.side}\n")
    own = {key: value for key, value in draft.items() if key not in ("frame", "insertions", "centerlines")}
    record = check_record(
        own | {"tip_tracks": {"file": TRACKS_FILE}, "media": media}, TrackDatasetRecord, folder
    )
    (folder / TRACKS_FILE).write_bytes("".join(lines).encode("utf-8"))
    (folder / "dataset.toml").write_bytes(
        dumps(record.model_dump(mode="json", by_alias=True)).encode("utf-8")
    )
    return folder / "dataset.toml"
