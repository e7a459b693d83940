"""The report of a batch of reconstructed scans, written into the folder of their dataset."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.columns import BEVEL_COLUMNS
from needlefit.datasets.first_study import write_first_runs, write_scene
from needlefit.datasets.formats.markups import CurveStyle, Markups, write_mrk_json
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import VERSIONED_PACKAGES, ReconstructionFailure
from needlefit.imaging.corrections import LIST_NAME, list_control_points
from needlefit.imaging.reconstruct import STAGES
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume_files import list_series_files
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.project.callbacks import Progress
from needlefit.project.folders import replace_folder, sha256
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.project.stored_values import encode
from needlefit.reporting.figures import Drawing, Panel
from needlefit.reporting.labels import PAPER_COLOUR, rgb
from needlefit.reporting.scan_pages import write_quality, write_refusal_page
from needlefit.reporting.slicer import POINT_SIZE_MM, write_scan
from needlefit.reporting.table import Table, TableLayout, find_column
from needlefit.reporting.table_files import Row, select_rows, to_records, write_csv
from needlefit.reporting.text import KindText
from needlefit.schemas.origin import combine_origins
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.run_metadata import RunMetadata
from needlefit.studies.first_page import FirstPage, advise
from needlefit.studies.identity import package_versions
from needlefit.studies.job import Settings
from needlefit.studies.kinds.reconstruction import KIND, ReconstructionBatchRecord
from needlefit.studies.report import StudyReport, begin_first_page, write_files
from needlefit.studies.run import Run, store_sources

TIP_COLUMNS = ("tip_l_mm", "tip_p_mm", "tip_s_mm", "tip_along_sd_mm", "tip_across_sd_mm")
POOR_DEPTH_SD_MM = 0.5  # largest SD of the inserted length (mm) that the first line does not name
MAX_NAMED_SCANS = 5  # largest number of scans that are named
_COLUMNS = (
    *("scan", "medium", "depth_mm", "deflection_mm", "markers", "fre_mm", "target_error_tip_mm"),
    *("crossing_depths", "remark_count"),
)
# columns of the page of a scan
_FACT_COLUMNS = (
    *("depth_mm", "depth_sd_mm", "deflection_mm", "out_of_plane_max_mm", "bending_plane_from"),
    *("tip_along_sd_mm", "tip_across_sd_mm", "crossing_depths", "entry_pose_from", "entry_along_sd_mm"),
    *("entry_shift_sd_mm", "entry_angle_sd_deg", "markers_from", "markers_paired", "markers_known"),
    *("fre_mm", "expected_fre_mm", "target_error_entry_mm", "target_error_tip_mm"),
)
TEXT = KindText("reconstruction")
# columns of a scan that is registered
_REGISTERED_COLUMNS = (
    *("markers_from", "markers_found", "markers_known", "markers_paired", "fre_mm", "expected_fre_mm"),
    *("fre_p_value", "target_error_entry_mm", "target_error_tip_mm"),
)
FRAMES: Mapping[str, tuple[str, ...]] = {
    "markers": (
        *("id", "found", "known", "found_x_mm", "found_y_mm", "found_z_mm", "found_sd_mm", "residual_x_mm"),
        *("residual_y_mm", "residual_z_mm", "residual_mm"),
    ),
    "crossings": (*("id", "number", "out_of", "into", "depth_mm", "depth_sd_mm", "x_mm", "y_mm", "z_mm"),),
    "passed": ("id", "number", "part", "material", "begin_mm", "end_mm", "level_hu"),
    "remarks": ("id", "note"),
    "refused": ("id", "scan", "note"),
    "deflections": ("id", "x_mm", "y_mm", "low_mm", "high_mm"),
}
MAX_DRAWN_POINTS = 60  # largest number of points of a needle in the figure


def run(name: str, record: ReconstructionBatchRecord, settings: Settings) -> Run:
    """Raise ConfigError: scans become a dataset, which a study file has no place for."""
    raise ConfigError(
        "is no study that can be run", where=name, fix="name its scans after `needlefit reconstruct`"
    )


def describe_work(scan: Scan, recipe: ReconstructionRecord, every: bool) -> dict[str, Any]:
    """Return all that decides the results of a scan, as JSON values, with a digest of each file."""
    files = {path for part in scan.files for path in list_series_files(part)}
    return {
        "scan": encode(scan),
        "files": {str(path): sha256(path) for path in sorted(files)},
        "recipe": recipe.model_dump(mode="json"),
        "every": every,
        "versions": package_versions(VERSIONED_PACKAGES),
    }


def tabulate_batch(
    name: str,
    record: ReconstructionBatchRecord,
    ones: Sequence[Reconstruction],
    refused: Sequence[ReconstructionFailure] = (),
    warnings: Iterable[ResultWarning] = (),
) -> Run:
    """Return the result of a batch; `warnings` are those of the dataset."""
    remarks = [
        (reconstruction.scan.id, remark) for reconstruction in ones for remark in reconstruction.warnings
    ]
    return Run(
        kind=record.kind,
        name=name,
        record=record,
        origin=combine_origins(reconstruction.scan.origin for reconstruction in ones),
        dataset_title=record.title.removeprefix("Reconstruction: "),
        frames={
            "reconstruction": pd.DataFrame(map(describe_scan, ones)),
            "markers": tabulate_markers(ones),
            "crossings": tabulate_crossings(ones),
            "passed": tabulate_passed(ones),
            "remarks": pd.DataFrame(remarks, columns=list(FRAMES["remarks"])),
            "refused": tabulate_failures(refused),
            "deflections": tabulate_deflections(ones),
        },
        metadata=RunMetadata(
            name=name,
            versions=package_versions(VERSIONED_PACKAGES),
            study=record.model_dump(mode="json", by_alias=True),
        ).state(warnings=to_stored_rows(warnings)),
        timing={},
    )


def tabulate_markers(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per pair of a found marker (position in the scan, LPS) and a known one, counted from 0.

    Residuals are known minus registered place, in the axes of the world.
    """
    rows = []
    for reconstruction in reconstructions:
        fit, markers = reconstruction.registration, reconstruction.markers
        if fit is None or markers is None:
            continue
        for (detected, stated), residual in zip(fit.pairs, fit.residuals, strict=True):
            place = (reconstruction.scan.id, detected, stated, *markers.centers[detected])
            rows.append((*place, markers.sd[detected], *residual, np.linalg.norm(residual)))
    return pd.DataFrame(rows, columns=list(FRAMES["markers"]))


def tabulate_crossings(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return a row per crossing: depth along C's x and its deviation, layers, position in the world."""
    rows = [
        (reconstruction.scan.id, n + 1, *layers.sequence[n : n + 2], depth, sd, *layers.points[n])
        for reconstruction in reconstructions
        for layers in [reconstruction.layers]
        for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True))
    ]
    return pd.DataFrame(rows, columns=list(FRAMES["crossings"]))


def tabulate_passed(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return a row per material that a needle passes, from its base on; mm from first contact."""
    rows = [
        (
            reconstruction.scan.id,
            n,
            reconstruction.name_part(run),
            run.kind,
            run.begin - at,
            run.end - at,
            run.level,
        )
        for reconstruction in reconstructions
        for at in [reconstruction.entry.at]
        for n, run in enumerate(reconstruction.passed, start=1)
    ]
    return pd.DataFrame(rows, columns=list(FRAMES["passed"]))


def tabulate_deflections(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return points of each centreline in its bending plane, with the ends of its pointwise 95 % band, mm."""
    rows = []
    for reconstruction in reconstructions:
        last = len(reconstruction.local) - 1
        points = np.linspace(0, last, min(last + 1, MAX_DRAWN_POINTS)).round().astype(int)
        half = NORMAL_95_HALF_WIDTH_SD * reconstruction.sd[points]
        rows += [
            (reconstruction.scan.id, x, y, y - h, y + h)
            for (x, y, _), h in zip(reconstruction.local[points], half, strict=True)
        ]
    return pd.DataFrame(rows, columns=list(FRAMES["deflections"]))


def describe_scan(reconstruction: Reconstruction) -> Row:
    """Return the row of a scan; without markers what is known by them is None."""
    scan, fit, markers = reconstruction.scan, reconstruction.registration, reconstruction.markers
    pose, needle, off = reconstruction.pose, reconstruction.needle_axis, reconstruction.local[:, 2]
    registered = dict.fromkeys(_REGISTERED_COLUMNS)
    if markers is not None and fit is not None:
        counts = (len(markers.centers), fit.known, len(fit.pairs))
        errors = (fit.fre, fit.expected_fre, fit.p_value, *reconstruction.target_error)
        registered = dict(zip(registered, (markers.source, *counts, *errors), strict=True))
    return {
        **{name: getattr(scan, name) for name in ("id", "origin", "medium", "specimen")},
        "scan": scan.volume.name,
        **dict(zip(("voxel_i_mm", "voxel_j_mm", "voxel_k_mm"), reconstruction.grid.spacing, strict=True)),
        **registered,
        "entry_pose_from": pose.source,
        "entry_along_sd_mm": pose.along_sd,
        "entry_shift_sd_mm": pose.shift_sd,
        "entry_angle_sd_deg": np.degrees(pose.angle_sd),
        "bending_plane_from": "shape" if scan.bevel is None else "stated",
        "out_of_plane_rms_mm": np.sqrt(np.mean(off**2)),
        "out_of_plane_max_mm": np.abs(off).max(),
        "depth_mm": reconstruction.depth,
        "depth_sd_mm": reconstruction.depth_sd,
        "deflection_mm": reconstruction.deflection,
        **dict(zip(TIP_COLUMNS, (*needle.end.point, *needle.end.sd), strict=True)),
        **dict(zip(BEVEL_COLUMNS, reconstruction.patient.rotation @ needle.end.bevel, strict=True)),
        "bevel_sd_deg": np.degrees(needle.end.roll_sd),
        "centerline_sd_rms_mm": np.sqrt(np.mean(reconstruction.sd**2)),
        "layers": " ".join(map(str, reconstruction.layers.sequence)),
        "warnings": "; ".join(reconstruction.warnings),
    }


def list_facts(reconstruction: Reconstruction) -> list[tuple[str, str]]:
    """Return name and value, with its unit, of what the page of a scan states."""
    crossed = zip(reconstruction.layers.boundaries, reconstruction.layers.sd, strict=True)
    row = {"crossing_depths": ", ".join(f"{depth:.2f} ± {sd:.2f}" for depth, sd in crossed) or None}
    row |= describe_scan(reconstruction)
    columns = [find_column(name) for name in _FACT_COLUMNS if row.get(name) is not None]
    return [(column.label, f"{column.format_cell(row)} {column.unit}") for column in columns]


def tabulate_failures(failures: Sequence[ReconstructionFailure]) -> pd.DataFrame:
    """Return the table of refused scans: why, and what would fix it."""
    rows = []
    for failure in failures:
        parts = {"refused": failure.error.what}
        parts |= {name: getattr(failure.error, name) for name in ("where", "expected", "fix")}
        words = ". ".join(f"{name}: {text}" for name, text in parts.items() if text)
        rows.append((failure.scan.id, failure.scan.volume.name, words))
    return pd.DataFrame(rows, columns=list(FRAMES["refused"]))


# ---- the report


def describe_batch(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    rows, remarks = to_records(run.frames["reconstruction"]), to_records(run.frames["remarks"])
    sided = [row for row in rows if row.get("bevel_x") is not None]  # earlier results have none
    passed = {row["id"]: list[dict[str, Any]]() for row in rows[:MAX_NAMED_SCANS]}
    for part in to_records(run.frames.get("passed", pd.DataFrame())):  # earlier results have none
        if part["id"] in passed:
            passed[part["id"]].append({**part, "length_mm": part["end_mm"] - part["begin_mm"]})
    poor = [{"id": row["id"], "sd_mm": row["depth_sd_mm"]} for row in rows]
    assert isinstance(run.record, ReconstructionBatchRecord)
    return {
        "unregistered": [row for row in rows if row["markers_known"] is None],
        "sided": sided[:MAX_NAMED_SCANS],
        "needle": run.record.recipe.needle,
        "scans": len(rows),
        "passed": {name: parts for name, parts in passed.items() if parts},
        "remarked": len({row["id"] for row in remarks}),
        "remarks": remarks,
        "poor": [row for row in poor if row["sd_mm"] > POOR_DEPTH_SD_MM],
        "named": MAX_NAMED_SCANS,
        "origin_mark": run.origin_mark,
    }


def lay_out_reconstructions(run: Run) -> TableLayout:
    """Return the main results of each scan."""
    rows = []
    for row in to_records(run.frames["reconstruction"]):
        crossings, remarks = (
            select_rows(run.frames[name], id=row["id"]) for name in ("crossings", "remarks")
        )
        depths = (f"{row['depth_mm']:.2f} ± {row['depth_sd_mm']:.2f}" for row in to_records(crossings))
        about = {"scan": row["id"], "remark_count": len(remarks) or ""}
        about["crossing_depths"] = ", ".join(depths) or None
        unregistered = {"target_error_tip_mm": None} if row["markers_known"] is None else {}
        rows.append({**row, **about, **unregistered})
    table = Table("reconstruction", rows, _COLUMNS)
    return TEXT.lay_out(table, describe_batch(run), drop_empty=True)


def lay_out_batch(run: Run) -> list[TableLayout]:
    """Return the main results of each scan, and the scans that were refused, if any were."""
    refused = to_records(run.frames["refused"])
    table = Table("refused", [{**row, "scan": row["id"]} for row in refused], ("scan", "note"))
    further = [TEXT.lay_out(table, {}, drop_empty=True)] if refused else []
    return [lay_out_reconstructions(run), *further]


def describe_scans(run: Run) -> FirstPage:
    """Return how many scans were reconstructed; remarks make it a warning. The table fits a terminal."""
    page = begin_first_page(run, "warn" if len(run.frames["remarks"]) else "pass")
    tables = [replace(lay_out_reconstructions(run), name="scans")]
    values = describe_batch(run)
    lost = values["unregistered"]
    finding, scan = ("scan_unregistered", lost[0]["id"]) if lost else ("scans_reconstructed", "")
    advice = advise([finding], {"scan": scan}, run.name, results=".")
    return replace(page, tables=tables, about=TEXT.sentence("about", values), advice=advice)


def draw_batch(run: Run) -> dict[str, Drawing]:
    """Return the deflection of each needle, with its pointwise 95 % band."""
    panel = Panel("deflection (mm)", line="y_mm", low="low_mm", high="high_mm")
    options = {"x": "x_mm", "by": "id", "x_label": "x along the entry (mm)", "panels": (panel,)}
    return {"deflections": Drawing("forms.curves", run.frames["deflections"], options)}


REPORT = StudyReport(
    TEXT,
    describe_batch,
    lay_out_batch,
    draw_batch,
    first_page=describe_scans,
    keeps_files=True,
)


def write_reconstruction(
    folder: Path,
    ones: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
    progress: Progress,
    refused: Sequence[ReconstructionFailure] = (),
    sources: Sequence[str] = (),
) -> tuple[Run | None, tuple[ReconstructionFailure, ...]]:
    """Write `folder`, completely or not at all; return its result, and what a dataset cannot contain.

    Where it can contain none, nothing is written, and what was there stays. A fault of the dataset as a whole
    is returned as a failure of every scan.

    The dataset; `quality/<id>.pdf`; `slicer/`, also of the scans that were `refused`; a first study of
    several insertions; `scenes/<id>.toml`; the files of every run. `sources` are those of the result.

    ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        kept, failures = assemble_checked(fresh, ones, recipe, description)
        if not kept:
            return None, failures
        refused = (*refused, *failures)
        for done, reconstruction in enumerate(kept):
            begun = STAGES["quality page"]
            percent = begun * len(kept) + (100 - begun) * done
            progress(f"{reconstruction.scan.id}: quality page", percent, 100 * len(kept))
            write_scan(reconstruction, fresh / "slicer")
            write_control_points(list_control_points(reconstruction), fresh / "slicer")
            write_quality(
                reconstruction,
                list_facts(reconstruction),
                fresh / "quality" / f"{reconstruction.scan.id}.pdf",
            )
        title = f"Reconstruction: {description.title or description.name}"
        record = KIND.make_record(
            title=title, scans=[reconstruction.scan.id for reconstruction in kept], recipe=recipe
        )
        assert isinstance(record, ReconstructionBatchRecord)
        dataset = read(fresh)
        write_first_runs(fresh, dataset)
        (fresh / "scenes").mkdir()
        for insertion in dataset.insertions:
            write_scene(fresh / "scenes" / f"{insertion.id}.toml", dataset, insertion)
        result = tabulate_batch(description.name, record, kept, refused, dataset.warnings)
        _write_refusals(refused, fresh)
        write_files(replace(result, timing=store_sources(sources, folder)), fresh)
    return result, failures


def write_control_points(points: Markups | None, folder: Path) -> None:
    """Write the control points of a scan, if there are any, to `<id>.corrections.mrk.json`."""
    if points is not None:
        folder.mkdir(exist_ok=True)
        style = CurveStyle(rgb(PAPER_COLOUR), POINT_SIZE_MM, locked=False)
        write_mrk_json(folder / f"{points.path.name}.{LIST_NAME}.mrk.json", [(points, style)])


def write_refused(failures: Sequence[ReconstructionFailure], folder: Path) -> None:
    """Write a folder of refused scans alone: `quality/`, `slicer/` and `refused.csv`.

    ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        _write_refusals(failures, fresh)
        write_csv(tabulate_failures(failures), fresh / "refused.csv")


def _write_refusals(failures: Sequence[ReconstructionFailure], folder: Path) -> None:
    """Write points and pictures of what was found in refused scans."""
    for failure in failures:
        write_control_points(failure.points, folder / "slicer")
        if failure.entries is not None:
            style = CurveStyle(rgb(PAPER_COLOUR), POINT_SIZE_MM)
            write_mrk_json(folder / "slicer" / f"{failure.scan.id}.mrk.json", [(failure.entries, style)])
        write_refusal_page(failure, folder / "quality" / f"{failure.scan.id}.pdf")
