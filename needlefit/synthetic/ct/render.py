"""A scene as the scanner shows it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from needlefit.imaging.volume import Volume
from needlefit.synthetic.ct.metal import Metal, ball_metal, needle_metal
from needlefit.synthetic.ct.scene import Scanner, Scene3D
from needlefit.synthetic.ct.streaks import streaks
from needlefit.synthetic.ct.tissue import tissue_slice
from needlefit.synthetic.phantoms import BOX

Voxels = NDArray[np.float32]


def render(scene: Scene3D, scanner: Scanner, rng: np.random.Generator) -> Volume:
    """Return the scan of `scene`; equal generators give equal bytes.

    Partial volume, then point spread (for the metal with a wider part: bloom), then the rays from metal,
    the cupping of a hardened beam, noise; rounded to whole HU within the scanner's range.
    """
    grid = scanner.grid
    values, cup = _tissue(scene, scanner)
    metals = [needle_metal(needle, grid) for needle in scene.needles]
    if scene.markers is not None:
        metals.append(ball_metal(scene.markers, grid))
    metals = [metal for metal in metals if len(metal.voxels)]
    values = _blurred(values, metals, scanner)
    values -= cup
    if metals and scanner.streaks > 0:
        values += np.float32(scanner.streaks) * streaks(metals, grid, scanner.views, rng)
    values += _noise(scanner, rng)
    np.clip(np.rint(values, out=values), scanner.floor_hu, scanner.ceiling_hu, out=values)
    return Volume(values, grid.origin, grid.spacing, grid.direction)


def _tissue(scene: Scene3D, scanner: Scanner) -> tuple[Voxels, Voxels]:
    """Return the scan without metal, unblurred, and how much too dark each voxel is; both (K, J, I), HU.

    The hardened beam reads a box too dark by a parabola of the distance from the middle, in the slice.
    """
    grid = scanner.grid
    values = np.empty(grid.size[::-1], dtype=np.float32)
    cup = np.empty_like(values)
    middle = scene.box.to_world([[BOX / 2, 0, 0]])[0]
    center = (middle - grid.origin) @ grid.direction
    x = np.arange(grid.size[0]) * grid.spacing[0] - center[0]
    y = np.arange(grid.size[1]) * grid.spacing[1] - center[1]
    r2 = (x[None, :] ** 2 + y[:, None] ** 2) / (BOX / 2) ** 2
    bowl = (scanner.cupping_hu * np.clip(1 - r2 / 2, 0, 1)).astype(np.float32)
    for k in range(grid.size[2]):
        values[k], inside = tissue_slice(scene, grid, k)
        cup[k] = bowl * inside
    return values, cup


def _blurred(values: Voxels, metals: Sequence[Metal], scanner: Scanner) -> Voxels:
    """Return the scan with metal, as the point spread shows it."""
    metal = np.zeros_like(values)
    for one in metals:
        i, j, k = one.voxels.T
        extra = (one.hu - values[k, j, i]) * one.part
        metal[k, j, i] = np.maximum(metal[k, j, i], extra.astype(np.float32))
    narrow, wide = (s / scanner.grid.spacing[::-1] for s in (scanner.psf_mm, scanner.bloom_mm))
    values += np.float32(1 - scanner.bloom) * metal
    blurred: Voxels = gaussian_filter(values, narrow, output=np.float32)
    if scanner.bloom > 0:
        blurred += np.float32(scanner.bloom) * gaussian_filter(metal, wide, output=np.float32)
    return blurred


def _noise(scanner: Scanner, rng: np.random.Generator) -> Voxels:
    """Return noise of the scanner's deviation, a little correlated: (K, J, I), HU."""
    sigma = scanner.noise_mm / scanner.grid.spacing[::-1]
    white = rng.standard_normal(scanner.grid.size[::-1], dtype=np.float32)
    smooth: Voxels = gaussian_filter(white, sigma, mode="wrap")
    smooth *= np.float32(scanner.noise_hu / max(float(smooth.std()), 1e-9))
    return smooth
