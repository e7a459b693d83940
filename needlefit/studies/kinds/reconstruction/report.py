"""Report of a batch of reconstructed scans, written into the folder of their dataset."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from needlefit.datasets.read import check_all
from needlefit.datasets.sources import ScanVolume, write_volumes
from needlefit.errors import DataError
from needlefit.geometry.surfaces import write_surface
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import ReconstructionFailure, add_findings
from needlefit.imaging.label_export import mark_voxels, write_dicom_segmentation, write_slicer_segmentation
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import write_scan_table
from needlefit.imaging.volume_files import read_volume
from needlefit.project.folders import replace_folder
from needlefit.project.progress import Progress
from needlefit.project.toml import dumps
from needlefit.reporting.document import Block
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records, write_csv
from needlefit.reporting.text import KindText
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.studies.kinds.reconstruction import KIND, ReconstructionBatchRecord
from needlefit.studies.kinds.reconstruction.pages import write_quality, write_refused_pages
from needlefit.studies.kinds.reconstruction.run import tabulate_batch, tabulate_failures
from needlefit.studies.report import FigurePaths, StudyReport, write_files
from needlefit.studies.run import Run
from needlefit.studies.slicer import write_scan
from needlefit.studies.slicer_scene import write_slicer_scene

ExportKind = Literal["scene", "seg"]

SCANS_FILE, RECIPE_FILE = "scans.csv", "recipe.toml"
POOR_DEPTH_SD_MM = 0.5  # deviation of the inserted length, mm, that the first line names
MAX_NAMED_SCANS = 5
_COLUMNS = (
    *("scan", "medium", "depth_mm", "depth_sd_mm", "deflection_mm", "out_of_plane_max_mm", "markers"),
    *("fre_mm", "expected_fre_mm", "target_error_tip_mm", "entry_pose_from", "crossing_depths"),
    "remark_count",
)
_SCREEN_COLUMNS = (
    *("scan", "medium", "depth_mm", "deflection_mm", "markers", "fre_mm", "target_error_tip_mm"),
    *("crossing_depths", "remark_count"),
)
_TEXT = KindText("reconstruction")


def describe(found: Run) -> dict[str, Any]:
    """Return what the text prints."""
    rows, remarks = to_records(found.frames["reconstruction"]), to_records(found.frames["remarks"])
    poor = [{"id": row["id"], "sd_mm": row["depth_sd_mm"]} for row in rows]
    return {
        "scans": len(rows),
        "remarked": len({row["id"] for row in remarks}),
        "remarks": remarks,
        "poor": [one for one in poor if one["sd_mm"] > POOR_DEPTH_SD_MM],
        "named": MAX_NAMED_SCANS,
        "synthetic": found.synthetic,
    }


def lay_out_reconstructions(found: Run, columns: Sequence[str] = _COLUMNS) -> TableLayout:
    """Return the main results of each scan."""
    rows = [_describe_scan(found, row) for row in to_records(found.frames["reconstruction"])]
    return _TEXT.lay_out(Table("reconstruction", "", rows, columns), describe(found), drop_empty=True)


def _describe_scan(found: Run, row: Row) -> Row:
    frames = [found.frames[name] for name in ("crossings", "remarks")]
    crossings, remarks = (to_records(rows[rows["id"] == row["id"]]) for rows in frames)
    about = {"crossing_depths": _list_depths(crossings) or None, "remark_count": len(remarks) or ""}
    unregistered = {"target_error_tip_mm": None} if row["markers_known"] is None else {}
    return {**row, "scan": row["id"], **about, **unregistered}


def _list_depths(rows: Sequence[Row]) -> str:
    return ", ".join(f"{one['depth_mm']:.2f} ± {one['depth_sd_mm']:.2f}" for one in rows)


def summarize(found: Run) -> list[str]:
    """Return how many scans were reconstructed, and of how many quality checks remark something."""
    return [
        sentence for block in ("verdict", "summary") for sentence in _TEXT.sentences(block, describe(found))
    ]


def describe_proposals(found: Run, folder: Path) -> list[str]:
    """Return where in each scan layers are proposed; nothing if nobody asked."""
    if "proposed_layers" not in found.frames:
        return []
    rows = to_records(found.frames["proposed_layers"])
    ids = dict.fromkeys(row["id"] for row in rows)
    depths = {id_: _list_depths([row for row in rows if row["id"] == id_]) for id_ in ids}
    return _TEXT.sentences("proposals", {"count": len(rows), "folder": str(folder), "proposals": depths})


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the table; each scan has a page of its own."""
    tables = [lay_out_reconstructions(found)]
    if "refused" in found.frames:
        rows = [{**row, "scan": row["id"]} for row in to_records(found.frames["refused"])]
        tables.append(_TEXT.lay_out(Table("refused", "", rows, ("scan", "note")), {}, drop_empty=True))
    return _TEXT.compose("report", describe(found), tables)


REPORT = StudyReport(
    summarize,
    lambda found: [lay_out_reconstructions(found)],
    lambda found, folder: {},
    compose_sections,
    keeps_files=True,
    rate=lambda found: "warn" if len(found.frames["remarks"]) else "pass",
    # the columns that a terminal has room for
    lay_out_first=lambda found: [lay_out_reconstructions(found, _SCREEN_COLUMNS)],
)


def write_reconstruction(
    folder: Path,
    ones: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
    progress: Progress,
    refused: Sequence[ReconstructionFailure] = (),
    exports: Collection[ExportKind] = (),
) -> tuple[Run | None, tuple[ReconstructionFailure, ...]]:
    """Write `folder`, completely or not at all; return its result, and what a dataset cannot contain.

    Where none can be held nothing is written, and what was there stays.

    The dataset, and where its scans lie; `quality/<id>.pdf`, also of the scans that were `refused`;
    `slicer/`, with what is exported of each scan; and the files of every run.

    DataError if the dataset has a fault that belongs to no single scan. ConfigError if `folder` holds
    anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        kept, failures = assemble_checked(fresh, ones, recipe, description)
        by_id = {one.scan.id: one for one in ones}
        failures = tuple(add_findings(one, by_id[one.scan.id], recipe) for one in failures)
        if not kept:
            return None, failures
        refused = (*refused, *failures)
        volumes = {one.scan.id: ScanVolume(one.scan.volume, one.scan.series) for one in kept}
        write_volumes(fresh, volumes, folder)
        written = []
        for done, one in enumerate(kept):
            progress(f"{one.scan.id}: quality page", done, len(kept))
            write_scan(one, fresh / "slicer", recipe.needle.diameter_mm)
            notes = _export_scan(one, exports, fresh / "slicer", recipe.needle.diameter_mm)
            written.append(replace(one, warnings=(*one.warnings, *notes)))
            write_quality(written[-1], fresh / "quality" / f"{one.scan.id}.pdf")
            for found in (
                one.proposals or ()
            ):  # in the frame of the scan: Slicer reads it from the stated name
                named = replace(found.surface, name=f"{found.surface.name} SPACE=LPS")
                write_surface(named, fresh / "proposed" / f"{one.scan.id}_{found.surface.name}.stl")
        title = f"Reconstruction: {description.title or description.name}"
        record = KIND.make_record(title=title, scans=[one.scan.id for one in kept], recipe=recipe)
        assert isinstance(record, ReconstructionBatchRecord)
        result = tabulate_batch(description.name, record, written, check_all(fresh)[1])
        if refused:
            result = replace(result, frames={**result.frames, **tabulate_failures(refused)})
            write_refused_pages(refused, fresh / "quality")
        write_files(result, fresh)
    return result, failures


def _export_scan(
    one: Reconstruction, exports: Collection[ExportKind], folder: Path, diameter: float
) -> tuple[str, ...]:
    """Write what is exported of a scan; return warnings.

    `<id>.mrb`, a scene of 3D Slicer; `<id>.seg.dcm`, a DICOM segmentation. Where the scan allows none, it is
    `<id>.seg.nrrd`, a segmentation of 3D Slicer.
    """
    if not exports:
        return ()
    volume = read_volume(one.scan.volume, one.scan.series)
    if "scene" in exports:
        write_slicer_scene(one, volume, diameter, folder / f"{one.scan.id}.mrb")
    if "seg" in exports:
        marked = mark_voxels(one, volume.grid, diameter)
        try:
            write_dicom_segmentation(one.scan, marked, folder / f"{one.scan.id}.seg.dcm")
        except DataError as error:
            instead = folder / f"{one.scan.id}.seg.nrrd"
            write_slicer_segmentation(marked, volume.grid, instead)
            return (f"no DICOM segmentation is written, {instead.name} instead: {error.what}",)
    return ()


def write_refused(
    failures: Sequence[ReconstructionFailure], recipe: ReconstructionRecord, folder: Path
) -> None:
    """Write a folder of refused scans alone: `quality/<id>.pdf`, `refused.csv` and `candidates.csv`.

    Their table and their recipe are written beside these, from which the scans are opened again.

    ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        write_refused_pages(failures, fresh / "quality")
        for name, frame in tabulate_failures(failures).items():
            write_csv(frame, fresh / f"{name}.csv")
        write_scan_table([one.scan for one in failures], fresh / SCANS_FILE, folder)
        plain = recipe.model_dump(mode="json", by_alias=True)
        (fresh / RECIPE_FILE).write_text(dumps(plain), encoding="utf-8")
