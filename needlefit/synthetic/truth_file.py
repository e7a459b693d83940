"""The truth of a twin in a file of its own, which no code that fits ever opens."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needlefit.datasets.formats.toml import dumps
from needlefit.mechanics.needle import Needle
from needlefit.synthetic import truth
from needlefit.synthetic.built import Built, centerline_errors, registration_errors, tip_error
from needlefit.synthetic.ct.scene import Scanner, Scene3D
from needlefit.synthetic.ct.setup import WHOLE
from needlefit.synthetic.design import Planned
from needlefit.synthetic.insert import RULES, SUBLAYER
from needlefit.synthetic.truth import MEDIA, MU_SD, NOMINAL, MediumTruth, Specimen

DIGITS = 6
"""Significant digits of every number."""

NOTE = (
    "What the synthetic twin was generated from. Nothing that fits, validates or reads datasets opens this "
    "file. mu_pa of an insertion are the moduli along the needle, of the layers met or of 2 mm slices of a "
    "heterogeneous piece; deflection_mm is that of the tip from the entry, tip_y_mm from the entry axis. "
    "registration_error_mm is the mean over the true needle of how far its markers misplace it, "
    "centerline_error_mm the mean distance of the reconstructed points from the true needle, tip_error_mm "
    "that of the two tips; both with the registration's error."
)


def write_truth(path: Path, seed: int, built: Sequence[Built]) -> None:
    """Write what is true of the insertions `built` to the TOML file `path`."""
    tables = {
        "schema": 1,
        "origin": "synthetic",
        "seed": seed,
        "note": NOTE,
        "specimens": _specimens(seed, [one.twin.planned for one in built]),
        "insertions": [_insertion(one) for one in built],
        "needle": _needle(truth.true_needle(seed)),
        "model": {"constraint_spacing_mm": RULES.spacing, "element_mm": RULES.element, "slice_mm": SUBLAYER},
        "media": {name: _medium(name, medium) for name, medium in MEDIA.items()},
        "deviations": _deviations(),
        "markers": {"places_mm": WHOLE.markers.tolist(), "stated_sd_mm": WHOLE.known_sd},
        "groups": _groups(built),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(dumps(tables).encode("utf-8"))


def _needle(needle: Needle) -> dict[str, Any]:
    return {
        "length_mm": needle.length,
        "flexural_rigidity_nmm2": _round(needle.flexural_rigidity),
        "nominal_flexural_rigidity_nmm2": _round(NOMINAL.flexural_rigidity),
    }


def _medium(name: str, medium: MediumTruth) -> dict[str, Any]:
    return {
        "mu_pa": medium.mu_pa,
        "alpha": medium.alpha,
        "bevel_mm": medium.bevel,
        "friction": medium.friction,
        "hu": medium.hu,
        "specimen_sd_of_ln_mu": MU_SD[name],
    }


def _deviations() -> dict[str, Any]:
    """Summarise what was drawn: standard deviations (sd) and others."""
    return {
        "rigidity_relative_range": truth.RIGIDITY_OFF,
        "chicken_field_sd_of_ln_mu": truth.FIELD_SD,
        "chicken_field_length_mm": truth.FIELD_LENGTH,
        "layer_place_sd_mm": truth.LAYER_SD,
        "bevel_plane_sd_deg": truth.ROLL_SD,
        "pose_shift_sd_mm": truth.POSE_SHIFT_SD,
        "pose_angle_sd_deg": truth.POSE_ANGLE_SD,
    }


def _specimens(seed: int, plan: Sequence[Planned]) -> list[dict[str, Any]]:
    pairs = dict.fromkeys((planned.medium, planned.specimen) for planned in plan)
    return [_specimen(truth.true_specimen(seed, *pair)) for pair in pairs]


def _specimen(specimen: Specimen) -> dict[str, Any]:
    tops = [float(surface.mesh.bounds[0, 0]) for surface in specimen.surfaces]
    return {
        "name": specimen.name,
        "medium": specimen.medium,
        "mu_pa": _rounded(specimen.mu * 1e6),
        "alpha": specimen.alpha.tolist(),
        "layer_tops_mm": _rounded(tops),
    }


def _insertion(built: Built) -> dict[str, Any]:
    twin, inserted, deviations = built.twin, built.twin.inserted, built.twin.deviations
    return {
        "id": twin.planned.id,
        "deflection_mm": _round(inserted.deflection),
        "tip_y_mm": _round(inserted.shape.deflection),
        "tip_mm": _rounded(inserted.centerline[-1]),
        "out_of_plane_mm": _round(float(inserted.frame.to_local(inserted.centerline)[-1, 2])),
        "bevel_mm": _round(truth.true_bevel(twin.specimen, twin.planned)),
        "sequence": inserted.sequence,
        "boundaries_mm": _rounded(inserted.boundaries),
        "mu_pa": _rounded(inserted.tissue.mu * 1e6),
        "bevel_plane_deg": _round(np.degrees(deviations.roll)),
        "pose_shift_mm": _rounded(deviations.shift),
        "pose_angle_deg": _rounded(np.degrees(deviations.tilt)),
        "registration_error_mm": _round(float(registration_errors(built).mean())),
        "centerline_error_mm": _round(float(centerline_errors(built).mean())),
        "tip_error_mm": _round(tip_error(built)),
        **_scan(built.exposure.scene, built.exposure.scanner),
    }


def _scan(scene: Scene3D, scanner: Scanner) -> dict[str, Any]:
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


def _groups(built: Sequence[Built]) -> dict[str, float]:
    """Return the mean deflection (mm) of each medium and number of layers."""
    members: dict[str, list[float]] = {}
    for twin in (one.twin for one in built):
        key = f"{twin.planned.medium}_layers{twin.planned.layers}_mean_deflection_mm"
        members.setdefault(key, []).append(twin.inserted.deflection)
    return {key: _round(float(np.mean(values))) for key, values in members.items()}


def _round(value: float) -> float:
    """Return `value` to `DIGITS` significant digits; never -0."""
    return float(f"{float(value):.{DIGITS}g}") + 0.0


def _rounded(values: ArrayLike) -> list[float]:
    return [_round(value) for value in np.asarray(values, dtype=np.float64).tolist()]
