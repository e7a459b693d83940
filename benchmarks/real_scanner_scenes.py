"""The fixed design of `real_scanners.py`, and the scene, truth and volume of each of its rows.

The world's x axis points into the tissue, whose face is x = 0: three layers, a bent steel needle of 1.27 mm,
balls glued on the face or embedded. Everything is rendered in projection space (`scanner/projection.py`).
"""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scanner.projection import (
    ALUMINIUM,
    BONE,
    BRASS,
    CERAMIC,
    CLIPPED_HU,
    EXTENDED_HU,
    GEL,
    GLASS,
    KERNELS,
    MUSCLE,
    PMMA,
    STEEL,
    WATER,
    Box,
    Ellipsoid,
    Gantry,
    Material,
    ProjectionScene,
    Rod,
    Solid,
    make_ball,
    make_needle,
    render_volume,
)
from scanner.write import write_volume
from scipy.spatial.transform import Rotation

from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import VoxelGrid
from needlefit.project.random_streams import random_stream

Floats = NDArray[np.float64]

FACTORS = ("kernel", "way", "voxels", "material", "ball_mm", "balls", "ceiling", "accessory", "beam", "dose")

DESIGN = """
t01 edge     along    0.5x2.0 brass   3 4    extended none    parallel low
t02 soft     along    0.6x0.6 steel   2 7    clip     hub     parallel high
t03 soft     oblique  0.4x1.0 brass   5 6of7 clip     hub     fan      high
t04 standard inplane  0.4x1.0 ceramic 2 7    extended none    parallel high
t05 soft     inplane  0.6x0.6 glass   5 4    extended wire    parallel high
t06 edge     oblique  0.4x0.4 steel   3 4    clip     second  parallel high
t07 edge     inplane  0.2x0.3 steel   5 4    clip     plate   parallel low
t08 standard oblique  0.4x0.4 steel   1 6of7 clip     none    parallel high
t09 standard inplane  0.5x2.0 brass   5 6of7 clip     plate   parallel high
t10 soft     inplane  0.2x0.3 steel   1 7    extended second  parallel low
t11 bone     along    0.2x0.3 ceramic 1 4    clip     none    parallel high
t12 standard oblique  0.4x0.4 ceramic 3 6of7 extended wire    parallel low
t13 edge     oblique  0.6x0.6 glass   2 7    extended none    fan      low
t14 soft     along    0.4x1.0 glass   2 6of7 clip     second  parallel low
t15 standard along    0.4x0.4 steel   2 4    clip     holder  fan      low
t16 bone     oblique  0.4x1.0 glass   3 4    clip     holder  parallel high
t17 bone     oblique  0.5x2.0 steel   5 7    clip     bone    parallel low
t18 standard along    0.6x0.6 steel   3 6of7 extended bone    parallel high
t19 bone     along    0.5x2.0 steel   3 7    extended plate   fan      high
t20 bone     inplane  0.6x0.6 brass   3 7    clip     holder  parallel low
t21 edge     along    0.4x1.0 steel   3 7    clip     wire    parallel low
t22 soft     oblique  0.4x0.4 steel   5 7    extended none    parallel low
t23 edge     inplane  0.4x0.4 glass   2 7    clip     bone    parallel high
t24 bone     inplane  0.4x0.4 steel   1 6of7 extended hub     fan      low
a01 edge     oblique  0.2x0.3 glass   2 6of7 clip     none    parallel high
a02 edge     along    0.4x0.4 steel   3 7    extended plate   parallel high
a03 standard along    0.5x2.0 glass   5 7    clip     second  parallel high
a04 edge     inplane  0.6x0.6 ceramic 3 6of7 extended hub     parallel high
a05 bone     inplane  0.4x0.4 glass   3 6of7 clip     none    fan      low
a06 bone     oblique  0.4x1.0 steel   3 4    extended none    parallel low
a07 standard oblique  0.6x0.6 steel   2 6of7 extended second  parallel low
a08 edge     along    0.4x0.4 steel   1 7    clip     none    parallel high
a09 edge     inplane  0.5x2.0 steel   5 4    clip     wire    parallel low
a10 bone     along    0.4x1.0 steel   5 6of7 extended none    parallel high
a11 soft     along    0.6x0.6 ceramic 2 4    clip     second  fan      high
a12 soft     inplane  0.6x0.6 brass   3 7    clip     none    parallel low
a13 standard oblique  0.2x0.3 ceramic 1 7    clip     bone    parallel low
a14 edge     oblique  0.4x1.0 brass   5 7    extended holder  fan      low
a15 standard along    0.4x0.4 glass   5 4    extended hub     parallel low
a16 soft     oblique  0.5x2.0 steel   3 4    extended bone    fan      high
a17 soft     along    0.5x2.0 steel   3 6of7 clip     holder  parallel low
a18 bone     along    0.4x0.4 brass   2 6of7 clip     wire    parallel low
a19 soft     inplane  0.4x0.4 brass   1 4    extended bone    parallel high
a20 bone     oblique  0.6x0.6 steel   5 7    clip     hub     parallel high
a21 standard inplane  0.4x1.0 steel   3 7    clip     wire    fan      high
a22 soft     oblique  0.4x0.4 glass   1 7    clip     plate   parallel low
a23 standard inplane  0.4x1.0 steel   2 4    clip     plate   parallel low
a24 bone     inplane  0.2x0.3 steel   2 7    extended holder  parallel high
"""
"""A fraction of the factorial: `t` is for tuning, `a` kept apart; they share no combination and no seed.
Levels of every two factors meet about as often as their numbers ask for, in each part; a ball is at least
as wide as 1.5 slices. Fixed before anything was tuned: do not edit."""

SEED = 2020

MATERIALS = {
    "steel": STEEL,
    "brass": BRASS,
    "glass": GLASS,
    "ceramic": CERAMIC,
}
PHOTONS = {"low": 5e4, "high": 4e5}

NEEDLE_MM, NEEDLE_LENGTH_MM, BEVEL_DEG = 1.27, 100.0, 30.0
PLATE_MM = 8.0  # thickness of the guide, mm
BALL_PLACES = np.array(
    [
        [0.0, 12, 6],  # these two are glued on the face
        [0.0, -13, -5],
        [9.0, 15, -12],
        [17.0, -15, 9],
        [26.0, 4, 16],
        [36.0, -9, -15],
        [44.0, 14, 3],
    ]
)
FOUR_BALLS = [0, 3, 5, 6]
MISSING_BALL = 4
KNOWN_SD_MM = 0.1
"""Deviation of the stated places of the balls in any one direction, mm."""

FIELD_LOW, FIELD_HIGH = np.array([-26.0, -20, -20]), np.array([52.0, 20, 20])
"""Corners of the scanned part of the world, mm."""


@dataclass(frozen=True)
class Row:
    """A row of the design: its name, and the level of each factor."""

    name: str
    levels: dict[str, str]


@dataclass(frozen=True)
class Case:
    """A scene in the scanner and what is true of it.

    Attributes
    ----------
    world : Frame
        The world in the scan (LPS).
    axis : (N, 3) array
        Of the needle, base to tip, world, mm.
    bevel : (3,) array
        Toward the point of the bevel, world.
    balls, known : (M, 3) arrays
        Those in the scan, world; and the stated places of all.
    interfaces : (2,) array
        Of the layers, x, mm.
    isocenter : (3,) array
        A point of the gantry's axis, scan.
    """

    row: Row
    scene: ProjectionScene
    gantry: Gantry
    grid: VoxelGrid
    world: Frame
    axis: Floats
    bevel: Floats
    balls: Floats
    known: Floats
    interfaces: Floats
    isocenter: Floats


def read_design(part: str) -> list[Row]:
    """Return the rows of "tuning", "apart" or "all"."""
    lines = [line.split() for line in DESIGN.strip().splitlines()]
    wanted = {"tuning": "t", "apart": "a", "all": ""}[part]
    return [
        Row(name, dict(zip(FACTORS, levels, strict=True)))
        for name, *levels in lines
        if name.startswith(wanted)
    ]


IN_SLICE_MM = ("0.8", "1.0", "1.5", "2.0")
"""Slices, in turn, of volumes that are drawn by a seed."""
LEVELS = {
    "kernel": ("soft", "standard", "bone", "edge"),
    "material": ("steel", "brass", "glass", "ceramic"),
    "balls": ("7", "6of7", "4"),
    "ceiling": ("clip", "extended"),
    "accessory": ("none", "none", "hub", "holder", "plate", "second", "wire", "bone"),
    "beam": ("parallel", "fan"),
    "dose": ("high", "low"),
}


def draw_row(seed: int, way: str = "inplane") -> Row:
    """Draw the levels of a volume whose needle lies in slices of 0.8 to 2 mm; balls are 1.5 slices wide.

    `way` "flat": it bends in the slices alone, and they turn by at most 1 degree against it.
    """
    rng = random_stream(SEED, "levels", seed)
    levels = {name: str(rng.choice(choices)) for name, choices in LEVELS.items()}
    slices = IN_SLICE_MM[seed % len(IN_SLICE_MM)]
    sizes = [size for size in ("2", "3", "5") if float(size) >= 1.5 * float(slices)]
    levels |= {"way": way, "voxels": f"{rng.choice(('0.3', '0.4', '0.5', '0.6'))}x{slices}"}
    levels["ball_mm"] = str(rng.choice(sizes))
    return Row(f"{'f' if way == 'flat' else 's'}{seed}", {name: levels[name] for name in FACTORS})


def make_case(row: Row) -> Case:
    """Return the scene of a row; it depends on the row and `SEED` only."""
    rng, level = random_stream(SEED, "real scanners", row.name), row.levels
    world = _place_world(level["way"], rng)
    axis, bevel = _draw_needle(rng, level["way"] == "flat")
    interfaces = np.array([rng.uniform(10, 14), rng.uniform(22, 28)])
    diameter = float(level["ball_mm"])
    places = BALL_PLACES - np.where(BALL_PLACES[:, :1] == 0, [diameter / 2, 0, 0], 0.0)
    places = places + rng.uniform(-1, 1, places.shape) * [0, 1, 1]
    places = places[FOUR_BALLS] if level["balls"] == "4" else places
    known = places + KNOWN_SD_MM * rng.normal(size=places.shape)
    balls = np.delete(places, MISSING_BALL, axis=0) if level["balls"] == "6of7" else places
    scene = _build_scene(level, world, axis, bevel, balls, interfaces)
    spacing = np.array([float(x) for x in level["voxels"].split("x")])[[0, 0, 1]]
    gantry = Gantry(
        slice_mm=spacing[2],
        photons=PHOTONS[level["dose"]],
        source_mm=570.0 if level["beam"] == "fan" else None,
    )
    grid = _fit_grid(world, spacing)
    middle = grid.origin + (np.array(grid.size) - 1) / 2 * grid.spacing
    return Case(row, scene, gantry, grid, world, axis, bevel, balls, known, interfaces, middle)


PTFE, POLYETHYLENE = Material(1.95, {"water": 1.0}), Material(0.93, {"water": 1.0})
"""As bright as those plastics: their parts are not in the table."""
GUIDES = {
    "PMMA": PMMA,
    "PTFE": PTFE,
    "PE": POLYETHYLENE,
    "aluminium": ALUMINIUM,
    "glass": GLASS,
    "steel": STEEL,
}
GUIDE_MM, GAP_MM = (2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0), (0.0, 0.0, 2.0, 3.0, 6.0, 11.0)
STATED_GUIDE_MM = 8.0
"""What the recipe states where there is no guide."""


def draw_guided(seed: int) -> tuple[Case, float, str]:
    """Draw a narrow volume with a guide, or none: return it, the thickness that is stated, mm, and words."""
    rng, way = random_stream(SEED, "guides", seed), ("inplane", "oblique", "along")[seed % 3]
    levels = {name: str(rng.choice(choices)) for name, choices in LEVELS.items()}
    slices = ("0.6", "1.0") if way == "oblique" else ("0.6", "1.0", "1.5", "2.0")
    levels |= {"way": way, "voxels": f"{rng.choice(('0.4', '0.5'))}x{rng.choice(slices)}", "ball_mm": "3"}
    case = make_case(Row(f"g{seed}", levels | {"accessory": "none", "beam": "parallel", "dose": "high"}))
    name, gap = str(rng.choice(["none", *GUIDES])), float(rng.choice(GAP_MM))
    thickness = float(rng.choice(GUIDE_MM)) if name != "none" else STATED_GUIDE_MM
    low, high = np.array([-gap - thickness, -18, -18]), np.array([-gap, 18, 18])
    plate = () if name == "none" else (Box(case.world, low, high, GUIDES[name]),)
    metal = tuple(one for one in case.scene.metal if isinstance(one, Rod))
    case = narrow_case(replace(case, scene=replace(case.scene, inserts=plate, metal=metal)))
    return case, thickness, f"{name}, {thickness:g} mm, {gap:g} mm before the tissue"


AROUND_MM, SLICES_AROUND, SLICE_RAYS = 9.0, 4, 8
"""What a narrow volume shows around the needle: in the slices, mm, and along their normal, slices or mm. And
rays across its slices."""


def narrow_case(case: Case) -> Case:
    """Return a case whose volume shows the needle and little else."""
    grid = case.grid
    x = np.append(np.linspace(FIELD_LOW[0], case.axis[-1, 0], 50), case.axis[-1, 0] + 8.0)
    points = case.world.to_world(
        np.stack([x, *(np.interp(x, case.axis[:, 0], y) for y in case.axis.T[1:])], 1)
    )
    pad = np.array([AROUND_MM, AROUND_MM, SLICES_AROUND * max(1.0, grid.spacing[2])])
    low = np.floor((points.min(axis=0) - pad - grid.origin) / grid.spacing).clip(0).astype(int)
    high = np.ceil((points.max(axis=0) + pad - grid.origin) / grid.spacing).astype(int) + 1
    size = tuple(int(n) for n in np.minimum(high, grid.size) - low)
    part = VoxelGrid(size, grid.origin + low * grid.spacing, grid.spacing, grid.direction)
    return replace(case, grid=part, gantry=replace(case.gantry, slice_rays=SLICE_RAYS))


def render_cached(case: Case, folder: Path) -> Path:
    """Return the volume of a case in `folder`; it is rendered if it is not there yet."""
    key = hashlib.sha256(repr((SEED, case.row, case.grid.size, case.gantry.slice_rays)).encode()).hexdigest()[
        :8
    ]
    path = folder / f"{case.row.name}-{key}.nrrd"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    ceiling = CLIPPED_HU if case.row.levels["ceiling"] == "clip" else EXTENDED_HU
    rng = random_stream(SEED, "real scanners", case.row.name, "noise")
    kernel = KERNELS[case.row.levels["kernel"]]
    volume = render_volume(case.scene, case.gantry, case.grid, kernel, ceiling, rng, case.isocenter)
    unfinished = folder / f"unfinished-{path.name}"
    write_volume(volume, unfinished, f"Synthetic: benchmarks/real_scanners.py {case.row.name}")
    unfinished.rename(path)
    return path


def _place_world(way: str, rng: np.random.Generator) -> Frame:
    """Return the world in the scan: its x axis along the slices' normal, oblique, or in the slices."""
    along = {"along": 0.0, "oblique": rng.uniform(35, 55), "inplane": rng.uniform(84, 96)}
    along["flat"] = 90 + (along["inplane"] - 90) / 6
    upright = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # columns: x to the head
    tilt = Rotation.from_euler("y", along[way], degrees=True)
    turned = [0, 0, 1] if way == "flat" else 1
    turn = Rotation.from_rotvec(rng.uniform(-4, 4, 3) * turned, degrees=True)
    return Frame(rng.uniform(-80, 80, 3), (turn * tilt).as_matrix() @ upright)


def _draw_needle(rng: np.random.Generator, flat: bool) -> tuple[Floats, Floats]:
    """Return the axis of a needle that bends toward its bevel's point, and the direction of that.

    A `flat` one stays where the world's y axis, the slices' normal, is 0.
    """
    depth, angle = rng.uniform(36, 42), rng.uniform(0, 2 * np.pi)
    angle = np.pi / 2 if flat else angle
    side = np.array([0.0, np.cos(angle), np.sin(angle)])
    x = np.concatenate([np.linspace(depth - NEEDLE_LENGTH_MM, 0, 16)[:-1], np.linspace(0, depth, 25)])
    bend, slope = rng.uniform(0.5, 4.0), np.radians(rng.uniform(-2, 2, 2)) * (not flat, 1)
    part = np.clip(x, 0, None) / depth
    curve = bend * (1.5 * part**2 - 0.5 * part**3)  # no curvature at the tip
    axis = np.column_stack([x, slope[0] * x, slope[1] * x]) + curve[:, None] * side
    return axis, side


def _build_scene(
    level: dict[str, str], world: Frame, axis: Floats, bevel: Floats, balls: Floats, interfaces: Floats
) -> ProjectionScene:
    edges = [0.0, *interfaces, 55.0]
    tissue = (GEL, WATER, MUSCLE)
    layers = tuple(
        Box(world, np.array([low, -24, -24]), np.array([high, 24, 24]), material)
        for low, high, material in zip(edges[:-1], edges[1:], tissue, strict=True)
    )
    side = world.rotation @ bevel
    needle = make_needle(world.to_world(axis), NEEDLE_MM, BEVEL_DEG, side, STEEL)
    spheres = [
        make_ball(place, float(level["ball_mm"]), MATERIALS[level["material"]])
        for place in world.to_world(balls)
    ]
    inserts, metal = _list_accessories(level["accessory"], world, axis)
    return ProjectionScene(layers, tuple(inserts), (*needle, *spheres, *metal))


def _list_accessories(name: str, world: Frame, axis: Floats) -> tuple[list[Solid], list[Solid]]:
    """Return what else is in the scan: inserts, and metal."""
    way = (axis[1] - axis[0]) / np.linalg.norm(axis[1] - axis[0])

    def on_shaft(x: float) -> Floats:
        point: Floats = world.to_world((axis[0] + (x - axis[0, 0]) / way[0] * way)[None])[0]
        return point

    def block(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Floats, Floats]:
        return np.array(low), np.array(high)

    match name:
        case "hub":  # brass, clamped on the shaft
            return [], [Rod(on_shaft(-45), on_shaft(-18), 3.0, BRASS, NEEDLE_MM / 2)]
        case "holder":  # an aluminium block with a hole that the needle fills
            return [Box(world, *block((-24, -8, -6), (-16, 8, 6)), ALUMINIUM)], []
        case "plate":  # a guide of PMMA, and 11 mm of air behind it
            return [Box(world, *block((-11 - PLATE_MM, -24, -24), (-11, 24, 24)), PMMA)], []
        case "second":  # half as long as what shows of the first
            points = world.to_world(np.array([[-14.0, -2, 11], [3, -2, 11], [20, -2, 11]]))
            return [], list(make_needle(points, NEEDLE_MM, BEVEL_DEG, world.rotation[:, 1], STEEL))
        case "wire":
            ends = world.to_world(np.array([[-0.5, -14.0, 13], [-0.5, 14, 13]]))
            return [], [Rod(ends[0], ends[1], 0.4, STEEL)]
        case "bone":
            middle = world.to_world(np.array([[22.0, 0, -13]]))[0]
            radii = np.array([9.0, 6, 4])
            return [Ellipsoid(Frame(middle, world.rotation), radii, BONE)], []
    return [], []


def _fit_grid(world: Frame, spacing: Floats) -> VoxelGrid:
    corners = np.array(np.meshgrid(*np.column_stack([FIELD_LOW, FIELD_HIGH]))).reshape(3, -1).T
    points = world.to_world(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    columns, rows, slices = (int(n) for n in np.ceil((high - low) / spacing))
    return VoxelGrid((columns, rows, slices), low, spacing, np.eye(3))
