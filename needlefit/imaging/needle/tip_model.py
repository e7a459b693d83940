"""The image that a scanner makes of a needle's end: a bevelled rod, times the scanner's modulation transfer.

In the slices the transfer is (1 + b x^2) exp(-x^2), x = k sigma / sqrt(2), whose b lets edges over- and
undershoot; across them that of a box with a Gaussian's edges. Coordinates are the needle's: s along it from
the tip, u and v across.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfftn, next_fast_len, rfftn
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats, Ints
from needlefit.imaging.sphere_profile import BOX_PART, PointSpread

Singles = NDArray[np.float32]

GRID_STEP_MM = 0.25
"""Spacing of the points on which the rod is modelled, mm."""

FIBRES = 6
"""Fibres along the needle into which a grid's step is parted, in each direction across."""

MARGIN_MM = 2.0
"""Free space around what is looked at, mm: the transform repeats, and the blur must not reach round."""


@dataclass(frozen=True)
class RodModel:
    """Images of a rod of `radius`, from `back` behind to `ahead` of its tip and out to `aside`, mm.

    `normal` (3,) is the slices' normal along s, u and v.
    """

    radius: float
    back: float
    ahead: float
    aside: float
    normal: tuple[float, float, float]

    @cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Points along s, and along u and v."""
        count = next_fast_len(int((self.back + self.ahead + 2 * MARGIN_MM) / GRID_STEP_MM) + 1, real=True)
        half = next_fast_len(int(2 * (self.aside + MARGIN_MM) / GRID_STEP_MM) + 1, real=True)
        along: Floats = -self.back - MARGIN_MM + np.arange(count, dtype=np.float64) * GRID_STEP_MM
        across: Floats = (np.arange(half, dtype=np.float64) - half // 2) * GRID_STEP_MM
        return along, across

    @cached_property
    def _squares(self) -> tuple[Singles, Singles, Singles]:
        """Squared angular frequencies in the slices, those across, 1/mm, and the filter of cubic splines."""
        along, across = self._axes
        turns = [2 * np.pi * np.fft.fftfreq(len(a), GRID_STEP_MM) for a in (along, across)]
        last = 2 * np.pi * np.fft.rfftfreq(len(across), GRID_STEP_MM)
        k = np.meshgrid(turns[0], turns[1], last, indexing="ij", sparse=True)
        normal = sum(a * n for a, n in zip(k, self.normal, strict=True))
        total = sum(a**2 for a in k)
        spline = 1.0
        for a in k:
            spline = spline * 3 / (2 + np.cos(a * GRID_STEP_MM))
        return (
            np.asarray(total - normal**2, dtype=np.float32),
            np.asarray(normal, dtype=np.float32),
            np.asarray(spline, dtype=np.float32),
        )

    def transform(self, roll: float, cotangent: float) -> NDArray[np.complex64]:
        """Return the Fourier transform of the rod, its bevel's point at the angle `roll` from u."""
        along, across = self._axes
        (rows, columns), fibres, weights = self._fibres
        u, v = fibres
        cut = (self.radius - (u * np.cos(roll) + v * np.sin(roll))) * cotangent
        ends = np.clip((-cut[None] - along[:, None, None]) / GRID_STEP_MM + 0.5, 0, 1)
        solid = np.zeros((len(along), len(across), len(across)), dtype=np.float32)
        solid[:, rows, columns] = np.mean(ends * weights, axis=2)
        solid[along < along[0] + MARGIN_MM / 2] = 0
        return np.asarray(rfftn(solid))

    @cached_property
    def _fibres(self) -> tuple[tuple[Ints, Ints], Floats, Floats]:
        """Points across (C,) with metal, u and v (2, C, F) of the fibres around each, and their part."""
        _, across = self._axes
        fine = (np.arange(FIBRES) + 0.5) / FIBRES - 0.5
        part = np.stack(np.meshgrid(fine, fine, indexing="ij")).reshape(2, -1) * GRID_STEP_MM
        near = np.hypot(across[:, None], across) < self.radius + GRID_STEP_MM
        rows, columns = np.nonzero(near)
        fibres = np.stack([across[rows], across[columns]])[..., None] + part[:, None]
        inside = (self.radius - np.hypot(*fibres)) / (GRID_STEP_MM / FIBRES) + 0.5
        return (rows, columns), fibres, np.clip(inside, 0, 1)

    def splines(self, transform: NDArray[np.complex64], spread: PointSpread) -> Singles:
        """Return the spline coefficients of the blurred rod of height 1."""
        in_slice, normal, spline = self._squares
        x2 = in_slice * np.float32(spread.blur**2 / 2)
        passed = (1 + np.float32(spread.boost) * x2) * np.exp(
            -x2 - normal**2 * np.float32((1 - BOX_PART) * spread.slice_blur**2 / 2)
        )
        passed *= np.sinc(normal * np.float32(np.sqrt(3 * BOX_PART) * spread.slice_blur / np.pi)) * spline
        along, across = self._axes
        shape = (len(along), len(across), len(across))
        return np.asarray(irfftn(transform * passed, shape))

    def sample(self, splines: Singles, s: Floats, u: Floats, v: Floats) -> Floats:
        """Return the image (N,) at places (N,) from the tip."""
        along, across = self._axes
        place = np.stack([s - along[0], u - across[0], v - across[0]]) / GRID_STEP_MM
        return np.asarray(map_coordinates(splines, place, order=3, mode="nearest", prefilter=False), float)


class CachedRod:
    """A rod model that keeps its last images: of a step's derivatives most are of the same rod."""

    def __init__(self, model: RodModel) -> None:
        self.model = model
        self._transform = lru_cache(maxsize=4)(model.transform)
        self._splines = lru_cache(maxsize=8)(self._blur)

    def _blur(self, roll: float, cotangent: float, blur: float, boost: float, slice_blur: float) -> Singles:
        return self.model.splines(self._transform(roll, cotangent), PointSpread(blur, boost, slice_blur))

    def image(
        self, end: tuple[float, float], spread: PointSpread, places: tuple[Floats, Floats, Floats]
    ) -> Floats:
        """Return the image (N,) of a rod that ends with `end` (roll, cotangent) at places s, u, v (N,)."""
        return self.model.sample(self._splines(*end, spread.blur, spread.boost, spread.slice_blur), *places)
