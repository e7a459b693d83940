"""Tables of a batch of reconstructed scans: CSV for machines, a short one for the screen."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.imaging.reconstruction import Reconstruction
from needlefit.reporting.display import Column, Display, text, without_empty
from needlefit.reporting.files import write_csv
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import MISSING, fixed

Row = dict[str, Any]

_SCAN = (
    *("id", "origin", "medium", "specimen", "scan", "voxel_i_mm", "voxel_j_mm", "voxel_k_mm"),
    *("markers_from", "markers_found", "markers_known", "markers_paired", "fre_mm", "expected_fre_mm"),
    *("fre_p_value", "wrong_pairing_probability", "target_error_entry_mm", "target_error_tip_mm"),
    *("entry_pose_from", "entry_along_sd_mm", "entry_shift_sd_mm", "entry_angle_sd_deg"),
    *("bending_plane_from", "out_of_plane_rms_mm", "out_of_plane_max_mm", "depth_mm", "depth_sd_mm"),
    *("deflection_mm", "tip_along_sd_mm", "tip_across_sd_mm", "centerline_sd_rms_mm", "layers", "warnings"),
)
_MARKER = (
    *("id", "found", "known", "found_x_mm", "found_y_mm", "found_z_mm", "found_sd_mm", "residual_x_mm"),
    *("residual_y_mm", "residual_z_mm", "residual_mm", "left_out_mm", "expected_left_out_mm"),
)
_CROSSING = ("id", "number", "out_of", "into", "depth_mm", "depth_sd_mm", "x_mm", "y_mm", "z_mm")


def write_tables(reconstructions: Sequence[Reconstruction], folder: Path) -> tuple[Path, ...]:
    """Write `reconstruction.csv`, `markers.csv` and `crossings.csv` to `folder`; return the files."""
    tables = {
        "reconstruction": reconstruction_table(reconstructions),
        "markers": marker_table(reconstructions),
        "crossings": crossing_table(reconstructions),
    }
    files = tuple(folder / f"{name}.csv" for name in tables)
    for frame, path in zip(tables.values(), files, strict=True):
        write_csv(frame, path)
    return files


def reconstruction_table(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per scan; what it did not have (markers) is empty."""
    rows = [_scan(one) | _registered(one) | _placed(one) | _needle(one) for one in reconstructions]
    return pd.DataFrame(rows, columns=list(_SCAN))


def marker_table(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per pair of a found marker (its place in the scan, LPS) and a known one, from 0.

    Residuals are known minus registered place, in the axes of the world; `left_out_mm` is the distance when
    the marker takes no part in the fit, `expected_left_out_mm` what the stated noise leads one to expect.
    """
    rows = [row for one in reconstructions for row in _pairs(one)]
    return pd.DataFrame(rows, columns=list(_MARKER))


def crossing_table(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per crossing: depth along C's x, its deviation, the layers, the place in the world."""
    rows = [row for one in reconstructions for row in _crossed(one)]
    return pd.DataFrame(rows, columns=list(_CROSSING))


def reconstructions_layout(reconstructions: Sequence[Reconstruction]) -> Display:
    """Return the table for the screen: what a person asks first of each scan."""
    columns = (
        *(text("Scan"), text("Medium"), Column("Inserted", "mm"), Column("±"), Column("Deflection", "mm")),
        *(Column("Out of plane", "mm"), Column("Markers"), Column("FRE", "mm"), Column("Expected", "mm")),
        *(Column("Target error", "mm"), text("Pose from"), text("Layers at (mm)"), Column("Remarks")),
    )
    synthetic = any(one.scan.origin == "synthetic" for one in reconstructions)
    caption = "Reconstructed scans" + (" (synthetic data)" if synthetic else "")
    notes = ("Out of plane: greatest distance. Target error: predicted, at the tip. Remarks: see quality/.",)
    rows = tuple(_cells(one) for one in reconstructions)
    return without_empty(Display("reconstruction", caption, columns, rows, notes=notes))


def _cells(one: Reconstruction) -> tuple[str, ...]:
    row = reconstruction_table([one]).iloc[0]
    registered = one.registration is not None
    depths = ", ".join(
        f"{depth:.2f} ± {sd:.2f}" for depth, sd in zip(one.layers.boundaries, one.layers.sd, strict=True)
    )
    return (
        *(one.scan.id, medium_name(one.scan.medium), fixed(one.depth), fixed(one.depth_sd)),
        *(fixed(row["deflection_mm"]), fixed(row["out_of_plane_max_mm"])),
        f"{row['markers_paired']}/{row['markers_known']}" if registered else MISSING,
        *(fixed(row["fre_mm"]), fixed(row["expected_fre_mm"])),
        fixed(one.target_error[1]) if registered else MISSING,
        *(one.pose.source, depths or MISSING, str(len(one.warnings) or "")),
    )


def _scan(one: Reconstruction) -> Row:
    scan = one.scan
    i, j, k = one.spacing
    named = {"id": scan.id, "origin": scan.origin, "medium": scan.medium, "specimen": scan.specimen}
    voxel = {"voxel_i_mm": i, "voxel_j_mm": j, "voxel_k_mm": k}
    return named | {"scan": scan.volume.name} | voxel | {"warnings": "; ".join(one.warnings)}


def _registered(one: Reconstruction) -> Row:
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


def _placed(one: Reconstruction) -> Row:
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


def _needle(one: Reconstruction) -> Row:
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


def _pairs(one: Reconstruction) -> list[Row]:
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
        rows.append(dict(zip(_MARKER, values, strict=True)))
    return rows


def _crossed(one: Reconstruction) -> list[Row]:
    layers = one.layers
    rows = []
    for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True)):
        values = (one.scan.id, n + 1, *layers.sequence[n : n + 2], depth, sd, *layers.points[n])
        rows.append(dict(zip(_CROSSING, values, strict=True)))
    return rows
