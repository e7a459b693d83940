"""Render a scene as a CT volume: tissue, table, metal, blur and noise."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import Volume, VoxelGrid
from needlefit.synthetic.ct_scene import Scanner, ScannerTable, Scene3D
from needlefit.synthetic.metal import MetalVoxels, voxelize_balls, voxelize_needle
from needlefit.synthetic.phantoms import BOX_MM
from needlefit.synthetic.streaks import render_streaks

PixelArray = NDArray[np.floating]

AIR_HU = -1000.0
RAIL_WIDTH_MM = 8.0
"""Width of the table's rails, mm."""


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
    part: PixelArray = np.clip(distance / np.float32(width) + np.float32(0.5), 0, 1)
    return part


Voxels = NDArray[np.float32]


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
    values += _draw_noise(scanner, rng)
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


def _draw_noise(scanner: Scanner, rng: np.random.Generator) -> Voxels:
    """Return noise of the scanner's deviation, a little correlated: (K, J, I), HU."""
    sigma = scanner.noise_mm / scanner.grid.spacing[::-1]
    white = rng.standard_normal(scanner.grid.size[::-1], dtype=np.float32)
    smooth: Voxels = gaussian_filter(white, sigma, mode="wrap")
    smooth *= np.float32(scanner.noise_hu / max(float(smooth.std()), 1e-9))
    return smooth
