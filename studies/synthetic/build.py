"""Build synthetic datasets: the same seed gives the same bytes."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import Frame
from needlefit.imaging.assembly import DatasetDescription, assemble_dataset
from needlefit.imaging.constants import MM
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.needle.tip import TipFit
from needlefit.imaging.reconstruct import derive_reconstruction
from needlefit.imaging.reconstruction import (
    EntryChoice,
    IntensityProfile,
    MarkerResult,
    NeedleImage,
    Reconstruction,
)
from needlefit.imaging.registration import register
from needlefit.project.random_streams import random_stream
from synthetic.design import InsertionDesign, TrueSpread, list_designs
from synthetic.insertion import SyntheticInsertion, simulate_insertion
from synthetic.scans import (
    RECIPE,
    WHOLE_BOX_SETUP,
    make_stated_scan,
    place_insertion,
    sample_whole_needle,
    write_layers,
)

DATASET_NOTES = (
    "Synthetic: no needle was ever inserted. Counts of insertions, layers traversed and ends of the depth "
    "ranges are the paper's; the layers' places, entry positions, tilts, bevel sides and the depths in "
    "between are invented. The world's x axis points into the 80 mm box, whose entry face is x = 0, "
    "-40 <= y, z <= 40. Entry poses are those of the stage; bevel_x, bevel_y, bevel_z is the direction in "
    "which +y of the constraint frame points, bevel_side the side to which the bevel faces. {} The insertion "
    "with layers_alternative = 3 beside layers = 4 ends at the top of the cylinder. What generated the data "
    "is not the model that is fitted to it."
)
UNSCANNED_NOTE = (
    "Nothing was scanned: needle and balls were read off the truth with the errors that scans of it leave."
)

_LAYER_NOTES = {
    "phantom1": "Four planar layers, of which the insertions reach three.",
    "phantom2": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "phantom3": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "chicken": "One layer, three pieces; the third was turned after three insertions.",
}


def describe_dataset(seed: int, scanned: str, population: TrueSpread | None = None) -> DatasetDescription:
    """Return the description of the twin built with `seed`; `scanned` states where its needles come from."""
    return DatasetDescription(
        name="twin",
        title="Synthetic twin of the paper's 47 insertions",
        license="CC0-1.0",
        source=f"studies/synthetic, make_twin, seed {seed}",
        truth_seed=seed,
        truth_population=population is not None,
        notes=DATASET_NOTES.format(scanned),
        media=_LAYER_NOTES,
    )


# Deviations, mm, in any one direction, as scans of the twin leave them.
AXIS_SD_MM = 0.013  # of the axis across the needle
TIP_SD_MM = (0.04, 0.05)  # of the tip along and across it
BALL_SD_MM = 0.007  # of a ball's centre
TIP_REACH_MM = 3.0  # length over which the tip's error across fades along the needle, mm


def build_dataset(
    folder: Path,
    seed: int,
    plan: Sequence[InsertionDesign] = list_designs(),
    population: TrueSpread | None = None,
) -> Path:
    """Write the twin of `seed` into `folder`; return its `dataset.toml`.

    `plan`: the insertions; each comes out the same whatever the others are.
    """
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), plan)
        ones = [_simulate_reconstruction(Path(scratch), design, seed, population) for design in plan]
        return assemble_dataset(folder, ones, RECIPE, describe_dataset(seed, UNSCANNED_NOTE, population))


def _simulate_reconstruction(
    folder: Path, planned: InsertionDesign, seed: int, population: TrueSpread | None
) -> Reconstruction:
    """Return what a scan of one insertion would tell."""
    insertion = simulate_insertion(planned, seed, population)
    placed = place_insertion(insertion, WHOLE_BOX_SETUP, seed)
    rng = random_stream(seed, "twin", "unscanned", planned.id)
    balls = placed.world.to_world(WHOLE_BOX_SETUP.markers)
    centers = balls + BALL_SD_MM * rng.normal(size=balls.shape)
    sd = np.full(len(centers), BALL_SD_MM)
    registration = register(centers, placed.stated, sd, WHOLE_BOX_SETUP.known_sd)
    markers = MarkerResult(centers, sd, "volume")
    # no voxels, so no brightness along the needle
    nothing = IntensityProfile(np.empty(0), np.empty(0))
    axis = _simulate_axis(insertion, placed.world, rng)
    nowhere = folder / f"{planned.id}.nrrd"
    scan = make_stated_scan(folder, planned, nowhere, nowhere)
    image = NeedleImage(
        scan=scan,
        grid=placed.grid,
        needle_axis=axis,
        profile=nothing,
        passed=(),
        choice=EntryChoice(),
        markers=markers,
        registration=registration,
    )
    return derive_reconstruction(image, RECIPE)


def _simulate_axis(insertion: SyntheticInsertion, box: Frame, rng: np.random.Generator) -> Centerline:
    """Return the needle's axis, as far as the field shows it, with the errors of its tracing."""
    whole = sample_whole_needle(insertion)
    length = float(arc_length(whole)[-1])
    end = length + TIP_SD_MM[0] * rng.normal()
    begin = length - insertion.true_insertion.shape.depth - WHOLE_BOX_SETUP.outside
    s = np.linspace(begin, end, int(np.ceil((end - begin) / MM.STATION)) + 1)
    last = whole[-1] - whole[-2]
    beyond = np.outer(np.maximum(s - length, 0), last / np.linalg.norm(last))
    true = interpolate_at_arc(whole, np.minimum(s, length)) + beyond
    apart = np.abs(s[:, None] - s)
    # tracing errors are correlated over about half a knot spacing, since the spline smooths over it
    hang_together = np.linalg.cholesky(np.exp(-apart / (MM.KNOT / 2)))
    sideways = AXIS_SD_MM * hang_together @ rng.normal(size=(len(s), 2))
    sideways += np.outer(np.exp((s - end) / TIP_REACH_MM), TIP_SD_MM[1] * rng.normal(size=2))
    world = true + sideways @ insertion.true_insertion.frame.rotation[:, 1:].T
    points = box.to_world(world)
    return Centerline(
        points=points,
        sd=np.hypot(AXIS_SD_MM, TIP_SD_MM[1] * np.exp((s - end) / TIP_REACH_MM)),
        end=TipFit(end - begin, points[-1], np.array(TIP_SD_MM), bevel=np.full(3, np.nan), roll_sd=np.nan),
    )
