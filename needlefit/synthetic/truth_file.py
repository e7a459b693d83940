"""Write the truth of a synthetic dataset, and its reconstruction errors, to a file that no fit opens."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.mechanics.needle import Needle
from needlefit.project.toml_text import dumps
from needlefit.synthetic import truth
from needlefit.synthetic.ct_scene import Scanner, Scene3D
from needlefit.synthetic.design import PlannedInsertion
from needlefit.synthetic.exposure import WHOLE_BOX_SETUP, Exposure
from needlefit.synthetic.insertion import SUBLAYER_THICKNESS_MM, TRUTH_OPTIONS, SyntheticInsertion
from needlefit.synthetic.metal import densify
from needlefit.synthetic.truth import LOG_MU_SD, NOMINAL_NEEDLE, TRUE_MEDIA, MediumTruth, TrueSpecimen


@dataclass(frozen=True)
class ReconstructedInsertion:
    """One insertion with its scan and its reconstruction."""

    insertion: SyntheticInsertion
    exposure: Exposure
    reconstruction: Reconstruction


def registration_errors(built: ReconstructedInsertion) -> Floats:
    """Return how far the registration moves each point of the true centreline (N,), mm."""
    true = built.insertion.true_insertion.centerline
    moved = built.reconstruction.patient.to_world(built.exposure.scene.box.to_world(true))
    errors: Floats = np.linalg.norm(moved - true, axis=1)
    return errors


def centerline_errors(built: ReconstructedInsertion) -> Floats:
    """Return the distance of each reconstructed point (N,) from the true needle, in the world, mm."""
    scene = built.exposure.scene
    true = scene.box.to_local(densify(scene.needles[0].points))
    return np.asarray(cKDTree(true).query(built.reconstruction.points)[0], dtype=np.float64)


def tip_error(built: ReconstructedInsertion) -> float:
    """Return the distance of the reconstructed tip from the true one, in the world, mm."""
    return float(
        np.linalg.norm(built.reconstruction.points[-1] - built.insertion.true_insertion.centerline[-1])
    )


SIGNIFICANT_DIGITS = 6
"""Significant digits of every number."""

TRUTH_NOTE = (
    "What the synthetic twin was generated from. Nothing that fits, validates or reads datasets opens this "
    "file. mu_pa of an insertion are the moduli along the needle, of the layers met or of 2 mm slices of a "
    "heterogeneous piece; deflection_mm is that of the tip from the entry, axis_deflection_mm from the "
    "entry axis, toward the bevel. "
    "registration_error_mm is the mean over the true needle of how far its markers misplace it, "
    "centerline_error_mm the mean distance of the reconstructed points from the true needle, tip_error_mm "
    "that of the two tips; both with the registration's error."
)


def write_truth(path: Path, seed: int, built: Sequence[ReconstructedInsertion]) -> None:
    """Write the truth of the insertions `built` to the TOML file `path`."""
    tables = {
        "schema": 1,
        "origin": "synthetic",
        "seed": seed,
        "note": TRUTH_NOTE,
        "specimens": _specimen_tables(seed, [one.insertion.planned for one in built]),
        "insertions": [_insertion_table(one) for one in built],
        "needle": _needle_table(truth.draw_needle(seed)),
        "model": {
            "constraint_spacing_mm": TRUTH_OPTIONS.spacing,
            "element_mm": TRUTH_OPTIONS.element,
            "slice_mm": SUBLAYER_THICKNESS_MM,
        },
        "media": {name: _medium_table(name, medium) for name, medium in TRUE_MEDIA.items()},
        "deviations": _deviations_table(),
        "markers": {"places_mm": WHOLE_BOX_SETUP.markers.tolist(), "stated_sd_mm": WHOLE_BOX_SETUP.known_sd},
        "groups": _group_deflections(built),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(dumps(tables).encode("utf-8"))


def _needle_table(needle: Needle) -> dict[str, Any]:
    return {
        "length_mm": needle.length,
        "flexural_rigidity_nmm2": _round(needle.flexural_rigidity),
        "nominal_flexural_rigidity_nmm2": _round(NOMINAL_NEEDLE.flexural_rigidity),
    }


def _medium_table(name: str, medium: MediumTruth) -> dict[str, Any]:
    return {
        "mu_pa": medium.mu_pa,
        "alpha": medium.alpha,
        "bevel_mm": medium.bevel,
        "friction": medium.friction,
        "hu": medium.hu,
        "specimen_sd_of_ln_mu": LOG_MU_SD[name],
    }


def _deviations_table() -> dict[str, Any]:
    """Summarise what was drawn: standard deviations (sd) and others."""
    return {
        "rigidity_relative_range": truth.RIGIDITY_DEVIATION,
        "chicken_field_sd_of_ln_mu": truth.FIELD_LOG_MU_SD,
        "chicken_field_length_mm": truth.FIELD_LENGTH_MM,
        "layer_place_sd_mm": truth.LAYER_SD_MM,
        "bevel_plane_sd_deg": truth.ROLL_SD_DEG,
        "pose_shift_sd_mm": truth.POSE_SHIFT_SD_MM,
        "pose_angle_sd_deg": truth.POSE_ANGLE_SD_DEG,
    }


def _specimen_tables(seed: int, plan: Sequence[PlannedInsertion]) -> list[dict[str, Any]]:
    pairs = dict.fromkeys((planned.medium, planned.specimen) for planned in plan)
    return [_specimen_table(truth.draw_specimen(seed, *pair)) for pair in pairs]


def _specimen_table(specimen: TrueSpecimen) -> dict[str, Any]:
    tops = [float(surface.mesh.bounds[0, 0]) for surface in specimen.surfaces]
    return {
        "name": specimen.name,
        "medium": specimen.medium,
        "mu_pa": _round_all(specimen.mu * 1e6),
        "alpha": specimen.alpha.tolist(),
        "layer_tops_mm": _round_all(tops),
    }


def _insertion_table(built: ReconstructedInsertion) -> dict[str, Any]:
    insertion, true_insertion, deviations = (
        built.insertion,
        built.insertion.true_insertion,
        built.insertion.deviations,
    )
    return {
        "id": insertion.planned.id,
        "deflection_mm": _round(true_insertion.deflection),
        "axis_deflection_mm": _round(true_insertion.shape.tip_lateral),
        "tip_mm": _round_all(true_insertion.centerline[-1]),
        "out_of_plane_mm": _round(float(true_insertion.frame.to_local(true_insertion.centerline)[-1, 2])),
        "bevel_mm": _round(truth.bevel_offset(insertion.specimen, insertion.planned)),
        "sequence": true_insertion.sequence,
        "boundaries_mm": _round_all(true_insertion.boundaries),
        "mu_pa": _round_all(true_insertion.tissue.mu * 1e6),
        "bevel_plane_deg": _round(np.degrees(deviations.roll)),
        "pose_shift_mm": _round_all(deviations.shift),
        "pose_angle_deg": _round_all(np.degrees(deviations.tilt)),
        "registration_error_mm": _round(float(registration_errors(built).mean())),
        "centerline_error_mm": _round(float(centerline_errors(built).mean())),
        "tip_error_mm": _round(tip_error(built)),
        **_scan_table(built.exposure.scene, built.exposure.scanner),
    }


def _scan_table(scene: Scene3D, scanner: Scanner) -> dict[str, Any]:
    """Return how an insertion was scanned."""
    needle = scene.needles[0]
    return {
        "bevel_deg": _round(needle.bevel_deg),
        "needle_hu": _round(needle.hu),
        "psf_mm": _round(scanner.psf_mm),
        "noise_hu": _round(scanner.noise_hu),
        "bloom": _round(scanner.bloom),
        "streaks": _round(scanner.streaks),
        "cupping_hu": _round(scanner.cupping_hu),
    }


def _group_deflections(built: Sequence[ReconstructedInsertion]) -> dict[str, float]:
    """Return the mean deflection (mm) of each medium and number of layers."""
    members: dict[str, list[float]] = {}
    for insertion in (one.insertion for one in built):
        key = f"{insertion.planned.medium}_layers{insertion.planned.layers}_mean_deflection_mm"
        members.setdefault(key, []).append(insertion.true_insertion.deflection)
    return {key: _round(float(np.mean(values))) for key, values in members.items()}


def _round(value: float) -> float:
    """Return `value` to `SIGNIFICANT_DIGITS` significant digits; never -0."""
    return float(f"{float(value):.{SIGNIFICANT_DIGITS}g}") + 0.0


def _round_all(values: ArrayLike) -> list[float]:
    return [_round(value) for value in np.asarray(values, dtype=np.float64).tolist()]
