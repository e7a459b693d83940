"""Compute metal artefacts: the errors of the projections, filtered and projected back, slice by slice.

A ray through metal of line integral p measures p / (1 + h p), as the beam hardens, with the noise of the
few photons that are left, and every view has a gain error (scatter, lag, jitter of the gantry),
correlated between neighbours. The error of the projection, not the projection, goes through filtered back
projection, so that the metal itself keeps its place and the rays join what the rays of a scanner join.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array

from needlefit.arrays import Floats
from needlefit.imaging.volume import VoxelGrid
from needlefit.synthetic.ct_scene import WATER_PER_MM
from needlefit.synthetic.metal import MetalVoxels

Voxels = NDArray[np.float32]

HARDENING_COEFFICIENT = 0.06
"""h: a ray through 8 attenuation lengths of metal measures 5.4."""

VIEW_GAIN_SD, VIEW_GAIN_LENGTH = 0.15, 3.0
"""Deviation of a view's weight of metal, and over how many views it lasts (deviation of a Gaussian)."""

PHOTONS_PER_RAY = 1e4
"""Photons per ray that reach the detector if no metal is in the way."""

MAX_LINE_INTEGRAL = 8.0
"""Line integral at which scattered photons hide what is behind."""

BATCH_SLICES = 32
"""Slices that are worked on at once: what their rays hold must stay small."""


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
    fan = _make_beam(grid, views)
    error = np.zeros(grid.size[::-1], dtype=np.float32)
    held = np.unique(np.concatenate([metal.voxels[:, 2] for metal in metals]))
    if not len(held):
        return error
    gains = _draw_gains(views, rng)
    x, y = ((np.arange(n) * d - c) for n, d, c in zip(grid.size, grid.spacing, fan.center, strict=False))
    back = make_back_projector(x, y, fan)
    for first in range(0, len(held), BATCH_SLICES):
        slices = held[first : first + BATCH_SLICES]
        wrong = _projection_error(_project(metals, slices, grid, fan), gains, rng)
        rays = _ramp_filter(wrong, fan).reshape(len(slices), -1)
        planes = back @ np.ascontiguousarray(rays.T)  # (J * I, slices)
        error[slices] = planes.T.reshape(-1, *error.shape[1:])
    error *= np.float32(1000 / WATER_PER_MM)
    return error


def _projection_error(lines: Voxels, gains: Floats, rng: np.random.Generator) -> Voxels:
    """Return the error of projections whose line integrals of metal are `lines` (S, V, bins)."""
    touched = np.nonzero(lines)
    p = np.minimum(lines[touched], np.float32(MAX_LINE_INTEGRAL))
    hardened = p / (1 + HARDENING_COEFFICIENT * p) - p
    noise = rng.standard_normal(len(p), dtype=np.float32) * np.sqrt(np.expm1(p) / PHOTONS_PER_RAY)
    wrong = np.zeros_like(lines)
    wrong[touched] = hardened + p * gains[touched[1]] + noise
    return wrong


def _draw_gains(views: int, rng: np.random.Generator) -> Floats:
    """Return by which part each view weighs metal too much (V,)."""
    smooth = gaussian_filter1d(rng.normal(size=views), VIEW_GAIN_LENGTH, mode="wrap")
    gains: Floats = VIEW_GAIN_SD * smooth / smooth.std()
    return gains


def _make_beam(grid: VoxelGrid, views: int) -> ParallelBeam:
    extent = np.array(grid.size[:2]) * grid.spacing[:2]
    width = float(grid.spacing[:2].min()) / 1.5
    bins = int(np.ceil(np.hypot(*extent) / width)) + 4
    return ParallelBeam(np.arange(views) * np.pi / views, bins, width, (extent - grid.spacing[:2]) / 2)


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


def _ramp_filter(sinograms: Voxels, fan: ParallelBeam) -> Voxels:
    """Return the projections (S, V, bins) after the ramp filter under a Hann window, 1/mm."""
    # padded to twice the length against the FFT's wrap-around
    length = next_fast_len(2 * fan.bins, real=True)
    frequency = rfftfreq(length, fan.width)
    ramp = (frequency * (0.5 + 0.5 * np.cos(np.pi * frequency / frequency[-1]))).astype(np.float32)
    filtered: Voxels = irfft(rfft(sinograms, length) * ramp, length)[..., : fan.bins]
    return filtered


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
