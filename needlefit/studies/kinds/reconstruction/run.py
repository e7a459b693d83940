"""Tabulate a batch of reconstructed scans."""

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.geometry.curves import interpolate_at_arc
from needlefit.imaging.batch import VERSIONED_PACKAGES
from needlefit.imaging.reconstruction import ProposedInterface, Reconstruction
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.studies.job import Settings
from needlefit.studies.kinds.reconstruction.schema import ReconstructionBatchRecord
from needlefit.studies.provenance import package_versions
from needlefit.studies.run import Run
from needlefit.studies.score import Row

_SCAN_COLUMNS = (
    *("id", "origin", "medium", "specimen", "scan", "voxel_i_mm", "voxel_j_mm", "voxel_k_mm"),
    *("markers_from", "markers_found", "markers_known", "markers_paired", "fre_mm", "expected_fre_mm"),
    *("fre_p_value", "wrong_pairing_probability", "target_error_entry_mm", "target_error_tip_mm"),
    *("entry_pose_from", "entry_along_sd_mm", "entry_shift_sd_mm", "entry_angle_sd_deg"),
    *("bending_plane_from", "out_of_plane_rms_mm", "out_of_plane_max_mm", "depth_mm", "depth_sd_mm"),
    *("deflection_mm", "tip_along_sd_mm", "tip_across_sd_mm"),
    *("bevel_probability", "centerline_sd_rms_mm", "layers", "warnings"),
)
_MARKER_COLUMNS = (
    *("id", "found", "known", "found_x_mm", "found_y_mm", "found_z_mm", "found_sd_mm", "residual_x_mm"),
    *("residual_y_mm", "residual_z_mm", "residual_mm", "left_out_mm", "expected_left_out_mm"),
)
_CROSSING_COLUMNS = ("id", "number", "out_of", "into", "depth_mm", "depth_sd_mm", "x_mm", "y_mm", "z_mm")


def run(name: str, record: ReconstructionBatchRecord, settings: Settings) -> Run:
    """Raise ConfigError: scans become a dataset, which a study file has no place for."""
    raise ConfigError("is no study that can be run", where=name, fix="use: needlefit reconstruct SCAN...")


def tabulate_batch(
    name: str,
    record: ReconstructionBatchRecord,
    ones: Sequence[Reconstruction],
    warnings: Iterable[ResultWarning] = (),
) -> Run:
    """Return the result of a batch; `warnings` are those of the dataset."""
    remarks = [(one.scan.id, remark) for one in ones for remark in one.warnings]
    return Run(
        kind=record.kind,
        name=name,
        record=record,
        origin="synthetic" if any(one.scan.origin == "synthetic" for one in ones) else "measured",
        dataset_title=record.title.removeprefix("Reconstruction: "),
        frames={
            "reconstruction": tabulate_reconstructions(ones),
            "markers": tabulate_markers(ones),
            "crossings": tabulate_crossings(ones),
            "remarks": pd.DataFrame(remarks, columns=["id", "note"]),
            **tabulate_proposals(ones),
        },
        run={
            "name": name,
            "versions": package_versions(VERSIONED_PACKAGES),
            "study": record.model_dump(mode="json", by_alias=True),
            **warnings_entry(warnings),
        },
        timing={},
    )


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
    """Return a row per crossing: depth along C's x and its deviation, layers, position in the world."""
    rows = [row for one in reconstructions for row in _crossing_rows(one)]
    return pd.DataFrame(rows, columns=list(_CROSSING_COLUMNS))


def tabulate_proposals(reconstructions: Sequence[Reconstruction]) -> dict[str, pd.DataFrame]:
    """Return a table of proposed interfaces, as `tabulate_crossings`; none where nobody asked for any."""
    asked = [one for one in reconstructions if one.proposals is not None]
    rows = [row for one in asked for row in _proposal_rows(one)]
    columns = [*_CROSSING_COLUMNS, "note"]
    return {"proposed_layers": pd.DataFrame(rows, columns=columns)} if asked else {}


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
        "deflection_mm": one.scan.side * one.local[-1, 1],
        "tip_along_sd_mm": along_sd,
        "tip_across_sd_mm": across_sd,
        "bevel_probability": one.needle_axis.bevel_probability,
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


def _proposal_rows(one: Reconstruction) -> list[Row]:
    rows = []
    for n, found in enumerate(one.proposals or (), start=1):
        point = locate_proposal(one, found)
        depth = float(one.frame.to_local(point[None])[0, 0])
        note = f"{found.step:+.0f} HU, tilted by {np.degrees(found.tilt):.0f} degrees; {find_own(one, depth)}"
        values = (one.scan.id, n, n, n + 1, depth, found.sd, *point, note)
        rows.append(dict(zip((*_CROSSING_COLUMNS, "note"), values, strict=True)))
    return rows


def locate_proposal(one: Reconstruction, found: ProposedInterface) -> Floats:
    """Return where the needle crosses a proposed interface (3,), world, mm."""
    point: Floats = interpolate_at_arc(one.points, np.array([found.at]))[0]
    return point


def find_own(one: Reconstruction, depth: float) -> str:
    """Return in words how far the nearest stated layer lies from a depth (mm)."""
    own = one.layers.boundaries
    if not len(own):
        return "no layer is stated"
    return (
        f"the nearest stated layer is crossed {own[np.argmin(np.abs(own - depth))] - depth:+.2f} mm from it"
    )
