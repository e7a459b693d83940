"""The image that a scanner makes of a ball: a table over the distances across and along the slices' normal.

A hardened beam sees a ball darker in its middle. Where the signal of a ray falls short by its length squared,
the image falls short by sqrt(1 - r^2 / R^2) in every slice, so that ball and shortfall are both spheres;
their Fourier transforms are Bessel functions. The scanner multiplies these by its modulation transfer: in the
slices (1 + b x^2) exp(-x^2), x = k sigma / sqrt(2), whose b lets edges over- and undershoot as sharp kernels
do; across them that of a box with a Gaussian's edges.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import j0, j1, jv, spherical_jn

from needlefit.arrays import Floats

TABLE_STEP_MM = 0.1
"""Spacing of the table, mm; cubic splines join it."""

FREQUENCY_STEP_PER_MM = 0.25
"""Spacing of the angular frequencies, 1/mm: images of a ball repeat every 25 mm."""

BOX_PART = 0.8
"""Part of the variance of a slice's profile that is a box's, the rest is a Gaussian's."""

MAX_FREQUENCY_SD = 4.5
"""Angular frequencies end at so many over the narrowest blur, 1/mm."""

BALL, SHORTFALL, ACROSS, ALONG, BLUR, BOOST, SLICE = range(7)
"""The tables: ball; shortfall; and the derivatives of ball + `shortfall` x shortfall by the distances across
and along, over these distances, 1/mm^2, and by the logarithm of the blur in the slices, b, and the logarithm
of the blur across them."""


SLICE_BLUR_RATIO, MIN_EXPECTED_SLICE_BLUR_MM = 0.33, 0.2
"""Deviation of a slice's profile over the slices' distance, and the least: a box has 0.29, helical scans
more."""


def expected_slice_blur(distance: float) -> float:
    """Return the blur across slices that their `distance` lets one expect, mm."""
    return max(SLICE_BLUR_RATIO * distance, MIN_EXPECTED_SLICE_BLUR_MM)


@dataclass(frozen=True)
class PointSpread:
    """A scanner's point spread: deviations `blur` and `slice_blur` (mm) in and across slices, and `boost`."""

    blur: float
    boost: float
    slice_blur: float


@dataclass(frozen=True)
class SphereTables:
    """Tables of balls of `radius` out to `reach`, for blurs in and across slices from `min_blur` on; mm."""

    radius: float
    reach: float
    min_blur: tuple[float, float]

    @cached_property
    def _grid(self) -> Floats:
        return np.arange(0.0, self.reach + 4 * TABLE_STEP_MM, TABLE_STEP_MM)

    @cached_property
    def _frequencies(self) -> tuple[Floats, Floats]:
        """Middles of the steps of frequency in the slices, and across them, 1/mm."""
        ends = [MAX_FREQUENCY_SD / blur for blur in self.min_blur]
        across, along = (np.arange(0.5, end / FREQUENCY_STEP_PER_MM) * FREQUENCY_STEP_PER_MM for end in ends)
        return across, along

    @cached_property
    def _transforms(self) -> tuple[Floats, Floats]:
        """Fourier transforms of ball and shortfall on the frequencies, times the measure of each."""
        across, along = self._frequencies
        x = self.radius * np.hypot(across[:, None], along)
        rings = across.copy()
        rings[0] *= 11 / 12  # the end term of Euler and Maclaurin: the integrand begins with a slope
        measure = rings[:, None] * FREQUENCY_STEP_PER_MM**2 / (2 * np.pi**2) * self.radius**3
        return 4 * np.pi * spherical_jn(1, x) / x * measure, 2 * np.pi**2 * jv(2, x) / x**2 * measure

    @cached_property
    def _waves(self) -> tuple[Floats, Floats, Floats, Floats]:
        across, along = self._frequencies
        kr, kz = np.outer(self._grid, across), np.outer(along, self._grid)
        # (J1(x) / x) is 1/2 at 0
        sloped = np.divide(j1(kr), kr, out=np.full_like(kr, 0.5), where=kr > 0)
        return j0(kr), -(across**2) * sloped, np.cos(kz), -(along[:, None] ** 2) * np.sinc(kz / np.pi)

    def render(self, shortfall: float, blur: float, boost: float, slice_blur: float) -> list[Floats]:
        """Return the seven tables (G, G), as splines."""
        across, along = self._frequencies
        x2 = (blur * across[:, None]) ** 2 / 2
        y2 = (1 - BOX_PART) * (slice_blur * along) ** 2 / 2
        z = np.sqrt(3 * BOX_PART) * slice_blur * along
        box = np.sinc(z / np.pi)
        fall = np.exp(-x2 - y2) * box
        pass_ = (1 + boost * x2) * fall
        ball, dark = self._transforms
        both = ball + shortfall * dark
        wave, sloped, cosine, sine = self._waves
        tables = [
            wave @ (ball * pass_) @ cosine,
            wave @ (dark * pass_) @ cosine,
            sloped @ (both * pass_) @ cosine,
            wave @ (both * pass_) @ sine,
            wave @ (both * 2 * x2 * (boost - 1 - boost * x2) * fall) @ cosine,
            wave @ (both * x2 * fall) @ cosine,
            wave @ (both * ((1 + boost * x2) * np.exp(-x2 - y2) * (np.cos(z) - box - 2 * y2 * box))) @ cosine,
        ]
        return [spline_filter(table, mode="mirror") for table in tables]


def look_up(table: Floats, across: Floats, along: Floats) -> Floats:
    """Return a table's values (N,) at distances `across` and `along` (N,) >= 0, mm."""
    places = np.stack([across, along]) / TABLE_STEP_MM
    return np.asarray(map_coordinates(table, places, order=3, mode="mirror", prefilter=False))
