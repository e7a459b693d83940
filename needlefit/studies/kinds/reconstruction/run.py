"""Tabulate a batch of reconstructed scans, and those that were refused."""

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, NeedlefitError
from needlefit.geometry.curves import interpolate_at_arc
from needlefit.imaging.batch import VERSIONED_PACKAGES, Findings, ReconstructionFailure
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.studies.job import Settings
from needlefit.studies.kinds.reconstruction import ReconstructionBatchRecord
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
_REFUSED_COLUMNS = ("id", "scan", "note")
_CANDIDATE_COLUMNS = (
    *("id", "kind", "number", "x_mm", "y_mm", "z_mm", "width_mm", "depth_mm", "depth_sd_mm", "note"),
)


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
    return pd.DataFrame([_describe(one) for one in reconstructions], columns=list(_SCAN_COLUMNS))


def tabulate_markers(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return one row per pair of a found marker (position in the scan, LPS) and a known one, counted from 0.

    Residuals are known minus registered place, in the axes of the world; `left_out_mm` is the distance when
    the marker takes no part in the fit, `expected_left_out_mm` what the stated noise leads one to expect.
    """
    rows = [
        (
            *(one.scan.id, found, known, *one.markers.centers[found], one.markers.sd[found]),
            *(*fit.residuals[n], np.linalg.norm(fit.residuals[n])),
            *(fit.leave_one_out[n], fit.expected_leave_one_out[n]),
        )
        for one in reconstructions
        if one.markers is not None and (fit := one.registration) is not None
        for n, (found, known) in enumerate(fit.pairs)
    ]
    return pd.DataFrame(rows, columns=list(_MARKER_COLUMNS))


def tabulate_crossings(reconstructions: Sequence[Reconstruction]) -> pd.DataFrame:
    """Return a row per crossing: depth along C's x and its deviation, layers, position in the world."""
    rows = [
        (one.scan.id, n + 1, *layers.sequence[n : n + 2], depth, sd, *layers.points[n])
        for one in reconstructions
        for layers in [one.layers]
        for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True))
    ]
    return pd.DataFrame(rows, columns=list(_CROSSING_COLUMNS))


def tabulate_proposals(reconstructions: Sequence[Reconstruction]) -> dict[str, pd.DataFrame]:
    """Return a table of proposed interfaces, as `tabulate_crossings`; none where nobody asked for any."""
    asked = [one for one in reconstructions if one.proposals is not None]
    rows = []
    for one in asked:
        for n, found in enumerate(one.proposals or (), start=1):
            point = interpolate_at_arc(one.points, np.array([found.at]))[0]
            depth = float(one.frame.to_local(point[None])[0, 0])
            tilt = f"{found.step:+.0f} HU, tilted by {np.degrees(found.tilt):.0f} degrees"
            note = f"{tilt}; {_find_own(one, depth)}"
            rows.append((one.scan.id, n, n, n + 1, depth, found.sd, *point, note))
    columns = [*_CROSSING_COLUMNS, "note"]
    return {"proposed_layers": pd.DataFrame(rows, columns=columns)} if asked else {}


def _find_own(one: Reconstruction, depth: float) -> str:
    """Return in words how far the nearest stated layer lies from a depth (mm)."""
    own = one.layers.boundaries
    if not len(own):
        return "no layer is stated"
    away = own[np.argmin(np.abs(own - depth))] - depth
    return f"the nearest stated layer is crossed {away:+.2f} mm from it"


def _describe(one: Reconstruction) -> Row:
    scan, markers, fit, off = one.scan, one.markers, one.registration, one.local[:, 2]
    row: Row = {
        **{name: getattr(scan, name) for name in ("id", "origin", "medium", "specimen")},
        "scan": scan.volume.name,
        **dict(zip(("voxel_i_mm", "voxel_j_mm", "voxel_k_mm"), one.spacing, strict=True)),
        "entry_pose_from": one.pose.source,
        "entry_along_sd_mm": one.pose.along_sd,
        "entry_shift_sd_mm": one.pose.shift_sd,
        "entry_angle_sd_deg": np.degrees(one.pose.angle_sd),
        "bending_plane_from": one.plane,
        "out_of_plane_rms_mm": np.sqrt(np.mean(off**2)),
        "out_of_plane_max_mm": np.abs(off).max(),
        "depth_mm": one.depth,
        "depth_sd_mm": one.depth_sd,
        "deflection_mm": one.deflection,
        **dict(zip(("tip_along_sd_mm", "tip_across_sd_mm"), one.needle_axis.tip_sd, strict=True)),
        "bevel_probability": one.needle_axis.bevel_probability,
        "centerline_sd_rms_mm": np.sqrt(np.mean(one.sd**2)),
        "layers": " ".join(map(str, one.layers.sequence)),
        "warnings": "; ".join(one.warnings),
    }
    if markers is None or fit is None:
        return row
    return row | {
        "markers_from": markers.source,
        "markers_found": len(markers.centers),
        "markers_known": fit.known,
        "markers_paired": len(fit.pairs),
        "fre_mm": fit.fre,
        "expected_fre_mm": fit.expected_fre,
        "fre_p_value": fit.p_value,
        "wrong_pairing_probability": fit.wrong_pairing_probability,
        **dict(zip(("target_error_entry_mm", "target_error_tip_mm"), one.target_error, strict=True)),
    }


def tabulate_failures(failures: Sequence[ReconstructionFailure]) -> dict[str, pd.DataFrame]:
    """Return the tables of refused scans: why, and what would fix it; what was found, LPS, mm.

    Tubes have a row for each end; balls and places of entry one each.
    """
    why = [(one.scan.id, one.scan.volume.name, ". ".join(list_reasons(one.error))) for one in failures]
    rows = [row for one in failures if one.findings for row in _list_rows(one.scan.id, one.findings)]
    return {
        "refused": pd.DataFrame(why, columns=list(_REFUSED_COLUMNS)),
        "candidates": pd.DataFrame(rows, columns=list(_CANDIDATE_COLUMNS)),
    }


def list_reasons(error: NeedlefitError) -> list[str]:
    """Return the parts of an error, each in words."""
    named = {"where": error.where, "expected": error.expected, "fix": error.fix}
    return [f"refused: {error.what}", *(f"{name}: {text}" for name, text in named.items() if text)]


def _list_rows(id_: str, found: Findings) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []

    def add(kind: str, number: int, at: Floats, **more: object) -> None:
        place = dict(zip(("x_mm", "y_mm", "z_mm"), at.tolist(), strict=True))
        rows.append({"id": id_, "kind": kind, "number": number, **place, **more})

    for n, tube in enumerate(found.tubes, start=1):
        note = f"{tube.length:.1f} mm long" + (", taken as the needle" if tube.chosen else "")
        for end in tube.ends:
            add("tube", n, end, width_mm=tube.width, note=note)
    for n, ball in enumerate(found.balls, start=1):
        add("ball", n, ball.center, width_mm=ball.diameter, note="marker" if ball.marker else "")
    for n, (one, at) in enumerate(zip(found.entries, found.entry_points, strict=True), start=1):
        note = "air before it" if one.change == "rise" else "another soft material before it"
        add("entry", n, at, depth_mm=one.depth, depth_sd_mm=one.sd, note=note)
    return rows
