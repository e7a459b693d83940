"""The twin without its scans: what a scan would tell is read off the truth, with the errors that scans leave.

Rendering a volume and reconstructing the needle from it takes 4 s an insertion, and is what nearly all of a
twin's time goes into. Of the errors that come out of it, the registration's is by far the largest (0.18 mm),
and it comes from the stated places of the markers, not from voxels. Here the truth, the scanner's place and
these stated places are those of `build` for the same seed, registration, entry, layers and all that is stated
of errors are computed as from a scan, and only what the voxels add is drawn: to the needle's axis, its tip,
and the balls. What is left out is what a scan does beside that: streaks that pull an axis aside, balls and
tips that are lost.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from needlefit.geometry.curves import arc_length, at_arc
from needlefit.imaging.assemble import assemble
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.reconstruct import told
from needlefit.imaging.reconstruction import Markers, Profile, Reconstruction
from needlefit.imaging.registration.register import register
from needlefit.imaging.seen import Seen
from needlefit.project.records.reconstruction import ReconstructionRecord
from needlefit.project.streams import stream
from needlefit.synthetic.ct.insertion import Exposure, expose, whole_needle
from needlefit.synthetic.ct.setup import WHOLE
from needlefit.synthetic.design import Planned, insertions
from needlefit.synthetic.scans import as_given, recipe_of, write_layers
from needlefit.synthetic.statement import statement
from needlefit.synthetic.twin import Twin, synthesize

Floats = NDArray[np.float64]

AXIS_SD, TIP_SD, BALL_SD = 0.013, (0.04, 0.05), 0.007
"""Deviations, mm, in any one direction: of the axis across the needle; of the tip along and across it; of a
ball's centre. As scans of the twin leave them (docs/reconstruction.md, benchmarks/README.md)."""

TIP_REACH = 3.0
"""Length over which the tip's error across fades along the needle, mm."""

NOTE = (
    " This twin was not scanned: needle and balls were read off the truth with the errors that scans of it "
    "leave."
)


def unscanned(folder: Path, seed: int, plan: Sequence[Planned] = insertions()) -> Path:
    """Write the twin of `seed`, not scanned, into `folder`; return its `dataset.toml`."""
    recipe = recipe_of([WHOLE])
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), plan)
        ones = [_read_off(Path(scratch), planned, seed, recipe) for planned in plan]
        return assemble(folder, ones, recipe, statement(seed, NOTE))


def _read_off(folder: Path, planned: Planned, seed: int, recipe: ReconstructionRecord) -> Reconstruction:
    """Return what a scan of one insertion would tell."""
    twin = synthesize(planned, seed)
    exposure = expose(twin, WHOLE, seed)
    rng = stream(seed, "twin", "unscanned", planned.id)
    balls = exposure.scene.markers
    assert balls is not None
    centers = balls.centers + BALL_SD * rng.normal(size=balls.centers.shape)
    sd = np.full(len(centers), BALL_SD)
    registration = register(centers, exposure.stated, sd, WHOLE.known_sd)
    markers = Markers(centers, sd, "volume")
    nothing = Profile(np.empty(0), np.empty(0), np.empty(0))
    seen = Seen(_traced(twin, exposure, recipe, rng), markers, registration, nothing)
    nowhere = folder / f"{planned.id}.nrrd"
    scan = as_given(folder, planned, nowhere, nowhere)
    return told(seen, scan, recipe, exposure.scanner.grid)


def _traced(
    twin: Twin, exposure: Exposure, recipe: ReconstructionRecord, rng: np.random.Generator
) -> Centerline:
    """Return the needle's axis, as far as the field shows it, with the errors of its tracing."""
    whole = whole_needle(twin)
    length = float(arc_length(whole)[-1])
    end = length + TIP_SD[0] * rng.normal()
    begin = length - twin.inserted.shape.depth - WHOLE.outside
    s = np.linspace(begin, end, int(np.ceil((end - begin) / recipe.centerline.station_mm)) + 1)
    true = at_arc(whole, np.minimum(s, length)) + np.outer(np.maximum(s - length, 0), _ahead(whole))
    apart = np.abs(s[:, None] - s)
    hang_together = np.linalg.cholesky(np.exp(-apart / (recipe.centerline.knot_mm / 2)))
    sideways = AXIS_SD * hang_together @ rng.normal(size=(len(s), 2))
    sideways += np.outer(np.exp((s - end) / TIP_REACH), TIP_SD[1] * rng.normal(size=2))
    world = true + sideways @ twin.inserted.frame.rotation[:, 1:].T
    points = exposure.scene.box.to_world(world)
    return Centerline(
        points=points,
        sd=np.hypot(AXIS_SD, TIP_SD[1] * np.exp((s - end) / TIP_REACH)),
        tip=points[-1],
        tip_sd=np.array(TIP_SD),
        bevel=np.full(3, np.nan),
        sections_s=np.empty(0),
        residuals=np.empty((0, 3)),
    )


def _ahead(points: Floats) -> Floats:
    """Return the unit vector (3,) in which a needle (N, 3) ends."""
    last: Floats = points[-1] - points[-2]
    return last / np.linalg.norm(last)
