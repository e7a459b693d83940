"""Measure the projections of a scene: photons of a spectrum behind its materials, scatter, noise, dose."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.synthetic.projection.materials import WATER, Material, attenuation, tungsten_spectrum
from needlefit.synthetic.projection.solids import Interval, Rays, Reals, Rod, Solid, interval_length


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

CELL_RAYS, SLICE_RAYS = 4, 3
"""Rays across a cell where metal is in the way, elsewhere one; and across a slice. Those across a slice are
the same everywhere: otherwise a face of the tissue would be a step beside the metal."""

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
    heights = rays.z + _offsets(SLICE_RAYS, gantry.slice_mm)
    metal = [one for one in beam.metal if one.low <= heights.max() and one.high >= heights.min()]
    touched = np.zeros(shape, dtype=bool)
    for one in metal:
        touched |= one.distance(rays.cos, rays.sin, rays.t) <= one.radius + gantry.aperture_mm
    signal = np.zeros(shape)
    cos, sin, t, water = (array.astype(np.float32) for array in (rays.cos, rays.sin, rays.t, bowtie))
    for z in heights.tolist():
        plane = Rays(rays.frame, cos, sin, t, np.array(z, dtype=np.float32))
        signal += _transmit_rays(scene, (), beam, plane, water) / SLICE_RAYS
    if touched.any():
        cos, sin, t, water = (
            np.broadcast_to(array, shape)[touched][:, None] for array in (rays.cos, rays.sin, rays.t, bowtie)
        )
        places = t + np.tile(_offsets(CELL_RAYS, gantry.aperture_mm), SLICE_RAYS)
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
