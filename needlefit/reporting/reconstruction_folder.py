"""Write a batch of reconstructed scans as the folder of a dataset: tables, quality pages, files for 3D
Slicer.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.sources import ScanVolume, write_volumes
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import VERSIONED_PACKAGES, ReconstructionFailure
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.atomic_write import replace_folder
from needlefit.project.progress import Progress
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import MISSING, format_mm
from needlefit.reporting.quality import write_quality
from needlefit.reporting.slicer import write_scan
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.table_layout import TableColumn, TableLayout, drop_empty_columns, text_column
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.validation.provenance import package_versions

Row = dict[str, Any]

_SCAN_COLUMNS = (
    *("id", "origin", "medium", "specimen", "scan", "voxel_i_mm", "voxel_j_mm", "voxel_k_mm"),
    *("markers_from", "markers_found", "markers_known", "markers_paired", "fre_mm", "expected_fre_mm"),
    *("fre_p_value", "wrong_pairing_probability", "target_error_entry_mm", "target_error_tip_mm"),
    *("entry_pose_from", "entry_along_sd_mm", "entry_shift_sd_mm", "entry_angle_sd_deg"),
    *("bending_plane_from", "out_of_plane_rms_mm", "out_of_plane_max_mm", "depth_mm", "depth_sd_mm"),
    *("deflection_mm", "tip_along_sd_mm", "tip_across_sd_mm", "centerline_sd_rms_mm", "layers", "warnings"),
)
_MARKER_COLUMNS = (
    *("id", "found", "known", "found_x_mm", "found_y_mm", "found_z_mm", "found_sd_mm", "residual_x_mm"),
    *("residual_y_mm", "residual_z_mm", "residual_mm", "left_out_mm", "expected_left_out_mm"),
)
_CROSSING_COLUMNS = ("id", "number", "out_of", "into", "depth_mm", "depth_sd_mm", "x_mm", "y_mm", "z_mm")


def write_tables(reconstructions: Sequence[Reconstruction], folder: Path) -> tuple[Path, ...]:
    """Write `reconstruction.csv`, `markers.csv` and `crossings.csv` to `folder`; return the files."""
    tables = {
        "reconstruction": tabulate_reconstructions(reconstructions),
        "markers": tabulate_markers(reconstructions),
        "crossings": tabulate_crossings(reconstructions),
    }
    files = tuple(folder / f"{name}.csv" for name in tables)
    for frame, path in zip(tables.values(), files, strict=True):
        write_csv(frame, path)
    return files


def tabulate_reconstructions(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per scan; cells without a value (no markers) are empty."""
    rows = [
        _scan_values(one) | _registration_values(one) | _placement_values(one) | _needle_values(one)
        for one in reconstructions
    ]
    return pd.DataFrame(rows, columns=list(_SCAN_COLUMNS))


def tabulate_markers(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per pair of a found marker (position in the scan, LPS) and a known one, counted from 0.

    Residuals are known minus registered place, in the axes of the world; `left_out_mm` is the distance when
    the marker takes no part in the fit, `expected_left_out_mm` what the stated noise leads one to expect.
    """
    rows = [row for one in reconstructions for row in _marker_rows(one)]
    return pd.DataFrame(rows, columns=list(_MARKER_COLUMNS))


def tabulate_crossings(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per crossing: depth along C's x, its standard deviation, the layers, the position in the
    world.
    """
    rows = [row for one in reconstructions for row in _crossing_rows(one)]
    return pd.DataFrame(rows, columns=list(_CROSSING_COLUMNS))


def lay_out_reconstructions(reconstructions: Sequence[Reconstruction]) -> TableLayout:
    """Return the table for the screen: the main results of each scan."""
    columns = (
        *(
            text_column("Scan"),
            text_column("Medium"),
            TableColumn("Inserted", "mm"),
            TableColumn("±"),
            TableColumn("Deflection", "mm"),
        ),
        *(
            TableColumn("Out of plane", "mm"),
            TableColumn("Markers"),
            TableColumn("FRE", "mm"),
            TableColumn("Expected", "mm"),
        ),
        *(
            TableColumn("Target error", "mm"),
            text_column("Pose from"),
            text_column("Layers at (mm)"),
            TableColumn("Remarks"),
        ),
    )
    synthetic = any(one.scan.origin == "synthetic" for one in reconstructions)
    caption = "Reconstructed scans" + (" (synthetic data)" if synthetic else "")
    notes = ("Out of plane: greatest distance. Target error: predicted, at the tip. Remarks: see quality/.",)
    rows = tuple(_scan_cells(one) for one in reconstructions)
    return drop_empty_columns(TableLayout("reconstruction", caption, columns, rows, notes=notes))


def _scan_cells(one: Reconstruction) -> tuple[str, ...]:
    row = tabulate_reconstructions([one]).iloc[0]
    registered = one.registration is not None
    depths = ", ".join(
        f"{depth:.2f} ± {sd:.2f}" for depth, sd in zip(one.layers.boundaries, one.layers.sd, strict=True)
    )
    return (
        *(one.scan.id, medium_name(one.scan.medium), format_mm(one.depth), format_mm(one.depth_sd)),
        *(format_mm(row["deflection_mm"]), format_mm(row["out_of_plane_max_mm"])),
        f"{row['markers_paired']}/{row['markers_known']}" if registered else MISSING,
        *(format_mm(row["fre_mm"]), format_mm(row["expected_fre_mm"])),
        format_mm(one.target_error[1]) if registered else MISSING,
        *(one.pose.source, depths or MISSING, str(len(one.warnings) or "")),
    )


def _scan_values(one: Reconstruction) -> Row:
    scan = one.scan
    i, j, k = one.spacing
    named = {"id": scan.id, "origin": scan.origin, "medium": scan.medium, "specimen": scan.specimen}
    voxel = {"voxel_i_mm": i, "voxel_j_mm": j, "voxel_k_mm": k}
    return named | {"scan": scan.volume.name} | voxel | {"warnings": "; ".join(one.warnings)}


def _registration_values(one: Reconstruction) -> Row:
    markers, registration = one.markers, one.registration
    if markers is None or registration is None:
        return {}
    return {
        "markers_from": markers.source,
        "markers_found": len(markers.centers),
        "markers_known": registration.known,
        "markers_paired": len(registration.pairs),
        "fre_mm": registration.fre,
        "expected_fre_mm": registration.expected_fre,
        "fre_p_value": registration.p_value,
        "wrong_pairing_probability": registration.wrong_pairing_probability,
        "target_error_entry_mm": one.target_error[0],
        "target_error_tip_mm": one.target_error[1],
    }


def _placement_values(one: Reconstruction) -> Row:
    off = one.local[:, 2]
    return {
        "entry_pose_from": one.pose.source,
        "entry_along_sd_mm": one.pose.along_sd,
        "entry_shift_sd_mm": one.pose.shift_sd,
        "entry_angle_sd_deg": np.degrees(one.pose.angle_sd),
        "bending_plane_from": one.plane,
        "out_of_plane_rms_mm": np.sqrt(np.mean(off**2)),
        "out_of_plane_max_mm": np.abs(off).max(),
    }


def _needle_values(one: Reconstruction) -> Row:
    along_sd, across_sd = one.needle_axis.tip_sd
    return {
        "depth_mm": one.depth,
        "depth_sd_mm": one.depth_sd,
        "deflection_mm": one.local[-1, 1],
        "tip_along_sd_mm": along_sd,
        "tip_across_sd_mm": across_sd,
        "centerline_sd_rms_mm": np.sqrt(np.mean(one.sd**2)),
        "layers": " ".join(map(str, one.layers.sequence)),
    }


def _marker_rows(one: Reconstruction) -> list[Row]:
    markers, registration = one.markers, one.registration
    if markers is None or registration is None:
        return []
    rows = []
    for n, (found, known) in enumerate(registration.pairs):
        values = (
            *(one.scan.id, found, known, *markers.centers[found], markers.sd[found]),
            *(*registration.residuals[n], np.linalg.norm(registration.residuals[n])),
            *(registration.leave_one_out[n], registration.expected_leave_one_out[n]),
        )
        rows.append(dict(zip(_MARKER_COLUMNS, values, strict=True)))
    return rows


def _crossing_rows(one: Reconstruction) -> list[Row]:
    layers = one.layers
    rows = []
    for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True)):
        values = (one.scan.id, n + 1, *layers.sequence[n : n + 2], depth, sd, *layers.points[n])
        rows.append(dict(zip(_CROSSING_COLUMNS, values, strict=True)))
    return rows


RECONSTRUCTION_FILE = "reconstruction.json"


def write_reconstruction(
    folder: Path,
    ones: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
    progress: Progress,
) -> tuple[tuple[Reconstruction, ...], tuple[ReconstructionFailure, ...]]:
    """Write `folder`, completely or not at all; return its contents, and what a dataset cannot contain.

    Where none can be held nothing is written, and what was there stays.

    The dataset, and where its scans lie; `reconstruction.csv`, `markers.csv`, `crossings.csv`;
    `quality/<id>.pdf`; `slicer/`; and `reconstruction.json`: versions and recipe.

    Raises
    ------
    DataError
        If the dataset has a fault that belongs to no single scan.
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        kept, failures = assemble_checked(fresh, ones, recipe, description)
        if not kept:
            return kept, failures
        volumes = {one.scan.id: ScanVolume(one.scan.volume, one.scan.series) for one in kept}
        write_volumes(fresh, volumes, folder)
        write_tables(kept, fresh)
        for done, one in enumerate(kept):
            progress(f"{one.scan.id}: quality page", done, len(kept))
            write_quality(one, fresh / "quality" / f"{one.scan.id}.pdf")
            write_scan(one, fresh / "slicer", recipe.needle.diameter_mm)
        write_json(fresh / RECONSTRUCTION_FILE, _describe_recipe(recipe))
    return kept, failures


def _describe_recipe(recipe: ReconstructionRecord) -> dict[str, Any]:
    return {
        "versions": package_versions(VERSIONED_PACKAGES),
        "recipe": recipe.model_dump(mode="json", by_alias=True),
    }
