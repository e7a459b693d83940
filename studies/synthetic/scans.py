"""Place synthetic insertions in a scanner, and state of them what a user states of a scan."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import write_surface
from needlefit.imaging.scans import LayerSource, Scan, StagePose
from needlefit.imaging.volume import VoxelGrid
from needlefit.project.random_streams import random_stream
from needlefit.schemas.reconstruction import MarkersRecord, ReconstructionRecord, ScannedNeedleRecord
from synthetic.design import (
    BOX_MM,
    NOMINAL_NEEDLE,
    PHANTOMS,
    POSE_ANGLE_SD_DEG,
    POSE_SHIFT_SD_MM,
    InsertionDesign,
    make_surfaces,
    surface_file_name,
)
from synthetic.insertion import SyntheticInsertion, needle_points


@dataclass(frozen=True)
class ScanSetup:
    """The scanned region and the markers in it."""

    markers: Floats  # (M, 3); centres of the balls, world, mm
    known_sd: float  # deviation of their stated places in any one direction, mm
    # `low`, `high`: (3,); opposite corners of the part of the world that is scanned, mm
    low: Floats
    high: Floats
    outside: float  # length of shaft before the tissue that is scanned, mm


# The box, some of its table, and the shaft before it.
WHOLE_BOX_SETUP = ScanSetup(
    markers=np.array(
        [
            [4.0, 36.0, 35.0],
            [7.0, -36.0, 30.0],
            [12.0, -35.0, -36.0],
            [24.0, 37.0, -34.0],
            [43.0, 34.0, 36.0],
            [58.0, -37.0, 12.0],
            [74.0, -12.0, -36.0],
            [76.0, 29.0, 21.0],
        ]
    ),
    known_sd=0.27,
    low=np.array([0.0, -BOX_MM / 2, -BOX_MM / 2 - 5.0]),  # and some of the table
    high=np.array([BOX_MM, BOX_MM / 2, BOX_MM / 2]),
    outside=35.0,
)
# Of a scan of `WHOLE_BOX_SETUP`: how well the markers' places are known.
RECIPE = ReconstructionRecord(
    schema_=ReconstructionRecord.SCHEMA,
    title="Twin",
    needle=ScannedNeedleRecord(name="18 gauge, 150 mm", note="Nominal; solid, its stylet in place."),
    markers=MarkersRecord(reference_sd_mm=WHOLE_BOX_SETUP.known_sd),
)

VOXEL_MM = 0.46  # edge of a voxel, mm: the paper's
FIELD_MARGIN_MM = 2.0  # margin of the scanned field around what it must contain, mm
# Columns: the world's x (into the box) to the head, y to the right, z (up) to the front of the patient.
UPRIGHT_ROTATION = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
MAX_TILT_DEG = 6.0  # degrees, of the box about each axis
MAX_OFFSET_MM = 150.0  # mm along it from the patient's origin


@dataclass(frozen=True)
class PlacedInsertion:
    """The world of an insertion in the scanner."""

    world: Frame  # in the patient
    grid: VoxelGrid
    stated: Floats  # (M, 3); stated places of the markers, world, mm


def place_insertion(insertion: SyntheticInsertion, setup: ScanSetup, seed: int) -> PlacedInsertion:
    """Place an insertion in the scanner; the result depends on its own plan and the seed only."""
    rng = random_stream(seed, "twin", "ct", insertion.planned.id)
    turned = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).as_matrix()
    tilted = Rotation.from_rotvec(rng.uniform(-MAX_TILT_DEG, MAX_TILT_DEG, 3), degrees=True).as_matrix()
    world = Frame(rng.uniform(-MAX_OFFSET_MM, MAX_OFFSET_MM, 3), turned @ tilted @ UPRIGHT_ROTATION)
    places = random_stream(seed, "twin", "markers", insertion.planned.id)
    corners = np.array(list(product(*zip(setup.low, setup.high, strict=True))))
    frame = insertion.true_insertion.frame
    grid = _fit_grid(
        world.to_world(np.vstack([corners, frame.to_world([[-setup.outside, 0.0, 0.0]])])), turned
    )
    return PlacedInsertion(
        world, grid, setup.markers + setup.known_sd * places.normal(size=setup.markers.shape)
    )


def sample_whole_needle(insertion: SyntheticInsertion) -> Floats:
    """Return the whole needle's axis (N, 3) from base to tip, world, mm."""
    depth = insertion.true_insertion.shape.depth
    s = np.linspace(depth - NOMINAL_NEEDLE.length, depth, 4 * round(NOMINAL_NEEDLE.length) + 1)
    return needle_points(
        insertion.true_insertion.shape, insertion.true_insertion.frame, insertion.deviations, s
    )


def _fit_grid(points: Floats, direction: Floats) -> VoxelGrid:
    """Return the least grid along `direction` (3, 3) with `points` (N, 3) in it, patient."""
    local = points @ direction
    low, high = local.min(axis=0) - FIELD_MARGIN_MM, local.max(axis=0) + FIELD_MARGIN_MM
    columns, rows, slices = (int(n) for n in np.ceil((high - low) / VOXEL_MM))
    return VoxelGrid((columns, rows, slices), direction @ low, np.full(3, VOXEL_MM), direction)


def write_layers(folder: Path, plan: Sequence[InsertionDesign]) -> None:
    """Write the stated surfaces of the media in `plan`."""
    for medium in dict.fromkeys(planned.medium for planned in plan):
        for surface in make_surfaces(PHANTOMS[medium]):
            write_surface(surface, folder / surface_file_name(medium, surface))


def make_stated_scan(folder: Path, planned: InsertionDesign, volume: Path, markers: Path) -> Scan:
    """Return the stated data of a scan: the plan, not the truth; y of C points to +y of the phantom."""
    sources = (
        LayerSource(folder / surface_file_name(planned.medium, surface), surface.kind, surface.into)
        for surface in make_surfaces(PHANTOMS[planned.medium])
    )
    return Scan(
        id=planned.id,
        volume=volume,
        medium=planned.medium,
        specimen=planned.specimen,
        markers=markers,
        surfaces=tuple(sources),
        stage=StagePose(
            planned.origin, planned.direction, POSE_SHIFT_SD_MM, float(np.radians(POSE_ANGLE_SD_DEG))
        ),
        bevel=planned.side * planned.toward,
        side=planned.side,
        layers=planned.layers,
        layers_alternative=planned.layers_alternative,
        origin="synthetic",
    )
