"""One insertion of the twin in the scanner: where it lies, what is around it, how it is scanned.

In the patient's axes (LPS) the scanner's long axis is S. The box stands on the table, its entry face toward
the feet. The voxels are turned about the long axis by any angle, and the box is tilted against them by a few
degrees.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from needlefit.geometry.frames import Frame
from needlefit.imaging.grid import Grid
from needlefit.imaging.volume import Volume
from needlefit.project.streams import stream
from needlefit.synthetic.ct.render import render
from needlefit.synthetic.ct.scene import Markers, Needle3D, Scanner, Scene3D, Table
from needlefit.synthetic.ct.setup import Setup, stated_markers
from needlefit.synthetic.insert import axis
from needlefit.synthetic.phantoms import BOX
from needlefit.synthetic.truth import MEDIA, NOMINAL
from needlefit.synthetic.twin import Twin

Floats = NDArray[np.float64]

VOXEL = 0.46
"""Edge of a voxel, mm: the paper's."""

MARGIN = 2.0
"""What the field shows beyond what it must, mm."""

UPRIGHT = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Columns: the world's x (into the box) to the head, y to the right, z (up) to the front of the patient."""

TILT, OFFSET = 6.0, 150.0
"""Greatest tilt of the box about each axis, degrees, and distance along it from the patient's origin, mm."""

PSF_MM, BLOOM, STREAKS = (0.3, 0.45), (0.05, 0.15), (0.4, 0.9)
NOISE_HU, CUPPING_HU, NEEDLE_HU = (25.0, 60.0), (20.0, 80.0), (7000.0, 11000.0)
"""Ranges of what is drawn for each scan, uniformly; what it is says `Scanner`."""

BEVEL_SD = 2.0
"""Deviation of the one needle's bevel from its nominal angle, degrees."""


@dataclass(frozen=True)
class Exposure:
    """An insertion in the scanner.

    Attributes
    ----------
    scene : Scene3D
        `scene.box` is the world in the patient.
    scanner : Scanner
    stated : (M, 3) array
        Where the markers are said to be, world, mm.
    """

    scene: Scene3D
    scanner: Scanner
    stated: Floats


def expose(twin: Twin, setup: Setup, seed: int) -> Exposure:
    """Put an insertion into the scanner; it depends on its own plan and the seed, not on the others."""
    rng = stream(seed, "twin", "ct", twin.planned.id)
    turned = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).as_matrix()
    tilted = Rotation.from_rotvec(rng.uniform(-TILT, TILT, 3), degrees=True).as_matrix()
    world = Frame(rng.uniform(-OFFSET, OFFSET, 3), turned @ tilted @ UPRIGHT)
    shaft = whole_needle(twin)
    needle = Needle3D(
        points=world.to_world(shaft),
        bevel_deg=_bevel_deg(seed),
        bevel_toward=world.rotation @ twin.inserted.frame.rotation[:, 1],
        hu=rng.uniform(*NEEDLE_HU),
    )
    scene = Scene3D(
        needles=(needle,),
        phantom=twin.specimen.phantom,
        layers_hu=MEDIA[twin.planned.medium].hu,
        box=world,
        markers=Markers(world.to_world(setup.markers)),
        table=Table(Frame(world.to_world([[0.0, 0.0, -BOX / 2]])[0], world.rotation)),
    )
    grid = _field(world.to_world(_must_show(setup, twin)), turned)
    return Exposure(scene, _scanner(grid, rng), stated_markers(setup, seed, twin.planned.id))


def acquire(exposure: Exposure, seed: int, name: str) -> Volume:
    """Return the volume of an exposure; the same seed and name give the same bytes."""
    return render(exposure.scene, exposure.scanner, stream(seed, "twin", "ct", name, "rays and noise"))


def whole_needle(twin: Twin) -> Floats:
    """Return the whole needle's axis (N, 3) from base to tip, world, mm."""
    depth = twin.inserted.shape.depth
    s = np.linspace(depth - NOMINAL.length, depth, 4 * round(NOMINAL.length) + 1)
    return axis(twin.inserted.shape, twin.inserted.frame, twin.deviations, s)


def _must_show(setup: Setup, twin: Twin) -> Floats:
    """Return the world points (N, 3) that the field must hold: corners of the setup, and shaft."""
    corners = np.array(list(product(*zip(setup.low, setup.high, strict=True))))
    frame = twin.inserted.frame
    return np.vstack([corners, frame.to_world([[-setup.outside, 0.0, 0.0]])])


def _field(points: Floats, direction: Floats) -> Grid:
    """Return the least grid along `direction` (3, 3) with `points` (N, 3) in it, patient."""
    local = points @ direction
    low, high = local.min(axis=0) - MARGIN, local.max(axis=0) + MARGIN
    columns, rows, slices = (int(n) for n in np.ceil((high - low) / VOXEL))
    return Grid((columns, rows, slices), direction @ low, np.full(3, VOXEL), direction)


def _scanner(grid: Grid, rng: np.random.Generator) -> Scanner:
    return Scanner(
        grid,
        psf_mm=rng.uniform(*PSF_MM),
        noise_hu=rng.uniform(*NOISE_HU),
        bloom=rng.uniform(*BLOOM),
        streaks=rng.uniform(*STREAKS),
        cupping_hu=rng.uniform(*CUPPING_HU),
    )


def _bevel_deg(seed: int) -> float:
    """Return the angle of the one needle's bevel, degrees."""
    return Needle3D.bevel_deg + BEVEL_SD * float(stream(seed, "twin", "ct", "bevel").normal())
