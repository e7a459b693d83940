"""Render needles, balls and soft tissue as CT values: voxels of metal, and its streaks."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from synthetic.design import BOX_MM, Phantom

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import Frame, normalize
from needlefit.imaging.volume import Volume, VoxelGrid

WATER_PER_MM = 0.02  # attenuation of water at the energies of a cone-beam scanner, 1/mm


@dataclass(frozen=True)
class Needle3D:
    """The steel needle in the scanner."""

    points: Floats  # (N, 3); the shaft's axis from base to tip, patient (LPS), mm
    diameter: float = 1.27  # mm
    bevel_deg: float = 30.0  # angle between the bevel's face and the axis; 90 is a blunt end
    # (3,); the direction across the axis in which the bevel's point lies.
    bevel_toward: Floats = field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))
    hu: float = 9000.0  # what the metal would read without a ceiling


@dataclass(frozen=True)
class SceneMarkers:
    """Radiopaque balls: `centers` (M, 3) patient, `radius` mm, and their `hu` without a ceiling."""

    centers: Floats
    radius: float = 1.5
    hu: float = 5000.0


@dataclass(frozen=True)
class ScannerTable:
    """The table: a slab under the phantom, and the rails along its edges."""

    frame: Frame  # origin on the slab's upper face; x along the table, y across it, z up
    # `width`, `thickness`: mm
    width: float = 300.0
    thickness: float = 8.0
    # `hu`, `rail_hu`: of the slab and of its two rails, 8 mm wide
    hu: float = -100.0
    rail_hu: float = 2800.0


@dataclass(frozen=True)
class Scene3D:
    """Everything that lies in the scanner."""

    needles: tuple[Needle3D, ...]  # one, in a proper scan
    phantom: Phantom  # the box of layers
    layers_hu: tuple[float, ...]  # one a layer, from the entry inwards
    box: Frame  # the phantom's world in the patient: origin at the middle of the entry face, x into the box
    markers: SceneMarkers | None = None
    table: ScannerTable | None = None


@dataclass(frozen=True)
class Scanner:
    """The scanner: grid, blur, noise, artefacts and range; slices of the grid are planes of its rotation."""

    grid: VoxelGrid
    psf_mm: float = 0.4  # standard deviation of the point spread
    # `noise_hu`, `noise_mm`: standard deviation of the noise, and of the Gaussian that correlates it
    noise_hu: float = 40.0
    noise_mm: float = 0.25
    # `bloom`, `bloom_mm`: part of the metal's signal that is spread wider, and how wide (standard deviation)
    bloom: float = 0.12
    bloom_mm: float = 1.0
    streaks: float = 1.0  # strength of the rays from metal; 0 is none, 1 that of a scanner with no correction
    cupping_hu: float = 60.0  # how much too dark the middle of the phantom is
    # `floor_hu`, `ceiling_hu`: range of the stored numbers
    floor_hu: float = -1024.0
    ceiling_hu: float = 3071.0
    views: int = 180  # projections over half a turn


SUBVOXELS_PER_EDGE = 5  # points per voxel edge
AXIS_SPACING_MM = 0.05  # spacing of the axis' points among which the nearest is searched, mm


@dataclass(frozen=True)
class MetalVoxels:
    """Voxels (N, 3) (i, j, k) with metal, the metal fraction `part` (N,) of each, and its `hu`."""

    voxels: NDArray[np.int64]
    part: Floats
    hu: float


def voxelize_needle(needle: Needle3D, grid: VoxelGrid) -> MetalVoxels:
    """Return the metal voxels of a bevelled needle.

    Within half a voxel of the axis' nearest point the needle is straight: over 0.5 mm an axis of radius
    200 mm strays by less than a micrometre.
    """
    axis = densify(needle.points)
    reach = needle.diameter / 2 + float(np.linalg.norm(grid.spacing)) / 2
    voxels = _voxels_near(axis, reach, grid)
    centers = (voxels * grid.spacing) @ grid.direction.T + grid.origin
    _, nearest = cKDTree(axis).query(centers)
    tangents = np.gradient(axis, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    along, side = arc_length(axis), bevel_side(needle)
    part = np.zeros(len(voxels))
    for offset in _subvoxel_offsets(grid):
        d = centers + offset - axis[nearest]  # (N, 3)
        a = np.einsum("ni,ni->n", d, tangents[nearest])
        across = d - a[:, None] * tangents[nearest]
        # how far the bevel's plane lies behind the point, at this position across the axis
        cut = (needle.diameter / 2 - across @ side) / np.tan(np.deg2rad(needle.bevel_deg))
        s = along[nearest] + a
        inside = _inside_fraction(needle.diameter / 2 - np.sqrt(np.einsum("ni,ni->n", across, across)), grid)
        part += inside * _inside_fraction(s, grid) * _inside_fraction(along[-1] - cut - s, grid)
    return _nonzero_voxels(voxels, part, needle.hu)


def voxelize_balls(markers: SceneMarkers, grid: VoxelGrid) -> MetalVoxels:
    reach = markers.radius + float(np.linalg.norm(grid.spacing)) / 2
    voxels = _voxels_near(markers.centers, reach, grid)
    centers = (voxels * grid.spacing) @ grid.direction.T + grid.origin
    tree = cKDTree(markers.centers)
    part = np.zeros(len(voxels))
    for offset in _subvoxel_offsets(grid):
        part += _inside_fraction(np.asarray(markers.radius - tree.query(centers + offset)[0]), grid)
    return _nonzero_voxels(voxels, part, markers.hu)


def densify(points: Floats) -> Floats:
    """Return the cubic spline through `points` (N, 3), sampled every `AXIS_SPACING_MM` mm: (M, 3)."""
    s = arc_length(points)
    spline = make_interp_spline(s, points, k=min(3, len(points) - 1))
    return spline(np.linspace(0, s[-1], int(np.ceil(s[-1] / AXIS_SPACING_MM)) + 1))


def bevel_side(needle: Needle3D) -> Floats:
    """Return the unit vector (3,) across the axis at the tip, toward the point of the bevel."""
    end = densify(needle.points)[-3:]
    tangent = normalize(end[-1] - end[0])
    return normalize(needle.bevel_toward - (needle.bevel_toward @ tangent) * tangent, "the bevel's side")


def _nonzero_voxels(voxels: NDArray[np.int64], part: Floats, hu: float) -> MetalVoxels:
    """Return the voxels whose sub-points sum up to a `part` that is not nothing."""
    return MetalVoxels(voxels[part > 0], part[part > 0] / SUBVOXELS_PER_EDGE**3, hu)


def _inside_fraction(depth: Floats, grid: VoxelGrid) -> Floats:
    """Return the part of a sub-voxel whose centre lies `depth` (mm) inside: no face snaps to the lattice."""
    return np.clip(depth / (np.mean(grid.spacing) / SUBVOXELS_PER_EDGE) + 0.5, 0, 1)


def _subvoxel_offsets(grid: VoxelGrid) -> Floats:
    """Return the places of a voxel's sub-points relative to its centre (n, 3), mm, patient."""
    steps = (np.arange(SUBVOXELS_PER_EDGE) + 0.5) / SUBVOXELS_PER_EDGE - 0.5
    mesh = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return (mesh * grid.spacing) @ grid.direction.T


def _voxels_near(points: Floats, reach: float, grid: VoxelGrid) -> NDArray[np.int64]:
    """Return the voxels (N, 3) inside the grid whose centres may lie within `reach` of `points` (M, 3)."""
    seeds = np.unique(
        np.rint((points - grid.origin) @ grid.direction / grid.spacing).astype(np.int64), axis=0
    )
    margin = np.ceil(reach / grid.spacing).astype(int) + 1
    block = np.stack(np.meshgrid(*[np.arange(-m, m + 1) for m in margin], indexing="ij"), axis=-1)
    ball = np.linalg.norm(block * grid.spacing, axis=-1) <= reach + np.linalg.norm(grid.spacing) / 2
    voxels = (seeds[:, None] + block[ball]).reshape(-1, 3)
    inside = voxels[np.all((voxels >= 0) & (voxels < grid.size), axis=1)]
    flat = np.unique(np.ravel_multi_index(tuple(inside.T), grid.size))
    return np.column_stack(np.unravel_index(flat, grid.size))


Voxels = NDArray[np.float32]

HARDENING_COEFFICIENT = 0.06  # h: a ray through 8 attenuation lengths of metal measures 5.4
VIEW_GAIN_SD = 0.15  # deviation of a view's weight of metal
VIEW_GAIN_LENGTH = 3.0  # views over which it lasts: deviation of a Gaussian
PHOTONS_PER_RAY = 1e4  # photons per ray that reach the detector if no metal is in the way
MAX_LINE_INTEGRAL = 8.0  # line integral at which scattered photons hide what is behind
BATCH_SLICES = 32  # slices that are worked on at once: what their rays hold must stay small


@dataclass(frozen=True)
class ParallelBeam:
    """Parallel rays of all views: `angles` (V,) rad, `bins` per view of `width` mm, `center` (2,) mm."""

    angles: Floats
    bins: int
    width: float
    center: Floats


def render_streaks(
    metals: Sequence[MetalVoxels], grid: VoxelGrid, views: int, rng: np.random.Generator
) -> Voxels:
    """Return the artefact of metal in every slice (K, J, I), HU."""
    extent = np.array(grid.size[:2]) * grid.spacing[:2]
    width = float(grid.spacing[:2].min()) / 1.5
    bins = int(np.ceil(np.hypot(*extent) / width)) + 4
    fan = ParallelBeam(np.arange(views) * np.pi / views, bins, width, (extent - grid.spacing[:2]) / 2)
    error = np.zeros(grid.size[::-1], dtype=np.float32)
    held = np.unique(np.concatenate([metal.voxels[:, 2] for metal in metals]))
    if not len(held):
        return error
    smooth = gaussian_filter1d(rng.normal(size=views), VIEW_GAIN_LENGTH, mode="wrap")
    gains: Floats = VIEW_GAIN_SD * smooth / smooth.std()
    x, y = ((np.arange(n) * d - c) for n, d, c in zip(grid.size, grid.spacing, fan.center, strict=False))
    back = make_back_projector(x, y, fan)
    for first in range(0, len(held), BATCH_SLICES):
        slices = held[first : first + BATCH_SLICES]
        lines = _project(metals, slices, grid, fan)
        touched = np.nonzero(lines)
        p = np.minimum(lines[touched], np.float32(MAX_LINE_INTEGRAL))
        hardened = p / (1 + HARDENING_COEFFICIENT * p) - p
        noise = rng.standard_normal(len(p), dtype=np.float32) * np.sqrt(np.expm1(p) / PHOTONS_PER_RAY)
        wrong = np.zeros_like(lines)
        wrong[touched] = hardened + p * gains[touched[1]] + noise
        # padded to twice the length against the FFT's wrap-around
        length = next_fast_len(2 * fan.bins, real=True)
        frequency = rfftfreq(length, fan.width)
        ramp = (frequency * (0.5 + 0.5 * np.cos(np.pi * frequency / frequency[-1]))).astype(np.float32)
        filtered: Voxels = irfft(rfft(wrong, length) * ramp, length)[..., : fan.bins]
        rays = filtered.reshape(len(slices), -1)
        planes = back @ np.ascontiguousarray(rays.T)  # (J * I, slices)
        error[slices] = planes.T.reshape(-1, *error.shape[1:])
    error *= np.float32(1000 / WATER_PER_MM)
    return error


def _project(
    metals: Sequence[MetalVoxels], slices: NDArray[np.int64], grid: VoxelGrid, fan: ParallelBeam
) -> Voxels:
    """Return the line integrals (S, V, bins) of metal in `slices` (S,), which are sorted."""
    voxels = np.concatenate([metal.voxels for metal in metals])
    weight = np.concatenate([m.part * (1 + m.hu / 1000) * WATER_PER_MM for m in metals])
    here = (voxels[:, 2] >= slices[0]) & (voxels[:, 2] <= slices[-1])
    row = np.searchsorted(slices, voxels[here, 2])
    place = voxels[here, :2] * grid.spacing[:2] - fan.center
    mass = weight[here] * grid.spacing[0] * grid.spacing[1] / fan.width
    total = np.zeros(len(slices) * len(fan.angles) * fan.bins, dtype=np.float32)
    for view, angle in enumerate(fan.angles):
        at = (place @ [np.cos(angle), np.sin(angle)]) / fan.width + (fan.bins - 1) / 2
        low = np.floor(at).astype(np.int64)
        first = (row * len(fan.angles) + view) * fan.bins + low
        # np.add.at, not +=: several voxels fall into the same bin, and += would keep only one of them
        np.add.at(total, first, (mass * (1 - (at - low))).astype(np.float32))
        np.add.at(total, first + 1, (mass * (at - low)).astype(np.float32))
    return total.reshape(len(slices), len(fan.angles), fan.bins)


def make_back_projector(x: Floats, y: Floats, beam: ParallelBeam, middle: float = 0.0) -> csr_array:
    """Return the matrix (J * I, V * bins) that sums over the views what the nearest ray holds.

    `x` (I,) and `y` (J,) are places from the rotation's axis, `middle` that of the middle of the rays, mm.
    """
    pixels = len(x) * len(y)
    columns = np.empty((pixels, len(beam.angles)), dtype=np.int32)
    for view, angle in enumerate(beam.angles):
        at = np.cos(angle) * x[None, :] + np.sin(angle) * y[:, None] - middle
        columns[:, view] = np.rint(at / beam.width + (beam.bins - 1) / 2).ravel() + view * beam.bins
    data = np.full(columns.size, np.pi / len(beam.angles), dtype=np.float32)
    starts = np.arange(0, columns.size + 1, len(beam.angles))
    return csr_array((data, columns.ravel(), starts), shape=(pixels, len(beam.angles) * beam.bins))


PixelArray = NDArray[np.floating]

AIR_HU = -1000.0
RAIL_WIDTH_MM = 8.0  # width of the table's rails, mm


def render_tissue_slice(scene: Scene3D, grid: VoxelGrid, k: int) -> tuple[PixelArray, PixelArray]:
    """Return slice `k` without metal (J, I), HU, and the fraction of each voxel in the box (J, I)."""
    x, y, z = _local_coordinates(scene.box, grid, k)
    width = float(np.mean(grid.spacing))
    half = BOX_MM / 2
    inside = (
        _face_fraction(x, width)
        * _face_fraction(BOX_MM - x, width)
        * _face_fraction(half - np.abs(y), width)
        * _face_fraction(half - np.abs(z), width)
    )
    hu = np.full_like(x, scene.layers_hu[0])
    for boundary, before, after in zip(
        scene.phantom.interfaces, scene.layers_hu[:-1], scene.layers_hu[1:], strict=False
    ):
        hu += (after - before) * _face_fraction(x - boundary, width)
    solid = scene.phantom.cylinder
    if solid is not None:
        radius = np.hypot(x - solid.top - solid.radius, z)
        within = _face_fraction(solid.radius - radius, width) * _face_fraction(
            solid.length / 2 - np.abs(y), width
        )
        hu += (scene.layers_hu[-1] - hu) * within
    values: PixelArray = AIR_HU + (hu - AIR_HU) * inside
    if scene.table is not None:
        values = _add_table(values, scene.table, grid, k)
    return values.astype(np.float32), inside.astype(np.float32)


def _add_table(values: PixelArray, table: ScannerTable, grid: VoxelGrid, k: int) -> PixelArray:
    """Return the slice with the table in it."""
    _, y, z = _local_coordinates(table.frame, grid, k)
    width = float(np.mean(grid.spacing))
    slab = (
        _face_fraction(-z, width)
        * _face_fraction(z + table.thickness, width)
        * _face_fraction(table.width / 2 - np.abs(y), width)
    )
    rails = slab * _face_fraction(np.abs(y) - table.width / 2 + RAIL_WIDTH_MM, width)
    values = values + (table.hu - values) * slab
    return values + (table.rail_hu - values) * rails


def _local_coordinates(frame: Frame, grid: VoxelGrid, k: int) -> tuple[PixelArray, PixelArray, PixelArray]:
    """Return the coordinates of slice `k`'s voxels in `frame`, each (J, I), mm."""
    # columns of direction are the axes i, j, k
    steps = (grid.direction * grid.spacing).T @ frame.rotation  # rows: one step of i, j, k in the frame
    start = (grid.origin - frame.origin) @ frame.rotation + k * steps[2]
    i, j = np.arange(grid.size[0]), np.arange(grid.size[1])
    x, y, z = (
        (start[a] + steps[0, a] * i[None, :] + steps[1, a] * j[:, None]).astype(np.float32) for a in range(3)
    )
    return x, y, z


def _face_fraction(distance: PixelArray, width: float) -> PixelArray:
    """Return the part of a voxel of `width` (mm) on the positive side of a face at `distance` (mm)."""
    return np.clip(distance / np.float32(width) + np.float32(0.5), 0, 1)


def render_scan(scene: Scene3D, scanner: Scanner, rng: np.random.Generator) -> Volume:
    """Render the scan of `scene`; equal generators give equal bytes.

    Partial volume, then point spread (for the metal with a wider part: bloom), then the rays from metal,
    the cupping of a hardened beam, noise; rounded to whole HU within the scanner's range.
    """
    grid = scanner.grid
    values, cup = _render_tissue(scene, scanner)
    metals = [voxelize_needle(needle, grid) for needle in scene.needles]
    if scene.markers is not None:
        metals.append(voxelize_balls(scene.markers, grid))
    metals = [metal for metal in metals if len(metal.voxels)]
    values = _blur_with_metal(values, metals, scanner)
    values -= cup
    if metals and scanner.streaks > 0:
        values += np.float32(scanner.streaks) * render_streaks(metals, grid, scanner.views, rng)
    sigma = scanner.noise_mm / scanner.grid.spacing[::-1]
    white = rng.standard_normal(scanner.grid.size[::-1], dtype=np.float32)
    smooth: Voxels = gaussian_filter(white, sigma, mode="wrap")
    smooth *= np.float32(scanner.noise_hu / max(float(smooth.std()), 1e-9))
    values += smooth
    np.clip(np.rint(values, out=values), scanner.floor_hu, scanner.ceiling_hu, out=values)
    return Volume(values, grid.origin, grid.spacing, grid.direction)


def _render_tissue(scene: Scene3D, scanner: Scanner) -> tuple[Voxels, Voxels]:
    """Return the scan without metal, unblurred, and how much too dark each voxel is; both (K, J, I), HU.

    The hardened beam reads a box too dark by a parabola of the distance from the middle, in the slice.
    """
    grid = scanner.grid
    values = np.empty(grid.size[::-1], dtype=np.float32)
    cup = np.empty_like(values)
    middle = scene.box.to_world([[BOX_MM / 2, 0, 0]])[0]
    center = (middle - grid.origin) @ grid.direction
    x = np.arange(grid.size[0]) * grid.spacing[0] - center[0]
    y = np.arange(grid.size[1]) * grid.spacing[1] - center[1]
    r2 = (x[None, :] ** 2 + y[:, None] ** 2) / (BOX_MM / 2) ** 2
    bowl = (scanner.cupping_hu * np.clip(1 - r2 / 2, 0, 1)).astype(np.float32)
    for k in range(grid.size[2]):
        values[k], inside = render_tissue_slice(scene, grid, k)
        cup[k] = bowl * inside
    return values, cup


def _blur_with_metal(values: Voxels, metals: Sequence[MetalVoxels], scanner: Scanner) -> Voxels:
    """Return the scan with metal, as the point spread shows it."""
    metal = np.zeros_like(values)
    for one in metals:
        i, j, k = one.voxels.T
        extra = (one.hu - values[k, j, i]) * one.part
        # needle and ball may share a voxel: the brighter one counts, metal does not add up
        metal[k, j, i] = np.maximum(metal[k, j, i], extra.astype(np.float32))
    narrow, wide = (s / scanner.grid.spacing[::-1] for s in (scanner.psf_mm, scanner.bloom_mm))
    values += np.float32(1 - scanner.bloom) * metal
    blurred: Voxels = gaussian_filter(values, narrow, output=np.float32)
    if scanner.bloom > 0:
        blurred += np.float32(scanner.bloom) * gaussian_filter(metal, wide, output=np.float32)
    return blurred
