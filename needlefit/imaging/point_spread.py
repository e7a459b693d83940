"""The point spread of a scanner: one model for balls, shaft, tip and slices.

In the slices the modulation transfer is (1 + b x^2) exp(-x^2), x = k sigma / sqrt(2), whose b lets edges
over- and undershoot as sharp kernels do; across them it is that of a box with a Gaussian's edges, the profile
of a slice. What is known of scanners is where a fit begins (`expected_spread`); balls in the scan replace it
(`average_spreads`), and the shaft refines it where tip or slices are fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from needlefit.arrays import Floats
from needlefit.imaging.constants import MM, PART, SCANNER

# largest number of fitted voxels; of more every second, third ... is fitted: neighbours in fine voxels are
# one in the blur
MAX_FITTED_VOXELS = 4000
_PARTS = (SCANNER.BLUR, SCANNER.BOOST, SCANNER.SLICE_BLUR)
EXPECTED_SDS = tuple(part.sd for part in _PARTS)  # prior SDs of log blur, boost, log blur across
BALL_SDS = (0.04, 0.15, 0.08)  # prior SDs of these where balls in the scan show them
# ranges of these parameters
LOWEST, HIGHEST = np.array([part.range for part in _PARTS]).T
LOWEST[::2], HIGHEST[::2] = np.log([LOWEST[::2], HIGHEST[::2]])
Reals = NDArray[np.floating[Any]]  # of single precision where the frequencies are


def robust_sd(errors: Floats) -> float:
    """Return the deviation of a Gaussian whose absolute values have the median of those of `errors` (N,)."""
    return 1.48 * float(np.median(np.abs(errors)))


@dataclass(frozen=True)
class PointSpread:
    """A scanner's point spread: deviations `blur` and `slice_blur` (mm) in and across slices, and `boost`."""

    blur: float
    boost: float
    slice_blur: float
    # Standard deviations of `parameters`.
    sds: tuple[float, ...] = EXPECTED_SDS
    box: float = PART.BOX

    @property
    def parameters(self) -> Floats:
        """Logarithm of the blur, boost, and logarithm of the blur across slices (3,)."""
        return np.array([np.log(self.blur), self.boost, np.log(self.slice_blur)])

    def pass_in_slices(self, squared: Reals) -> Reals:
        """Return what passes of squared angular frequencies in the slices, 1/mm^2."""
        x2 = squared * (self.blur**2 / 2)
        return (1 + self.boost * x2) * np.exp(-x2)

    def pass_across(self, frequency: Reals) -> Reals:
        """Return what passes of angular frequencies along the slices' normal, 1/mm."""
        y = frequency * self.slice_blur
        box = np.sinc(y * float(np.sqrt(3 * self.box) / np.pi))
        return np.exp(-(y**2) * ((1 - self.box) / 2)) * box

    def weigh_planes(self, away: Floats) -> Floats:
        """Return the sensitivity of a slice at distances from its middle, mm, over that of its middle."""
        half, edge = np.sqrt(3 * self.box) * self.slice_blur, np.sqrt(1 - self.box) * self.slice_blur
        return (ndtr((half - away) / edge) - ndtr((-half - away) / edge)) / (2 * ndtr(half / edge) - 1)


def read_spread(parameters: Floats) -> PointSpread:
    """Return the point spread of `PointSpread.parameters` (3,)."""
    return PointSpread(float(np.exp(parameters[0])), float(parameters[1]), float(np.exp(parameters[2])))


def expected_spread(slice_distance: float) -> PointSpread:
    """Return what one expects of a scanner whose slices are `slice_distance` mm apart."""
    slice_blur = max(SCANNER.SLICE_BLUR.value * slice_distance, MM.LEAST_SLICE_BLUR)
    return PointSpread(SCANNER.BLUR.value, SCANNER.BOOST.value, slice_blur)


def average_spreads(spreads: Sequence[PointSpread]) -> PointSpread | None:
    """Return the median of what balls in a scan show; None if there is no ball."""
    if not spreads:
        return None
    middle = read_spread(np.median([one.parameters for one in spreads], axis=0))
    return PointSpread(middle.blur, middle.boost, middle.slice_blur, BALL_SDS)
