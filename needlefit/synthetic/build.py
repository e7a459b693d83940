"""Build the synthetic dataset: simulate, scan and reconstruct every planned insertion; write the truth apart.

`build_unscanned` makes the twin without scans: measurements are the truth plus the errors that scans leave.

Rendering a volume and reconstructing the needle from it takes 4 s an insertion, and is what nearly all of a
twin's time goes into. Of the errors that come out of it, the registration's is by far the largest (0.18 mm),
and it comes from the stated places of the markers, not from voxels. Here the truth, the scanner's place and
these stated places are those of `build` for the same seed, registration, entry, layers and all that is stated
of errors are computed as from a scan, and only what the voxels add is drawn: to the needle's axis, its tip,
and the balls. What is left out is what a scan does beside that: streaks that pull an axis aside, balls and
tips that are lost.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.assembly import DatasetDescription, assemble_dataset
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.reconstruct import Detections, derive_reconstruction, reconstruct
from needlefit.imaging.reconstruction import IntensityProfile, MarkerResult, Reconstruction
from needlefit.imaging.registration.register import register
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress, no_progress
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import THIS_PROCESS, TaskPool, run_in_order
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.synthetic.design import PlannedInsertion, list_planned_insertions
from needlefit.synthetic.exposure import WHOLE_BOX_SETUP, Exposure, expose, sample_whole_needle
from needlefit.synthetic.insertion import TWIN_SEED, SyntheticInsertion, simulate_insertion
from needlefit.synthetic.scans import make_recipe, make_stated_scan, render_insertion, write_layers
from needlefit.synthetic.truth_file import ReconstructedInsertion, write_truth

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


def describe_dataset(seed: int, more: str = "") -> DatasetDescription:
    """Return the description of the twin built with `seed`; `more` is added to its notes."""
    return DatasetDescription(
        name="twin",
        title="Synthetic twin of the paper's 47 insertions",
        license="CC0-1.0",
        source=f"needlefit twin build --seed {seed}",
        notes=DATASET_NOTES + more,
        media=_LAYER_NOTES,
    )


@one_thread
def build_dataset(
    folder: Path,
    seed: int = TWIN_SEED,
    plan: Sequence[PlannedInsertion] = list_planned_insertions(),
    pool: TaskPool = THIS_PROCESS,
    progress: Progress = no_progress,
) -> Path:
    """Write the twin of `seed` into `folder`; return its `dataset.toml`. The same seed gives the same bytes.

    Parameters
    ----------
    plan : sequence of PlannedInsertion
        The insertions; each comes out the same whatever the others are.
    pool : TaskPool
        Where insertions are made; changes no byte.
    progress : callable
        Told what is being done, how many insertions are done, and of how many.
    """
    recipe, built = make_recipe([WHOLE_BOX_SETUP]), list[ReconstructedInsertion]()
    progress("reconstructing", 0, len(plan))
    for one in run_in_order(partial(_build_insertion, seed, recipe), plan, pool):
        built.append(one)
        progress(f"reconstructed {one.insertion.planned.id}", len(built), len(plan))
    write_truth(folder / "truth.toml", seed, built)
    return assemble_dataset(folder, [one.reconstruction for one in built], recipe, describe_dataset(seed))


def _build_insertion(
    seed: int, recipe: ReconstructionRecord, planned: PlannedInsertion
) -> ReconstructedInsertion:
    """Render an insertion, reconstruct it from what was written, and keep no volume."""
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), [planned])
        scanned = render_insertion(Path(scratch), planned, seed)
        reconstruction = reconstruct(scanned.scan, recipe)
    return ReconstructedInsertion(scanned.insertion, scanned.exposure, reconstruction)


AXIS_SD_MM, TIP_SD_MM, BALL_SD_MM = 0.013, (0.04, 0.05), 0.007
"""Deviations, mm, in any one direction: of the axis across the needle; of the tip along and across it; of a
ball's centre. As scans of the twin leave them (docs/reconstruction.md, benchmarks/README.md)."""

TIP_REACH_MM = 3.0
"""Length over which the tip's error across fades along the needle, mm."""

UNSCANNED_NOTE = (
    " This twin was not scanned: needle and balls were read off the truth with the errors that scans of it "
    "leave."
)


def build_unscanned(
    folder: Path, seed: int, plan: Sequence[PlannedInsertion] = list_planned_insertions()
) -> Path:
    """Write the twin of `seed`, not scanned, into `folder`; return its `dataset.toml`."""
    recipe = make_recipe([WHOLE_BOX_SETUP])
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), plan)
        ones = [_simulate_reconstruction(Path(scratch), planned, seed, recipe) for planned in plan]
        return assemble_dataset(folder, ones, recipe, describe_dataset(seed, UNSCANNED_NOTE))


def _simulate_reconstruction(
    folder: Path, planned: PlannedInsertion, seed: int, recipe: ReconstructionRecord
) -> Reconstruction:
    """Return what a scan of one insertion would tell."""
    insertion = simulate_insertion(planned, seed)
    exposure = expose(insertion, WHOLE_BOX_SETUP, seed)
    rng = random_stream(seed, "twin", "unscanned", planned.id)
    balls = exposure.scene.markers
    assert balls is not None
    centers = balls.centers + BALL_SD_MM * rng.normal(size=balls.centers.shape)
    sd = np.full(len(centers), BALL_SD_MM)
    registration = register(centers, exposure.stated, sd, WHOLE_BOX_SETUP.known_sd)
    markers = MarkerResult(centers, sd, "volume")
    # no voxels, so no brightness along the needle
    nothing = IntensityProfile(np.empty(0), np.empty(0), np.empty(0))
    detections = Detections(_simulate_axis(insertion, exposure, recipe, rng), markers, registration, nothing)
    nowhere = folder / f"{planned.id}.nrrd"
    scan = make_stated_scan(folder, planned, nowhere, nowhere)
    return derive_reconstruction(detections, scan, recipe, exposure.scanner.grid)


def _simulate_axis(
    insertion: SyntheticInsertion, exposure: Exposure, recipe: ReconstructionRecord, rng: np.random.Generator
) -> Centerline:
    """Return the needle's axis, as far as the field shows it, with the errors of its tracing."""
    whole = sample_whole_needle(insertion)
    length = float(arc_length(whole)[-1])
    end = length + TIP_SD_MM[0] * rng.normal()
    begin = length - insertion.true_insertion.shape.depth - WHOLE_BOX_SETUP.outside
    s = np.linspace(begin, end, int(np.ceil((end - begin) / recipe.centerline.station_spacing_mm)) + 1)
    true = interpolate_at_arc(whole, np.minimum(s, length)) + np.outer(
        np.maximum(s - length, 0), _end_direction(whole)
    )
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
        sections_s=np.empty(0),
        residuals=np.empty((0, 3)),
    )


def _end_direction(points: Floats) -> Floats:
    """Return the unit vector (3,) in which a needle (N, 3) ends."""
    last: Floats = points[-1] - points[-2]
    return last / np.linalg.norm(last)
