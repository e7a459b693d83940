"""Build the synthetic dataset, with the truth behind it in truth.toml: the same seed gives the same bytes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.assembly import DatasetDescription, assemble_dataset
from needlefit.imaging.batch import ReconstructionFailure, reconstruct_needles
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.reconstruct import Examination, derive_reconstruction
from needlefit.imaging.reconstruction import IntensityProfile, MarkerResult, Reconstruction
from needlefit.imaging.registration.register import register
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress, no_progress
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, TaskPool, run_in_order
from needlefit.project.toml import dumps
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.synthetic import design
from needlefit.synthetic.design import InsertionDesign, TrueSpecimen, TrueSpread, list_designs
from needlefit.synthetic.insertion import (
    SUBLAYER_THICKNESS_MM,
    TRUTH_OPTIONS,
    TWIN_SEED,
    SyntheticInsertion,
    simulate_insertion,
)
from needlefit.synthetic.render import densify
from needlefit.synthetic.scans import (
    WHOLE_BOX_SETUP,
    Exposure,
    expose,
    make_recipe,
    make_stated_scan,
    render_insertion,
    sample_whole_needle,
    write_layers,
)


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
    return np.linalg.norm(moved - true, axis=1)


def centerline_errors(built: ReconstructedInsertion) -> Floats:
    """Return the distance of each reconstructed point (N,) from the true needle, in the world, mm."""
    scene = built.exposure.scene
    true = scene.box.to_local(densify(scene.needles[0].points))
    return np.asarray(cKDTree(true).query(built.reconstruction.points)[0], dtype=np.float64)


SIGNIFICANT_DIGITS = 6  # significant digits of every number
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
    needle = design.draw_needle(seed)
    specimens = {one.insertion.specimen.name: one.insertion.specimen for one in built}
    media = {name: design.draw_medium(seed, name) for name in design.TRUE_MEDIA}
    tables = {
        "schema": 1,
        "origin": "synthetic",
        "seed": seed,
        "note": TRUTH_NOTE,
        "specimens": [_describe_specimen(one) for one in specimens.values()],
        "insertions": [_describe_insertion(one) for one in built],
        "needle": {
            "length_mm": needle.length,
            "flexural_rigidity_nmm2": _round(needle.flexural_rigidity),
            "nominal_flexural_rigidity_nmm2": _round(design.NOMINAL_NEEDLE.flexural_rigidity),
        },
        "model": {
            "constraint_spacing_mm": TRUTH_OPTIONS.spacing,
            "element_mm": TRUTH_OPTIONS.element,
            "slice_mm": SUBLAYER_THICKNESS_MM,
        },
        "media": {
            name: {
                "mu_pa": _round_all(medium.mu_pa),
                "alpha": medium.alpha,
                "bevel_mm": _round(medium.bevel),
                "friction": _round(medium.friction),
                "hu": medium.hu,
                "specimen_sd_of_ln_mu": medium.layer_sd,
            }
            for name, medium in media.items()
        },
        "deviations": {
            "rigidity_relative_range": design.RIGIDITY_DEVIATION,
            "chicken_field_sd_of_ln_mu": design.FIELD_LOG_MU_SD,
            "chicken_field_length_mm": design.FIELD_LENGTH_MM,
            "layer_place_sd_mm": design.LAYER_SD_MM,
            "bevel_plane_sd_deg": design.ROLL_SD_DEG,
            "pose_shift_sd_mm": design.POSE_SHIFT_SD_MM,
            "pose_angle_sd_deg": design.POSE_ANGLE_SD_DEG,
        },
        "markers": {"places_mm": WHOLE_BOX_SETUP.markers.tolist(), "stated_sd_mm": WHOLE_BOX_SETUP.known_sd},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(dumps(tables).encode("utf-8"))


def _describe_specimen(specimen: TrueSpecimen) -> dict[str, Any]:
    return {
        "name": specimen.name,
        "medium": specimen.medium,
        "mu_pa": _round_all(specimen.mu * 1e6),
        "alpha": specimen.alpha.tolist(),
        "layer_tops_mm": _round_all([float(surface.mesh.bounds[0, 0]) for surface in specimen.surfaces]),
    }


def _describe_insertion(built: ReconstructedInsertion) -> dict[str, Any]:
    insertion, exposure, found = built.insertion, built.exposure, built.reconstruction
    true, deviations, needle = insertion.true_insertion, insertion.deviations, exposure.scene.needles[0]
    centerline = true.centerline
    return {
        "id": insertion.planned.id,
        "deflection_mm": _round(true.deflection),
        "axis_deflection_mm": _round(true.shape.tip_lateral),
        "tip_mm": _round_all(centerline[-1]),
        "out_of_plane_mm": _round(float(true.frame.to_local(centerline)[-1, 2])),
        "bevel_mm": _round(design.bevel_offset(insertion.specimen, insertion.planned, deviations)),
        "sequence": true.sequence,
        "boundaries_mm": _round_all(true.boundaries),
        "mu_pa": _round_all(true.tissue.mu * 1e6),
        "bevel_plane_deg": _round(np.degrees(deviations.roll)),
        "pose_shift_mm": _round_all(deviations.shift),
        "pose_angle_deg": _round_all(np.degrees(deviations.tilt)),
        "registration_error_mm": _round(float(registration_errors(built).mean())),
        "centerline_error_mm": _round(float(centerline_errors(built).mean())),
        "tip_error_mm": _round(float(np.linalg.norm(found.points[-1] - centerline[-1]))),
        "bevel_deg": _round(needle.bevel_deg),
        "needle_hu": _round(needle.hu),
        **{
            name: _round(getattr(exposure.scanner, name))
            for name in ("psf_mm", "noise_hu", "bloom", "streaks", "cupping_hu")
        },
    }


def _round(value: float) -> float:
    """Return `value` to `SIGNIFICANT_DIGITS` significant digits; never -0."""
    return float(f"{float(value):.{SIGNIFICANT_DIGITS}g}") + 0.0


def _round_all(values: ArrayLike) -> list[float]:
    return [_round(value) for value in np.asarray(values, dtype=np.float64).tolist()]


DATASET_NOTES = (
    "Synthetic: no needle was ever inserted. Counts of insertions, layers traversed and ends of the depth "
    "ranges are the paper's; the layers' places, entry positions, tilts, bevel sides and the depths in "
    "between are invented. The world's x axis points into the 80 mm box, whose entry face is x = 0, "
    "-40 <= y, z <= 40. Entry poses are those of the stage; bevel_x, bevel_y, bevel_z is the direction in "
    "which +y of the constraint frame points, bevel_side the side to which the bevel faces. Every insertion "
    "was rendered as a cone-beam CT volume (voxels of 0.46 mm; partial volume, point spread, noise, bloom, "
    "streaks, beam hardening) and reconstructed from it as a measured scan would be: centreline and tip from "
    "the voxels, eight balls registered to their stated places, layers from their stated surfaces. "
    "`needlefit twin ct` writes the volumes. The insertion with layers_alternative = 3 beside layers = 4 "
    "ends at the top of the cylinder. What generated the data is not the model that is fitted to it."
)

_LAYER_NOTES = {
    "phantom1": "Four planar layers, of which the insertions reach three.",
    "phantom2": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "phantom3": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "chicken": "One layer, three pieces; the third was turned after three insertions.",
}


def describe_dataset(seed: int, more: str = "", population: TrueSpread | None = None) -> DatasetDescription:
    """Return the description of the twin built with `seed`; `more` is added to its notes."""
    return DatasetDescription(
        name="twin",
        title="Synthetic twin of the paper's 47 insertions",
        license="CC0-1.0",
        source=f"needlefit twin build --seed {seed}",
        # of a population the truth does not follow from the seed alone
        truth_seed=None if population else seed,
        notes=DATASET_NOTES + more,
        media=_LAYER_NOTES,
    )


@one_thread
def build_dataset(
    folder: Path,
    seed: int = TWIN_SEED,
    plan: Sequence[InsertionDesign] = list_designs(),
    pool: TaskPool = THIS_PROCESS,
    progress: Progress = no_progress,
) -> Path:
    """Write the twin of `seed` into `folder`; return its `dataset.toml`. The same seed gives the same bytes.

    `plan`: the insertions; each comes out the same whatever the others are.
    `pool`: where insertions are made; changes no byte.
    `progress`: called with what is being done, how many insertions are done, and of how many.
    """
    recipe, built = make_recipe([WHOLE_BOX_SETUP]), list[ReconstructedInsertion]()
    progress("reconstructing", 0, len(plan))
    for one in run_in_order(partial(_build_insertion, seed, recipe), plan, pool):
        built.append(one)
        progress(f"reconstructed {one.insertion.planned.id}", len(built), len(plan))
    write_truth(folder / "truth.toml", seed, built)
    ones = [one.reconstruction for one in built]
    return assemble_dataset(folder, ones, recipe, describe_dataset(seed))


def _build_insertion(
    seed: int, recipe: ReconstructionRecord, planned: InsertionDesign
) -> ReconstructedInsertion:
    """Render an insertion, reconstruct it from what was written, and keep no volume."""
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), [planned])
        scanned = render_insertion(Path(scratch), planned, seed)
        (found,) = reconstruct_needles(scanned.scan, recipe)
    if isinstance(found, ReconstructionFailure):
        raise found.error
    return ReconstructedInsertion(scanned.insertion, scanned.exposure, found)


# Deviations, mm, in any one direction, as scans of the twin leave them.
AXIS_SD_MM = 0.013  # of the axis across the needle
TIP_SD_MM = (0.04, 0.05)  # of the tip along and across it
BALL_SD_MM = 0.007  # of a ball's centre
TIP_REACH_MM = 3.0  # length over which the tip's error across fades along the needle, mm
UNSCANNED_NOTE = (
    " This twin was not scanned: needle and balls were read off the truth with the errors that scans of it "
    "leave."
)


def build_unscanned(
    folder: Path,
    seed: int,
    plan: Sequence[InsertionDesign] = list_designs(),
    *,
    population: TrueSpread | None = None,
) -> Path:
    """Write the twin of `seed`, not scanned, into `folder`; return its `dataset.toml`."""
    recipe = make_recipe([WHOLE_BOX_SETUP])
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), plan)
        ones = [_simulate_reconstruction(Path(scratch), one, seed, recipe, population) for one in plan]
        return assemble_dataset(folder, ones, recipe, describe_dataset(seed, UNSCANNED_NOTE, population))


def _simulate_reconstruction(
    folder: Path,
    planned: InsertionDesign,
    seed: int,
    recipe: ReconstructionRecord,
    population: TrueSpread | None,
) -> Reconstruction:
    """Return what a scan of one insertion would tell."""
    insertion = simulate_insertion(planned, seed, population)
    exposure = expose(insertion, WHOLE_BOX_SETUP, seed)
    rng = random_stream(seed, "twin", "unscanned", planned.id)
    balls = exposure.scene.markers
    assert balls is not None
    centers = balls.centers + BALL_SD_MM * rng.normal(size=balls.centers.shape)
    sd = np.full(len(centers), BALL_SD_MM)
    registration = register(centers, exposure.stated, sd, WHOLE_BOX_SETUP.known_sd)
    markers = MarkerResult(centers, sd, "volume")
    # no voxels, so no brightness along the needle
    nothing = IntensityProfile(np.empty(0), np.empty(0), np.empty(0), np.empty((0, 0)))
    axis = _simulate_axis(insertion, exposure, recipe, rng)
    nowhere = folder / f"{planned.id}.nrrd"
    scan = make_stated_scan(folder, planned, nowhere, nowhere)
    found = Examination(scan, None, axis, markers, registration, nothing)
    return derive_reconstruction(found, recipe, exposure.scanner.grid)


def _simulate_axis(
    insertion: SyntheticInsertion, exposure: Exposure, recipe: ReconstructionRecord, rng: np.random.Generator
) -> Centerline:
    """Return the needle's axis, as far as the field shows it, with the errors of its tracing."""
    whole = sample_whole_needle(insertion)
    length = float(arc_length(whole)[-1])
    end = length + TIP_SD_MM[0] * rng.normal()
    begin = length - insertion.true_insertion.shape.depth - WHOLE_BOX_SETUP.outside
    s = np.linspace(begin, end, int(np.ceil((end - begin) / recipe.centerline.station_spacing_mm)) + 1)
    last = whole[-1] - whole[-2]
    beyond = np.outer(np.maximum(s - length, 0), last / np.linalg.norm(last))
    true = interpolate_at_arc(whole, np.minimum(s, length)) + beyond
    apart = np.abs(s[:, None] - s)
    # tracing errors are correlated over about half a knot spacing, since the spline smooths over it
    hang_together = np.linalg.cholesky(np.exp(-apart / (recipe.centerline.knot_spacing_mm / 2)))
    sideways = AXIS_SD_MM * hang_together @ rng.normal(size=(len(s), 2))
    sideways += np.outer(np.exp((s - end) / TIP_REACH_MM), TIP_SD_MM[1] * rng.normal(size=2))
    world = true + sideways @ insertion.true_insertion.frame.rotation[:, 1:].T
    points = exposure.scene.box.to_world(world)
    return Centerline(
        points=points,
        sd=np.hypot(AXIS_SD_MM, TIP_SD_MM[1] * np.exp((s - end) / TIP_REACH_MM)),
        tip=points[-1],
        tip_sd=np.array(TIP_SD_MM),
        bevel=np.full(3, np.nan),
    )
