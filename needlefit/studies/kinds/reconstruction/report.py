"""Report of a batch of reconstructed scans, written into the folder of their dataset."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from needlefit.datasets.read import check_all
from needlefit.datasets.sources import ScanVolume, write_volumes
from needlefit.geometry.surfaces import write_surface
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import ReconstructionFailure, add_findings
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.atomic_write import replace_folder
from needlefit.project.progress import Progress
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.studies.kinds.reconstruction import KIND
from needlefit.studies.kinds.reconstruction.exports import ExportKind, export_scan
from needlefit.studies.kinds.reconstruction.quality import write_quality
from needlefit.studies.kinds.reconstruction.refused import (
    tabulate_failures,
    write_refused_pages,
)
from needlefit.studies.kinds.reconstruction.run import tabulate_batch
from needlefit.studies.kinds.reconstruction.schema import ReconstructionBatchRecord
from needlefit.studies.report import FigurePaths, StudyReport, write_files
from needlefit.studies.run import Run
from needlefit.studies.slicer import write_scan
from needlefit.studies.verdict import Status

_COLUMNS = (
    *(
        "scan",
        "medium",
        "depth_mm",
        "depth_sd_mm",
        "deflection_mm",
        "out_of_plane_max_mm",
        "markers",
        "fre_mm",
    ),
    *("expected_fre_mm", "target_error_tip_mm", "entry_pose_from", "crossing_depths", "remark_count"),
)

POOR_DEPTH_SD_MM = 0.5
"""Deviation of the inserted length, mm, that the first line names."""

MAX_NAMED_SCANS = 5

_SCREEN_COLUMNS = (
    *("scan", "medium", "depth_mm", "deflection_mm", "markers", "fre_mm", "target_error_tip_mm"),
    *("crossing_depths", "remark_count"),
)


def lay_out_first(found: Run) -> list[TableLayout]:
    """Return the columns of `lay_out_reconstructions` that a terminal has room for."""
    return [lay_out_reconstructions(found, _SCREEN_COLUMNS)]


def lay_out_reconstructions(found: Run, columns: Sequence[str] = _COLUMNS) -> TableLayout:
    """Return the main results of each scan."""
    caption = "Reconstructed scans" + (" (synthetic data)" if found.synthetic else "")
    notes = ("Out of plane: largest distance. Target error: predicted, at the tip. Remarks: see quality/.",)
    rows = [_describe_scan(found, row) for row in to_records(found.frames["reconstruction"])]
    return Table("reconstruction", caption, rows, columns, notes=notes).lay_out(drop_empty=True)


def _describe_scan(found: Run, row: Row) -> Row:
    crossings, remarks = (_select_scan(found, name, row["id"]) for name in ("crossings", "remarks"))
    depths = ", ".join(f"{one['depth_mm']:.2f} ± {one['depth_sd_mm']:.2f}" for one in crossings)
    about = {"scan": row["id"], "crossing_depths": depths or None, "remark_count": len(remarks) or ""}
    unregistered = {"target_error_tip_mm": None} if row["markers_known"] is None else {}
    return {**row, **about, **unregistered}


def _select_scan(found: Run, name: str, id_: object) -> list[Row]:
    rows = found.frames[name]
    return to_records(rows[rows["id"] == id_])


def summarize(found: Run) -> list[str]:
    """Return how many scans were reconstructed, and of how many quality checks remark something."""
    count, remarks = len(found.frames["reconstruction"]), to_records(found.frames["remarks"])
    remarked = len({row["id"] for row in remarks})
    outcome = f"{remarked} with remarks" if remarked else "no remarks"
    listed = [f"{row['id']}: {row['note']}." for row in remarks]
    first = f"Reconstructed {count} scan{'' if count == 1 else 's'}, {outcome}{_name_poor_lengths(found)}."
    return [first, *listed]


def _name_poor_lengths(found: Run) -> str:
    """Return the scans whose inserted length is poorly known, in words; empty if there is none."""
    rows = to_records(found.frames["reconstruction"])
    poor = [row for row in rows if row["depth_sd_mm"] > POOR_DEPTH_SD_MM]
    words = [f"{row['id']} ± {row['depth_sd_mm']:.1f} mm" for row in poor[:MAX_NAMED_SCANS]]
    more = f" and {len(poor) - MAX_NAMED_SCANS} more" if len(poor) > MAX_NAMED_SCANS else ""
    return f"; inserted length poorly known: {', '.join(words)}{more}" if poor else ""


def describe_proposals(found: Run, folder: Path) -> list[str]:
    """Return where in each scan layers are proposed; nothing if nobody asked."""
    if "proposed_layers" not in found.frames:
        return []
    rows = to_records(found.frames["proposed_layers"])
    if not rows:
        return ["proposed layers: none; the scans show no interface"]
    lines = [f"proposed layers: {len(rows)}, which nothing uses: {folder}/proposed/"]
    for id_ in dict.fromkeys(row["id"] for row in rows):
        own = [row for row in rows if row["id"] == id_]
        depths = ", ".join(f"{row['depth_mm']:.2f} ± {row['depth_sd_mm']:.2f}" for row in own)
        lines.append(f"{id_}: proposed at a depth of {depths} mm")
    return lines


def rate(found: Run) -> Status:
    """Return "warn" if a quality check remarks something."""
    return "warn" if len(found.frames["remarks"]) else "pass"


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the table; each scan has a page of its own."""
    return [
        document.heading("Scans"),
        document.table(lay_out_reconstructions(found)),
        *([document.table(lay_out_refused(found))] if "refused" in found.frames else []),
        document.text("The folder quality/ has a page of figures for every scan."),
    ]


def lay_out_refused(found: Run) -> TableLayout:
    """Return why scans were refused."""
    rows = [{**row, "scan": row["id"]} for row in to_records(found.frames["refused"])]
    return Table("refused", "Refused scans", rows, ("scan", "note")).lay_out(drop_empty=True)


REPORT = StudyReport(
    summarize,
    lambda found: [lay_out_reconstructions(found)],
    lambda found, folder: {},
    compose_sections,
    keeps_files=True,
    rate=rate,
    lay_out_first=lay_out_first,
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

    Raises
    ------
    DataError
        If the dataset has a fault that belongs to no single scan.
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
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
            notes = export_scan(one, exports, fresh / "slicer", recipe.needle.diameter_mm)
            written.append(replace(one, warnings=(*one.warnings, *notes)))
            write_quality(written[-1], fresh / "quality" / f"{one.scan.id}.pdf")
            _write_proposals(one, fresh / "proposed")
        title = f"Reconstruction: {description.title or description.name}"
        options = {"title": title, "scans": [one.scan.id for one in kept], "recipe": recipe}
        record = KIND.make_record(**options)
        assert isinstance(record, ReconstructionBatchRecord)
        found = tabulate_batch(description.name, record, written, check_all(fresh)[1])
        if refused:
            found = replace(found, frames={**found.frames, **tabulate_failures(refused)})
            write_refused_pages(refused, fresh / "quality")
        write_files(found, fresh)
    return found, failures


def _write_proposals(one: Reconstruction, folder: Path) -> None:
    """Write the proposed layers of a scan as `<id>_proposed<layer>.stl`, in its frame (LPS)."""
    for found in one.proposals or ():
        # 3D Slicer reads the frame from the name that the file states
        named = replace(found.surface, name=f"{found.surface.name} SPACE=LPS")
        write_surface(named, folder / f"{one.scan.id}_{found.surface.name}.stl")
