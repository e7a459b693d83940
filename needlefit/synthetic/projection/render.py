"""Render a CT volume: projections of a scene, filtered and projected back slice by slice, in HU."""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import Volume, VoxelGrid
from needlefit.synthetic.projection.acquisition import (
    Detector,
    Gantry,
    ProjectionScene,
    measure_slices,
    place_detector,
)
from needlefit.synthetic.streaks import ParallelBeam, make_back_projector


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
