"""Simulate a CT scan by projections: solids, materials and spectrum, acquisition, reconstruction."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame, normalize
from needlefit.imaging.volume import Volume, VoxelGrid
from scanner.render import ParallelBeam, make_back_projector

TABLE_ENERGIES_KEV = np.array([30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0])

MASS_ATTENUATION_CM2_PER_G = {
    "O": (0.3779, 0.2585, 0.2132, 0.1907, 0.1678, 0.1551, 0.1361),
    "Na": (0.7197, 0.3969, 0.2804, 0.2268, 0.1796, 0.1585, 0.1335),
    "Al": (1.128, 0.5685, 0.3681, 0.2778, 0.2018, 0.1704, 0.1378),
    "Si": (1.436, 0.7012, 0.4385, 0.3207, 0.2228, 0.1835, 0.1448),
    "Ca": (4.080, 1.830, 1.019, 0.6578, 0.3656, 0.2571, 0.1674),
    "Cr": (6.434, 2.856, 1.550, 0.9639, 0.4905, 0.3166, 0.1788),
    "Fe": (8.176, 3.629, 1.958, 1.205, 0.5952, 0.3717, 0.1964),
    "Ni": (10.34, 4.600, 2.474, 1.512, 0.7306, 0.4440, 0.2208),
    "Cu": (10.92, 4.862, 2.613, 1.593, 0.7630, 0.4584, 0.2217),
    "Zn": (12.07, 5.384, 2.892, 1.760, 0.8364, 0.4973, 0.2341),
    "water": (0.3756, 0.2683, 0.2269, 0.2059, 0.1837, 0.1707, 0.1505),
    "PMMA": (0.3032, 0.2350, 0.2074, 0.1924, 0.1751, 0.1641, 0.1456),
    "cortical bone": (1.331, 0.6655, 0.4242, 0.3148, 0.2229, 0.1855, 0.1480),
    "skeletal muscle": (0.3783, 0.2685, 0.2262, 0.2048, 0.1823, 0.1693, 0.1492),
}
"""At `TABLE_ENERGIES_KEV`: elements, and mixtures as NIST defines them."""


@dataclass(frozen=True)
class Material:
    """A material: its density, g/cm3, and the parts of its mass, by name in the table."""

    density: float
    parts: Mapping[str, float]


WATER = Material(1.0, {"water": 1.0})
GEL = Material(1.04, {"water": 1.0})
MUSCLE = Material(1.05, {"skeletal muscle": 1.0})
BONE = Material(1.92, {"cortical bone": 1.0})
PMMA = Material(1.19, {"PMMA": 1.0})
GLASS = Material(2.5, {"O": 0.46, "Na": 0.10, "Si": 0.34, "Ca": 0.10})
CERAMIC = Material(3.9, {"Al": 0.53, "O": 0.47})
ALUMINIUM = Material(2.70, {"Al": 1.0})
STEEL = Material(7.9, {"Fe": 0.71, "Cr": 0.19, "Ni": 0.10})
BRASS = Material(8.5, {"Cu": 0.63, "Zn": 0.37})


def attenuation(material: Material, energies_kev: Floats) -> Floats:
    """Return the attenuation of a material (E,) at energies (E,) of 30 to 150 keV, 1/mm."""
    table = sum(part * np.array(MASS_ATTENUATION_CM2_PER_G[name]) for name, part in material.parts.items())
    mass = np.exp(np.interp(np.log(energies_kev), np.log(TABLE_ENERGIES_KEV), np.log(table)))
    per_mm: Floats = material.density * mass / 10
    return per_mm


@dataclass(frozen=True)
class Spectrum:
    """A spectrum as the detector weighs it: `energies_kev` (E,), and `weights` (E,) with the sum 1."""

    energies_kev: Floats
    weights: Floats


FILTER_MM = 8.0
"""Aluminium, mm, that filters the beam as much as tube and housing do."""

CHARACTERISTIC_LINES = {59.0: 0.12, 67.5: 0.04}
"""K lines of tungsten, keV, and how many photons each adds, in parts of the continuous spectrum."""

BIN_KEV = 10.0


def tungsten_spectrum(tube_kv: float) -> Spectrum:
    """Return the spectrum of a tungsten tube: Kramers' law behind aluminium, and the K lines.

    The detector integrates energy.
    """
    edges = np.arange(30.0, tube_kv + 1e-9, BIN_KEV)
    energies = (edges[:-1] + edges[1:]) / 2
    photons = (tube_kv / energies - 1) * np.exp(-FILTER_MM * attenuation(ALUMINIUM, energies))
    total = photons.sum()
    for line, part in CHARACTERISTIC_LINES.items():
        photons[np.searchsorted(edges, line) - 1] += part * total
    weights = photons * energies
    return Spectrum(energies, weights / weights.sum())


Reals = NDArray[np.floating[Any]]
"""Arrays over rays: in single precision where the rays are."""

FLAT = 1e-9
"""What is smaller counts as parallel: keeps divisions finite."""


@dataclass(frozen=True)
class Rays:
    """Rays in the planes of a scanner's slices; the arrays broadcast against each other.

    Attributes
    ----------
    frame : Frame
        Origin on the rotation's axis; z along it. Its axes may be left-handed, as those of voxels.
    cos, sin : arrays
        Of the angle under which the detector stands; a ray runs along (-sin, cos, 0).
    t, z : arrays
        Along the detector, and along the axis, mm.
    """

    frame: Frame
    cos: Reals
    sin: Reals
    t: Reals
    z: Reals

    def components(self, point: Floats, axis: Floats) -> tuple[Reals, Reals]:
        """Return how far each ray's foot lies from `point` along `axis`, mm, and its slope along `axis`."""
        # plain floats: a scalar of numpy would widen rays of single precision
        x, y, z = (self.frame.rotation.T @ axis).tolist()
        foot = float((self.frame.origin - point) @ axis)
        return self.t * (x * self.cos + y * self.sin) + (foot + z * self.z), y * self.cos - x * self.sin


Interval = tuple[Reals, Reals]
"""Where rays enter and leave, mm from their feet; the first is larger where they miss."""


@dataclass(frozen=True)
class Box:
    """A box: layers, plates, tables. `low`, `high` (3,) are its corners in `frame`, mm."""

    frame: Frame
    low: Floats
    high: Floats
    material: Material

    def interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave."""
        enter: Reals = np.array(-np.inf, dtype=rays.t.dtype)
        leave: Reals = -enter
        for n in range(3):
            at, slope = rays.components(self.frame.origin, self.frame.rotation[:, n])
            slope = np.where(np.abs(slope) < FLAT, FLAT, slope)
            one, other = (float(self.low[n]) - at) / slope, (float(self.high[n]) - at) / slope
            enter = np.maximum(enter, np.minimum(one, other))
            leave = np.minimum(leave, np.maximum(one, other))
        return enter, leave

    def bounds(self) -> Floats:
        """Return its corners (8, 3)."""
        corners = np.array(np.meshgrid(*np.column_stack([self.low, self.high]))).reshape(3, -1).T
        return self.frame.to_world(corners)


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid: balls, bones. `radii` (3,) along the axes of `frame`, whose origin is the centre, mm."""

    frame: Frame
    radii: Floats
    material: Material

    def interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave."""
        a: Reals = np.array(0.0, dtype=rays.t.dtype)
        b, c = a, a - 1
        for n in range(3):
            at, slope = rays.components(self.frame.origin, self.frame.rotation[:, n] / self.radii[n])
            a, b, c = a + slope**2, b + at * slope, c + at**2
        return _roots(a, b, c)

    def bounds(self) -> Floats:
        """Return the corners of a box around it (8, 3)."""
        return Box(self.frame, -self.radii, self.radii, self.material).bounds()


@dataclass(frozen=True)
class Rod:
    """A cylinder or tube between two planes: wires, hubs, pieces of a needle.

    Attributes
    ----------
    start, end : (3,) arrays
        Ends of its axis, mm.
    radius, bore : float
        Of its surface and of the hole along its axis, mm; the hole is open to whatever is around.
    cuts : tuple of (point, normal)
        Further planes; what lies on the side of the normal is cut off. Without them it ends flat.
    """

    start: Floats
    end: Floats
    radius: float
    material: Material
    bore: float = 0.0
    cuts: tuple[tuple[Floats, Floats], ...] = ()

    @property
    def axis(self) -> Floats:
        """Its direction (3,)."""
        return normalize(self.end - self.start)

    def interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave its outer surface."""
        return self._cut(rays, self.radius)

    def bore_interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave the hole."""
        return self._cut(rays, self.bore)

    def _cut(self, rays: Rays, radius: float) -> Interval:
        a: Reals = np.array(0.0, dtype=rays.t.dtype)
        b, c = a, a - radius**2
        for side in np.linalg.svd(self.axis[None])[2][1:]:
            at, slope = rays.components(self.start, side)
            a, b, c = a + slope**2, b + at * slope, c + at**2
        enter, leave = _roots(a, b, c)
        flat = ((self.start, -self.axis), (self.end, self.axis))
        for point, normal in self.cuts or flat:
            at, slope = rays.components(point, normal)
            slope = np.where(np.abs(slope) < FLAT, FLAT, slope)
            cross = -at / slope
            leave = np.where(slope > 0, np.minimum(leave, cross), leave)
            enter = np.where(slope > 0, enter, np.maximum(enter, cross))
        return enter, leave

    def bounds(self) -> Floats:
        """Return the corners of boxes around its ends (16, 3); the reach of oblique cuts is in them."""
        reach = np.full(
            3, self.radius * (1 + max((_overhang(self.axis, n) for _, n in self.cuts), default=0))
        )
        ends = [Frame(end, np.eye(3)) for end in (self.start, self.end)]
        return np.vstack([Box(frame, -reach, reach, self.material).bounds() for frame in ends])


Solid = Box | Ellipsoid | Rod


def make_ball(center: Floats, diameter: float, material: Material) -> Ellipsoid:
    """Return a ball."""
    return Ellipsoid(Frame(center, np.eye(3)), np.full(3, diameter / 2), material)


def make_needle(
    points: Floats,
    diameter: float,
    bevel_deg: float,
    bevel_toward: Floats,
    material: Material,
) -> list[Rod]:
    """Return the rods of a needle along `points` (N, 3) from base to tip, mm.

    Its point lies at the last of `points`, on the side `bevel_toward` (3,); `bevel_deg` is the angle of the
    face to the axis.
    """
    pieces = np.diff(points, axis=0)
    ways = pieces / np.linalg.norm(pieces, axis=1, keepdims=True)
    side = normalize(bevel_toward - (bevel_toward @ ways[-1]) * ways[-1], "the bevel's side")
    angle = np.radians(bevel_deg)
    face = (points[-1] + diameter / 2 * side, np.sin(angle) * ways[-1] - np.cos(angle) * side)
    joints = [normalize(one + other) for one, other in pairwise(ways)]
    planes = [(points[0], ways[0]), *zip(points[1:-1], joints, strict=True)]
    left = np.linalg.norm(points[-1] - points[1:], axis=1)
    rods = []
    for n, (start, end) in enumerate(pairwise(points)):
        cuts = [(planes[n][0], -planes[n][1]), *planes[n + 1 : n + 2]]
        if left[n] <= 2 * diameter / np.tan(angle):  # the face reaches back over several pieces
            cuts.append(face)
        rods.append(Rod(start, end, diameter / 2, material, cuts=tuple(cuts)))
    return rods


def interval_length(intervals: Sequence[Interval]) -> Reals:
    """Return how much of each ray lies in all `intervals`, mm."""
    enter, leave = intervals[0]
    for one, other in intervals[1:]:
        enter, leave = np.maximum(enter, one), np.minimum(leave, other)
    length: Reals = np.clip(leave - enter, 0, None)
    return length


def _roots(a: Reals, b: Reals, c: Reals) -> Interval:
    """Return the interval in which a x^2 + 2 b x + c is negative; a miss gives an empty one."""
    a = np.maximum(a, FLAT**2)
    root = b**2 - a * c
    wide = np.sqrt(np.clip(root, 0, None))
    hit = root > 0
    return np.where(hit, (-b - wide) / a, np.inf), np.where(hit, (-b + wide) / a, -np.inf)


def _overhang(axis: Floats, normal: Floats) -> float:
    """Return how far a plane reaches along a rod, in radii."""
    cosine = abs(float(axis @ normal))
    return float(np.sqrt(1 - min(cosine, 1.0) ** 2)) / max(cosine, 0.05)


@dataclass(frozen=True)
class ProjectionScene:
    """Everything in the beam; the rest is air.

    Attributes
    ----------
    layers : tuple of solids
        Tissue; no two overlap.
    inserts : tuple of solids
        What takes the place of tissue or air: bones, plates, holders; no two overlap.
    metal : tuple of solids
        Small and dense: needles, balls, wires, hubs. They take the place of both, no two overlap, and their
        edges are resolved within a cell of the detector.
    """

    layers: tuple[Solid, ...]
    inserts: tuple[Solid, ...] = ()
    metal: tuple[Solid, ...] = ()


@dataclass(frozen=True)
class Gantry:
    """An X-ray tube and its detector.

    Attributes
    ----------
    views : int
        Projections over half a turn.
    cell_mm, aperture_mm : float
        Distance of the detector's cells and the width over which one sees, the focal spot included, both at
        the rotation's axis.
    slice_mm : float
        Thickness of a slice.
    slice_rays : int
        Rays across it, the same everywhere: otherwise a face of the tissue would be a step beside metal. Few
        make a profile that no scanner has: a needle along the slices is seen where one meets it.
    source_mm : float or None
        Distance of the tube from the axis; None: parallel beams.
    tube_kv : float
    photons : float
        That a cell counts in one view if nothing is in the way.
    electronic_sd : float
        Deviation of the electronic noise, in photons.
    scatter : float
        Scattered photons that are left after the scanner's own correction, in parts of the mean signal.
    bowtie_mm : float
        Radius of the water cylinder that the bowtie filter makes up for; inf: no bowtie.
    """

    views: int = 400
    cell_mm: float = 0.35
    aperture_mm: float = 0.5
    slice_mm: float = 0.6
    slice_rays: int = 3
    source_mm: float | None = None
    tube_kv: float = 120.0
    photons: float = 4e5
    electronic_sd: float = 8.0
    scatter: float = 0.01
    bowtie_mm: float = 160.0


@dataclass(frozen=True)
class PlacedSolid:
    """A solid and its place along the axes of the gantry, mm: a ball around it, lowest and highest z."""

    solid: Solid
    center: Floats
    radius: float
    low: float
    high: float

    def distance(self, cos: Reals, sin: Reals, t: Reals) -> Reals:
        """Return how far rays pass from its middle, within the slice, mm."""
        away: Reals = np.abs(self.center[0] * cos + self.center[1] * sin - t)
        return away


def _place_solid(solid: Solid, axis: Frame) -> PlacedSolid:
    corners = (solid.bounds() - axis.origin) @ axis.rotation
    center = corners.mean(axis=0)
    radius = float(np.linalg.norm(corners - center, axis=1).max())
    return PlacedSolid(solid, center, radius, float(corners[:, 2].min()), float(corners[:, 2].max()))


MIN_COUNT = 0.5
"""Fewer photons count as so many: the logarithm needs some."""

SCATTER_WIDTH_MM = 30.0
"""Deviation of the Gaussian that spreads scattered photons over the detector, mm."""

CELL_RAYS = 4
"""Rays across a cell where metal is in the way, elsewhere one."""

MAX_WATER_MM = 1200.0
"""Range of the table that corrects the hardening of the beam in water, mm."""


@dataclass(frozen=True)
class Detector:
    """Cells `t` (T,), mm, and `angles` (V,), rad, of parallel rays."""

    t: Floats
    angles: Floats


def place_detector(scene: ProjectionScene, gantry: Gantry, axis: Frame) -> Detector:
    """Return a detector that sees all of `scene` in every view of parallel beams."""
    points = np.concatenate([solid.bounds() for solid in (*scene.layers, *scene.inserts, *scene.metal)])
    reach = float(np.hypot(*((points - axis.origin) @ axis.rotation)[:, :2].T).max()) + 3.0
    half = int(np.ceil(reach / gantry.cell_mm))
    # a quarter of a cell off the axis, as scanners have it
    t = (np.arange(-half, half, dtype=np.float64) + 0.25) * gantry.cell_mm
    angles = np.arange(gantry.views) * np.pi / gantry.views
    return Detector(t, angles)


def measure_slices(
    scene: ProjectionScene, gantry: Gantry, axis: Frame, heights: Floats, rng: np.random.Generator
) -> Iterator[Floats]:
    """Yield for each slice the water (V, T), mm, that its rays seem to have passed.

    Parameters
    ----------
    axis : Frame
        The rotation's axis is its z.
    heights : (S,) array
        Middles of the slices along the axis, mm.
    """
    detector = place_detector(scene, gantry, axis)
    beam = _Beam(gantry, scene, axis)
    for z in heights:
        if gantry.source_mm is None:
            cos, sin = np.cos(detector.angles)[:, None], np.sin(detector.angles)[:, None]
            yield _measure(scene, gantry, beam, Rays(axis, cos, sin, detector.t[None], np.array(z)), rng)
        else:
            yield _measure_fan(scene, gantry, beam, detector, axis, float(z), rng)


class _Beam:
    """The spectrum, how the scene's materials attenuate it, and where the metal is."""

    def __init__(self, gantry: Gantry, scene: ProjectionScene, axis: Frame) -> None:
        self.metal = [_place_solid(solid, axis) for solid in scene.metal]
        spectrum = tungsten_spectrum(gantry.tube_kv)
        self.weights = spectrum.weights
        self.materials: list[Material] = [WATER]
        for solid in (*scene.layers, *scene.inserts, *scene.metal):
            if solid.material not in self.materials:
                self.materials.append(solid.material)
        self.attenuation = np.array([attenuation(m, spectrum.energies_kev) for m in self.materials])
        self.water_mm = np.arange(0.0, MAX_WATER_MM, 0.5)
        self.water_log = -np.log(np.exp(-np.outer(self.water_mm, self.attenuation[0])) @ self.weights)

    def transmit(self, lengths: Reals) -> Reals:
        """Return the part of the signal (...,) left behind `lengths` (..., M), mm, of the materials."""
        kind = lengths.dtype
        powers = lengths @ -self.attenuation.astype(kind)
        passed: Reals = np.exp(powers, out=powers) @ self.weights.astype(kind)
        return passed

    def water_for(self, logs: Floats) -> Floats:
        """Return the water, mm, that leaves exp(-`logs`) of the signal."""
        water: Floats = np.interp(logs, self.water_log, self.water_mm)
        return water


def _bowtie_water(t: Reals, gantry: Gantry) -> Reals:
    if not np.isfinite(gantry.bowtie_mm):
        return np.zeros_like(t)
    water: Reals = 2 * (gantry.bowtie_mm - np.sqrt(np.clip(gantry.bowtie_mm**2 - t**2, 0, None)))
    return water


def _measure(
    scene: ProjectionScene, gantry: Gantry, beam: _Beam, rays: Rays, rng: np.random.Generator
) -> Floats:
    """Return the water (V, T), mm, that rays seem to have passed."""
    bowtie = _bowtie_water(rays.t, gantry)
    signal = _transmit_scene(scene, gantry, beam, rays, bowtie)
    signal += gantry.scatter * signal @ _spread_scatter(rays.t)
    counts = rng.poisson(gantry.photons * signal) + gantry.electronic_sd * rng.standard_normal(signal.shape)
    logs = -np.log(np.maximum(counts, MIN_COUNT) / (gantry.photons * (1 + gantry.scatter)))
    return beam.water_for(logs) - bowtie


def _spread_scatter(t: Reals) -> Reals:
    """Return the matrix (T, T) by which scattered photons spread over the cells `t` (1, T)."""
    spread = np.exp(-0.5 * ((t.T - t) / SCATTER_WIDTH_MM) ** 2)
    matrix: Reals = spread / spread.sum(axis=0)
    return matrix


def _measure_fan(
    scene: ProjectionScene,
    gantry: Gantry,
    beam: _Beam,
    detector: Detector,
    axis: Frame,
    z: float,
    rng: np.random.Generator,
) -> Floats:
    """Return what a fan beam measures over a whole turn, sorted into parallel rays (V, T)."""
    source = float(gantry.source_mm or np.inf)
    step = gantry.cell_mm / source
    half = int(np.ceil(np.arcsin(np.abs(detector.t).max() / source) / step)) + 2
    fan = (np.arange(-half, half) + 0.25) * step
    turns = 2 * gantry.views
    tube = np.arange(turns) * 2 * np.pi / turns
    angle, t = tube[:, None] + fan[None], source * np.sin(fan)[None]
    water = _measure(scene, gantry, beam, Rays(axis, np.cos(angle), np.sin(angle), t, np.array(z)), rng)
    # every parallel ray is measured twice, from either end
    total = np.zeros((len(detector.angles), len(detector.t)))
    for sign, turn in ((1.0, 0.0), (-1.0, np.pi)):
        at = np.arcsin(sign * detector.t / source)[None]
        rows = (detector.angles[:, None] + turn - at) / (2 * np.pi / turns)
        columns = np.broadcast_to(at / step - 0.25 + half, rows.shape)
        wrapped = np.vstack([water, water[:1]])
        total += map_coordinates(wrapped, [rows % turns, columns], order=1, mode="nearest") / 2
    return total


def _transmit_scene(scene: ProjectionScene, gantry: Gantry, beam: _Beam, rays: Rays, bowtie: Reals) -> Reals:
    """Return the signal (V, T) behind the scene; means within cell and slice are means of the signal."""
    shape = np.broadcast_shapes(rays.cos.shape, rays.t.shape)
    heights = rays.z + _offsets(gantry.slice_rays, gantry.slice_mm)
    metal = [one for one in beam.metal if one.low <= heights.max() and one.high >= heights.min()]
    touched = np.zeros(shape, dtype=bool)
    for one in metal:
        touched |= one.distance(rays.cos, rays.sin, rays.t) <= one.radius + gantry.aperture_mm
    signal = np.zeros(shape)
    cos, sin, t, water = (array.astype(np.float32) for array in (rays.cos, rays.sin, rays.t, bowtie))
    for z in heights.tolist():
        plane = Rays(rays.frame, cos, sin, t, np.array(z, dtype=np.float32))
        signal += _transmit_rays(scene, (), beam, plane, water) / gantry.slice_rays
    if touched.any():
        cos, sin, t, water = (
            np.broadcast_to(array, shape)[touched][:, None] for array in (rays.cos, rays.sin, rays.t, bowtie)
        )
        places = t + np.tile(_offsets(CELL_RAYS, gantry.aperture_mm), gantry.slice_rays)
        inside = Rays(rays.frame, cos, sin, places, np.repeat(heights, CELL_RAYS))
        signal[touched] = _transmit_rays(scene, tuple(metal), beam, inside, water).mean(axis=1)
    return signal


def _transmit_rays(
    scene: ProjectionScene, metal: tuple[PlacedSolid, ...], beam: _Beam, rays: Rays, bowtie: Reals
) -> Reals:
    """Return the signal behind layers, inserts and `metal`; what lies inside something displaces it."""
    shape = np.broadcast_shapes(rays.cos.shape, rays.t.shape, rays.z.shape)
    lengths = np.zeros((*shape, len(beam.materials)), dtype=rays.t.dtype)
    lengths[..., 0] = bowtie
    layers, inserts = ([(s, s.interval(rays)) for s in part] for part in (scene.layers, scene.inserts))
    for solid, interval in (*layers, *inserts):
        lengths[..., beam.materials.index(solid.material)] += interval_length([interval])
    for _, interval in inserts:
        _displace(lengths, layers, (interval,), beam, -1.0)
    for placed in metal:
        solid = placed.solid
        away = placed.distance(rays.cos[:, 0], rays.sin[:, 0], rays.t.mean(axis=1))
        near = away <= placed.radius + np.ptp(rays.t[0])
        if not near.any():
            continue
        some = Rays(rays.frame, rays.cos[near], rays.sin[near], rays.t[near], rays.z)
        part = lengths[near]
        own = solid.interval(some)
        column = beam.materials.index(solid.material)
        part[..., column] += interval_length([own])
        if isinstance(solid, Rod) and solid.bore > 0:
            part[..., column] -= interval_length([solid.bore_interval(some)])
        here = [(s, s.interval(some)) for s in (*scene.layers, *scene.inserts)]
        _displace(part, here, (own,), beam, -1.0)
        count = len(scene.layers)
        for _, interval in here[count:]:  # what was taken from a layer twice
            _displace(part, here[:count], (own, interval), beam, 1.0)
        lengths[near] = part
    return beam.transmit(lengths)


def _displace(
    lengths: Reals, solids: list[tuple[Solid, Interval]], by: tuple[Interval, ...], beam: _Beam, sign: float
) -> None:
    """Add to `lengths`, times `sign`, how much of each solid lies in all intervals `by`."""
    for solid, interval in solids:
        lengths[..., beam.materials.index(solid.material)] += sign * interval_length([interval, *by])


def _offsets(count: int, width: float) -> Floats:
    offsets: Floats = ((np.arange(count) + 0.5) / count - 0.5) * width
    return offsets


@dataclass(frozen=True)
class Kernel:
    """A reconstruction kernel: the window (1 + `boost` x^2) exp(-x^2) on the ramp, x = f / `cutoff` (1/mm).

    A boost above 1 lifts middle frequencies above 1, which makes edges over- and undershoot.
    """

    cutoff: float
    boost: float = 0.0


KERNELS = MappingProxyType(
    {
        "soft": Kernel(0.45),
        "standard": Kernel(0.65),
        "bone": Kernel(0.70, 1.8),
        "edge": Kernel(0.75, 3.5),
    }
)

CLIPPED_HU, EXTENDED_HU = 3071.0, 30710.0
"""Largest number of 12 bits, and of a scanner's extended scale, HU."""

FLOOR_HU = -1024.0

RAYS_PER_CELL = 4
"""Filtered projections are sampled so finely that the nearest sample is near enough."""

BATCH_SLICES, BATCH_PIXELS = 32, 2**15
"""Slices and pixels that are projected back at once: what this holds must stay small."""


def render_volume(
    scene: ProjectionScene,
    gantry: Gantry,
    grid: VoxelGrid,
    kernel: Kernel,
    ceiling_hu: float,
    rng: np.random.Generator,
    isocenter: Floats | None = None,
) -> Volume:
    """Render `grid` out of a scene; equal generators give equal bytes.

    Parameters
    ----------
    isocenter : (3,) array, optional
        A point of the rotation's axis, which runs along the grid's slices; default: the grid's middle.
    """
    middle = grid.origin + grid.direction @ ((np.array(grid.size) - 1) / 2 * grid.spacing)
    axis = Frame(middle if isocenter is None else isocenter, grid.direction)
    start = axis.to_local(grid.origin[None])[0]
    heights = start[2] + np.arange(grid.size[2]) * grid.spacing[2]
    detector = place_detector(scene, gantry, axis)
    values = np.empty(grid.size[::-1], dtype=np.float32)
    waiting: list[NDArray[np.float32]] = []
    done = 0
    for water in measure_slices(scene, gantry, axis, heights, rng):
        waiting.append(filter_projections(water, gantry.cell_mm, kernel).astype(np.float32))
        if len(waiting) == BATCH_SLICES or done + len(waiting) == len(heights):
            values[done : done + len(waiting)] = back_project(
                np.array(waiting), detector, gantry, grid, start
            )
            done, waiting = done + len(waiting), []
    values = 1000 * (values - 1)
    np.clip(np.rint(values, out=values), FLOOR_HU, ceiling_hu, out=values)
    return Volume(values, grid.origin, grid.spacing, grid.direction)


def filter_projections(projections: Floats, cell_mm: float, kernel: Kernel) -> Floats:
    """Return projections (V, T) after ramp and kernel, `RAYS_PER_CELL` samples a cell: (V, 4 T)."""
    count = projections.shape[1]
    length = next_fast_len(2 * count, real=True)
    frequency = rfftfreq(length, cell_mm)
    # the ramp as sampled in space: a ramp sampled in frequency shifts the mean
    n = np.concatenate([np.arange(length // 2 + 1), np.arange(length // 2 + 1 - length, 0)])
    ramp = np.where(n % 2, -1 / (np.pi * np.where(n == 0, 1, n) * cell_mm) ** 2, 0.0)
    ramp[0] = 1 / (2 * cell_mm) ** 2
    x2 = (frequency / kernel.cutoff) ** 2
    window = rfft(ramp).real * cell_mm * (1 + kernel.boost * x2) * np.exp(-x2)
    fine = irfft(rfft(projections, length) * window, RAYS_PER_CELL * length) * RAYS_PER_CELL
    filtered: Floats = fine[:, : RAYS_PER_CELL * count]
    return filtered


def back_project(
    rays: NDArray[np.float32], detector: Detector, gantry: Gantry, grid: VoxelGrid, start: Floats
) -> NDArray[np.float32]:
    """Return the slices (S, J, I) of filtered projections (S, V, 4 T); water is 1.

    Parameters
    ----------
    start : (3,) array
        The grid's first voxel from the rotation's axis, along the grid's axes, mm.
    """
    flat = np.ascontiguousarray(rays.reshape(len(rays), -1).T)
    x = start[0] + np.arange(grid.size[0]) * grid.spacing[0]
    y = start[1] + np.arange(grid.size[1]) * grid.spacing[1]
    width = gantry.cell_mm / RAYS_PER_CELL
    # where a beam of as many rays has its middle
    middle = detector.t[0] + width * (rays.shape[2] - 1) / 2
    planes = np.empty((len(rays), len(y), len(x)), dtype=np.float32)
    rows = max(1, BATCH_PIXELS // len(x))
    beam = ParallelBeam(detector.angles, rays.shape[2], width, np.zeros(2))
    for first in range(0, len(y), rows):
        part = slice(first, first + rows)
        back = make_back_projector(x, y[part], beam, middle)
        planes[:, part] = (back @ flat).T.reshape(len(rays), -1, len(x))
    return planes
