"""Acquire the synthetic scans, and write them as the input of `needlefit reconstruct`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import BEVEL_COLUMNS, DIRECTION_COLUMNS, ENTRY_COLUMNS, InsertionRow
from needlefit.datasets.write import format_cells
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import write_surface
from needlefit.imaging.scans import LayerSource, Scan, StagePose
from needlefit.imaging.volume import VoxelGrid
from needlefit.imaging.volume_files import write_volume
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import TaskPool, run_in_order
from needlefit.project.toml import dumps
from needlefit.schemas.reconstruction import MarkersRecord, ReconstructionRecord, ScannedNeedleRecord
from needlefit.synthetic import design
from needlefit.synthetic.design import (
    BOX_MM,
    NOMINAL_NEEDLE,
    PHANTOMS,
    POSE_ANGLE_SD_DEG,
    POSE_SHIFT_SD_MM,
    TRUE_MEDIA,
    InsertionDesign,
    make_surfaces,
    surface_file_name,
)
from needlefit.synthetic.insertion import SyntheticInsertion, needle_points, simulate_insertion
from needlefit.synthetic.render import Needle3D, Scanner, ScannerTable, Scene3D, SceneMarkers, render_scan


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


def choose_setup(planned: InsertionDesign) -> ScanSetup:
    return SAMPLE_SETUP if planned.id == design.SAMPLE_INSERTION.id else WHOLE_BOX_SETUP


VOXEL_MM = 0.46  # edge of a voxel, mm: the paper's
FIELD_MARGIN_MM = 2.0  # margin of the scanned field around what it must contain, mm
# Columns: the world's x (into the box) to the head, y to the right, z (up) to the front of the patient.
UPRIGHT_ROTATION = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
MAX_TILT_DEG = 6.0  # degrees, of the box about each axis
MAX_OFFSET_MM = 150.0  # mm along it from the patient's origin
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
    """Place an insertion in the scanner; the result depends on its own plan and the seed only."""
    rng = random_stream(seed, "twin", "ct", insertion.planned.id)
    # the order of draws from `rng` is part of the dataset: a new draw goes to the end
    turned = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).as_matrix()
    tilted = Rotation.from_rotvec(rng.uniform(-MAX_TILT_DEG, MAX_TILT_DEG, 3), degrees=True).as_matrix()
    world = Frame(rng.uniform(-MAX_OFFSET_MM, MAX_OFFSET_MM, 3), turned @ tilted @ UPRIGHT_ROTATION)
    shaft = sample_whole_needle(insertion)
    needle = Needle3D(
        points=world.to_world(shaft),
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
    places = random_stream(seed, "twin", "markers", insertion.planned.id)
    corners = np.array(list(product(*zip(setup.low, setup.high, strict=True))))
    frame = insertion.true_insertion.frame
    grid = _fit_grid(
        world.to_world(np.vstack([corners, frame.to_world([[-setup.outside, 0.0, 0.0]])])), turned
    )
    return Exposure(
        scene,
        Scanner(
            grid,
            psf_mm=rng.uniform(*PSF_RANGE_MM),
            noise_hu=rng.uniform(*NOISE_RANGE_HU),
            bloom=rng.uniform(*BLOOM_RANGE),
            streaks=rng.uniform(*STREAKS_RANGE),
            cupping_hu=rng.uniform(*CUPPING_RANGE_HU),
        ),
        setup.markers + setup.known_sd * places.normal(size=setup.markers.shape),
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
    for done in run_in_order(partial(_render_scan, folder, seed, dicom), plan, pool):
        scans.append(done)
        progress(f"rendered {done.id}", len(scans), len(plan))
    recipe = make_recipe([choose_setup(planned) for planned in plan])
    if recipe.model_fields_set - {"schema_"}:
        text = dumps(recipe.model_dump(mode="json", by_alias=True, exclude_unset=True))
        (folder / "recipe.toml").write_bytes(text.encode("utf-8"))
    table = folder / "scans.csv"
    rows = [STATED_COLUMNS, *(_format_scan(scan, folder) for scan in scans)]
    table.write_bytes("".join(",".join(row) + "\n" for row in rows).encode("utf-8"))
    return table


def write_layers(folder: Path, plan: Sequence[InsertionDesign]) -> None:
    """Write the stated surfaces of the media in `plan`."""
    for medium in dict.fromkeys(planned.medium for planned in plan):
        for surface in make_surfaces(PHANTOMS[medium]):
            write_surface(surface, folder / surface_file_name(medium, surface))


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
    write_volume(rendered, volume, f"Synthetic: needlefit twin ct {name} --seed {seed}")
    return RenderedInsertion(insertion, exposure, make_stated_scan(folder, planned, volume, markers))


def make_recipe(setups: Sequence[ScanSetup]) -> ReconstructionRecord:
    """Return the recipe that states how well the markers' places are known, if not the default."""
    plain = ReconstructionRecord(schema_=ReconstructionRecord.SCHEMA)
    known_sd = max(setup.known_sd for setup in setups)
    if known_sd == plain.markers.reference_sd_mm:
        return plain
    return ReconstructionRecord(
        schema_=ReconstructionRecord.SCHEMA,
        title="Twin",
        needle=ScannedNeedleRecord(name="18 gauge, 150 mm", note="Nominal; solid, its stylet in place."),
        markers=MarkersRecord(reference_sd_mm=known_sd),
    )


def _render_scan(folder: Path, seed: int, dicom: bool, planned: InsertionDesign) -> Scan:
    return render_insertion(folder, planned, seed, dicom).scan


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
