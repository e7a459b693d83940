"""Render the synthetic insertions as CT volumes, and build the shipped `data/twin` from such volumes.

    python benchmarks/scanner/twin.py scans phantom2-14 --out FOLDER [--seed 1] [--jobs 2] [--dicom]
    python benchmarks/scanner/twin.py dataset --out FOLDER [--seed 1] [--jobs 2]

`scans` writes volumes/ (20 MB each), markers/, layers/ and scans.csv, the input of `needlefit reconstruct`,
of some insertions, or `sample` alone, or of all 47. `dataset` simulates each of the 47, renders it and
reconstructs it, and writes the truth beside the dataset, in truth.toml. The same seed gives the same bytes.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

sys.path += [str(Path(__file__).resolve().parents[2] / folder) for folder in ("benchmarks", "studies")]

from synthetic import design
from synthetic.build import describe_dataset
from synthetic.design import BOX_MM, TRUE_MEDIA, InsertionDesign, TrueSpecimen, list_designs, select_designs
from synthetic.insertion import SUBLAYER_THICKNESS_MM, TRUTH_OPTIONS, SyntheticInsertion, simulate_insertion
from synthetic.scans import (
    RECIPE,
    WHOLE_BOX_SETUP,
    ScanSetup,
    make_stated_scan,
    place_insertion,
    sample_whole_needle,
    write_layers,
)

from needlefit.arrays import Floats
from needlefit.datasets.columns import BEVEL_COLUMNS, DIRECTION_COLUMNS, ENTRY_COLUMNS, InsertionRow
from needlefit.datasets.write import format_cells
from needlefit.geometry.frames import Frame
from needlefit.imaging.assembly import assemble_dataset
from needlefit.imaging.batch import ReconstructionFailure, reconstruct_needles
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import Scan
from needlefit.project.callbacks import Progress, no_progress
from needlefit.project.processes import one_thread
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, LocalPool, TaskPool
from needlefit.project.toml import dumps
from scanner.render import Needle3D, Scanner, ScannerTable, Scene3D, SceneMarkers, densify, render_scan
from scanner.write import write_volume

SAMPLE_INSERTION = InsertionDesign("sample", "phantom2", "sample", 2, 2, 25.0, 0.0, 2.5, -3.0, 1)
"""A short insertion for the sample volume; it is none of the 47."""
# Some gel around a short needle: a volume of a megabyte, its markers close by.
SAMPLE_SETUP = ScanSetup(
    markers=np.array(
        [[4.0, 11.5, -1.0], [9.0, -6.0, 8.0], [15.0, 3.0, -14.0], [22.0, -7.0, -7.0], [26.0, 12.0, 4.0]]
    ),
    known_sd=0.1,
    low=np.array([0.0, -10.0, -17.0]),
    high=np.array([30.0, 15.0, 11.0]),
    outside=12.0,
)


def _run_in_order(work, items, pool):
    """Return what `work` makes of each item, in their order."""
    return [result for _, result in sorted(pool.run(work, items), key=lambda one: one[0])]


def choose_setup(planned: InsertionDesign) -> ScanSetup:
    return SAMPLE_SETUP if planned.id == SAMPLE_INSERTION.id else WHOLE_BOX_SETUP


# Ranges of what is drawn for each scan, uniformly; see `Scanner`.
PSF_RANGE_MM = (0.3, 0.45)
BLOOM_RANGE = (0.05, 0.15)
STREAKS_RANGE = (0.4, 0.9)
NOISE_RANGE_HU = (25.0, 60.0)
CUPPING_RANGE_HU = (20.0, 80.0)
NEEDLE_RANGE_HU = (7000.0, 11000.0)
BEVEL_SD_DEG = 2.0  # deviation of the one needle's bevel from its nominal angle, degrees


@dataclass(frozen=True)
class Exposure:
    """One insertion in the scanner."""

    scene: Scene3D  # `scene.box` is the world in the patient
    scanner: Scanner
    stated: Floats  # (M, 3); stated places of the markers, world, mm


def expose(insertion: SyntheticInsertion, setup: ScanSetup, seed: int) -> Exposure:
    """Place an insertion in the scanner, and draw the scanner; from its own plan and the seed only."""
    placed = place_insertion(insertion, setup, seed)
    rng = random_stream(seed, "twin", "ct", insertion.planned.id)
    rng.uniform(size=7)  # what the placement drew; the order of draws is part of the dataset
    world = placed.world
    needle = Needle3D(
        points=world.to_world(sample_whole_needle(insertion)),
        bevel_deg=Needle3D.bevel_deg
        + BEVEL_SD_DEG * float(random_stream(seed, "twin", "ct", "bevel").normal()),
        bevel_toward=world.rotation @ insertion.true_insertion.frame.rotation[:, 1],
        hu=rng.uniform(*NEEDLE_RANGE_HU),
    )
    scene = Scene3D(
        needles=(needle,),
        phantom=insertion.specimen.phantom,
        layers_hu=TRUE_MEDIA[insertion.planned.medium].hu,
        box=world,
        markers=SceneMarkers(world.to_world(setup.markers)),
        table=ScannerTable(Frame(world.to_world([[0.0, 0.0, -BOX_MM / 2]])[0], world.rotation)),
    )
    scanner = Scanner(
        placed.grid,
        psf_mm=rng.uniform(*PSF_RANGE_MM),
        noise_hu=rng.uniform(*NOISE_RANGE_HU),
        bloom=rng.uniform(*BLOOM_RANGE),
        streaks=rng.uniform(*STREAKS_RANGE),
        cupping_hu=rng.uniform(*CUPPING_RANGE_HU),
    )
    return Exposure(scene, scanner, placed.stated)


# The columns of `scans.csv` that the twin fills.
STATED_COLUMNS = (
    *("id", "scan", "medium", "specimen", "markers", "surfaces", "surfaces_in"),
    *(*ENTRY_COLUMNS, *DIRECTION_COLUMNS, "pose_shift_sd_mm", "pose_angle_sd_deg", *BEVEL_COLUMNS),
    *("bevel_side", "layers", "layers_alternative", "origin"),
)


def _format_scan(scan: Scan, folder: Path) -> list[str]:
    """Return the cells of a scan under `STATED_COLUMNS`, formatted as in a table of insertions."""
    assert scan.stage is not None and scan.markers is not None and scan.layers is not None
    row = InsertionRow(
        *(scan.id, scan.medium, scan.layers, math.nan, scan.specimen, scan.layers_alternative, scan.side),
        *(scan.stage.entry, scan.stage.direction, scan.bevel),
        pose_shift_sd=scan.stage.shift_sd,
        pose_angle_sd=scan.stage.angle_sd,
    )
    scan_file, markers = (path.relative_to(folder).as_posix() for path in (scan.volume, scan.markers))
    surfaces = [f"{one.path.relative_to(folder).as_posix()}={one.kind}:{one.into}" for one in scan.surfaces]
    cells = format_cells(row) | {"scan": scan_file, "markers": markers, "surfaces": ";".join(surfaces)}
    cells |= {"surfaces_in": scan.surfaces_in if surfaces else "", "origin": scan.origin}
    return [cells[name] for name in STATED_COLUMNS]


@dataclass(frozen=True)
class RenderedInsertion:
    """One insertion, its exposure, and the scan as a user gets it."""

    insertion: SyntheticInsertion
    exposure: Exposure
    scan: Scan


@one_thread
def write_scans(
    folder: Path,
    plan: Sequence[InsertionDesign],
    seed: int,
    pool: TaskPool,
    progress: Progress,
    dicom: bool = False,
) -> Path:
    """Render `plan` into the empty `folder`; return its `scans.csv`. The same seed gives the same bytes.

    `pool`: where they are rendered: on this machine, whose folder they write.
    `progress`: called with what is being done, how many insertions are done, and of how many.
    """
    write_layers(folder, plan)
    scans = []
    progress("rendering", 0, len(plan))
    for done in _run_in_order(partial(_render_scan, folder, seed, dicom), plan, pool):
        scans.append(done)
        progress(f"rendered {done.id}", len(scans), len(plan))
    if any(choose_setup(planned) is WHOLE_BOX_SETUP for planned in plan):
        text = dumps(RECIPE.model_dump(mode="json", by_alias=True, exclude_unset=True))
        (folder / "recipe.toml").write_bytes(text.encode("utf-8"))
    table = folder / "scans.csv"
    rows = [STATED_COLUMNS, *(_format_scan(scan, folder) for scan in scans)]
    table.write_bytes("".join(",".join(row) + "\n" for row in rows).encode("utf-8"))
    return table


def _render_scan(folder: Path, seed: int, dicom: bool, planned: InsertionDesign) -> Scan:
    return render_insertion(folder, planned, seed, dicom).scan


def render_insertion(
    folder: Path, planned: InsertionDesign, seed: int, dicom: bool = False
) -> RenderedInsertion:
    """Simulate an insertion and write its volume and its markers into `folder`."""
    name, setup = planned.id, choose_setup(planned)
    insertion = simulate_insertion(planned, seed)
    exposure = expose(insertion, setup, seed)
    markers = folder / "markers" / f"{name}.csv"
    markers.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"ball{n},{x:.4f},{y:.4f},{z:.4f}" for n, (x, y, z) in enumerate(exposure.stated, start=1)]
    markers.write_bytes(("\n".join(["name,x_mm,y_mm,z_mm", *rows]) + "\n").encode("utf-8"))
    volume = folder / "volumes" / (name if dicom else f"{name}.nrrd")
    rng = random_stream(seed, "twin", "ct", name, "rays and noise")
    rendered = render_scan(exposure.scene, exposure.scanner, rng)
    write_volume(rendered, volume, f"Synthetic: {name}, seed {seed}")
    return RenderedInsertion(insertion, exposure, make_stated_scan(folder, planned, volume, markers))


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
        "layer_tops_mm": _round_all([float(surface.vertices[:, 0].min()) for surface in specimen.surfaces]),
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


SCANNED_NOTE = (
    "Every insertion was rendered as a cone-beam CT volume (voxels of 0.46 mm; partial volume, point "
    "spread, noise, bloom, streaks, beam hardening) and reconstructed from it as a measured scan would be: "
    "centreline and tip from the voxels, eight balls registered to their stated places, layers from their "
    "stated surfaces."
)


@one_thread
def build_scanned(
    folder: Path,
    seed: int,
    plan: Sequence[InsertionDesign] = list_designs(),
    pool: TaskPool = THIS_PROCESS,
    progress: Progress = no_progress,
) -> Path:
    """Write the twin of `seed` into `folder`; return its `dataset.toml`. The same seed gives the same bytes.

    `plan`: the insertions; each comes out the same whatever the others are.
    `pool`: where insertions are made; changes no byte.
    `progress`: called with what is being done, how many insertions are done, and of how many.
    """
    built = list[ReconstructedInsertion]()
    progress("reconstructing", 0, len(plan))
    for one in _run_in_order(partial(_build_insertion, seed), plan, pool):
        built.append(one)
        progress(f"reconstructed {one.insertion.planned.id}", len(built), len(plan))
    write_truth(folder / "truth.toml", seed, built)
    ones = [one.reconstruction for one in built]
    return assemble_dataset(folder, ones, RECIPE, describe_dataset(seed, SCANNED_NOTE))


def _build_insertion(seed: int, planned: InsertionDesign) -> ReconstructedInsertion:
    """Render an insertion, reconstruct it from what was written, and keep no volume."""
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), [planned])
        scanned = render_insertion(Path(scratch), planned, seed)
        (found,) = reconstruct_needles(scanned.scan, RECIPE)
    if isinstance(found, ReconstructionFailure):
        raise found.error
    return ReconstructedInsertion(scanned.insertion, scanned.exposure, found)


def main() -> None:
    """Write scans or the dataset."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("scans", "dataset"))
    parser.add_argument("ids", nargs="*", help="insertions (default: all 47)")
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--dicom", action="store_true", help="write series, not NRRD files")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True)
    pool = LocalPool(asked.jobs)
    if asked.what == "dataset":
        build_scanned(asked.out, asked.seed, pool=pool)
        return
    plan = [SAMPLE_INSERTION] if asked.ids == ["sample"] else select_designs(asked.ids)
    write_scans(asked.out, plan, asked.seed, pool, no_progress, asked.dicom)


if __name__ == "__main__":
    main()
