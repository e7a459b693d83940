"""Names of parameters: what each measures, and its coordinate in theta.

Moduli and lengths are searched in logarithms, because they are positive and known to orders of magnitude at
most; shape parameters of a law are searched as they are.
"""

import math
import re
from functools import cache

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ConfigError

#: name of the estimated factor on the SDs of the noise of the points; no medium has it
NOISE_SCALE = "noise_scale"
#: name of the estimated relative SD of b or θ between insertions; no medium has it
BEVEL_SPREAD = "bevel_spread"
#: smallest bevel of an insertion over the mean: a normal distribution does not end at zero
MIN_BEVEL_FACTOR = 0.05
#: names of the parameter of how strongly a needle steers; a medium has one of them
BEVEL_PARAMETERS = ("bevel_mm", "cut_angle_deg")
#: bounds of an estimated scale of the noise; its prior is flat in the logarithm
NOISE_SCALE_BOUNDS = (0.1, 10.0)
BEVEL_SPREAD_BOUNDS = (0.01, 5.0)  #: bounds of the spread, in standard deviations of its half-normal prior
#: names of parameters of the likelihood: no simulated needle depends on them
HYPERPARAMETERS = (NOISE_SCALE, BEVEL_SPREAD)
_NAME = re.compile(
    r"([a-z]+(?:_[a-z]+)*)[1-9]\d*(_pa)?|(?:bevel|guide_distance)_mm|cut_angle_deg|noise_scale|bevel_spread"
)
_DIMENSIONS = ("modulus", "length", "angle", "factor")


@cache  # asked for every parameter of every draw
def dimension(name: str) -> str:
    """Return what the parameter `name` measures: "modulus", "length", "angle" or "factor".

    Of a shape parameter of a law it is the name without the number of the layer, such as "alpha".

    Raises ConfigError if it is no parameter's name.
    """
    match = _NAME.fullmatch(name)
    if match is None or (match[1] is not None and (match[1] == "mu") != (match[2] is not None)):
        raise ConfigError(
            f"there is no parameter called `{name}`",
            expected="mu1_pa, alpha1, mu2_pa, ..., bevel_mm or cut_angle_deg, guide_distance_mm",
            fix=f"write `{name}_pa`" if _NAME.fullmatch(f"{name}_pa") else "correct the name",
        )
    if name in (NOISE_SCALE, BEVEL_SPREAD, "cut_angle_deg"):
        return "angle" if name == "cut_angle_deg" else "factor"
    return "modulus" if match[1] == "mu" else match[1] or "length"


def find_bevel_factors(spread: Floats | float, deviations: Floats | float) -> Floats:
    """Return bevels, as parts of their mean, that deviate by so many SDs of relative size `spread`."""
    return np.maximum(1.0 + np.asarray(spread) * deviations, MIN_BEVEL_FACTOR)


def is_shape_parameter(name: str) -> bool:
    """Return whether `name` is a shape parameter of a law in one layer, such as `alpha2`."""
    return dimension(name) not in _DIMENSIONS


def is_logarithmic(name: str) -> bool:
    """Return whether theta holds the natural logarithm of this parameter."""
    return not is_shape_parameter(name)


def to_coordinate(name: str, value: float) -> float:
    """Return the coordinate of a parameter in theta: its logarithm, or a shape parameter itself."""
    return math.log(value) if is_logarithmic(name) else float(value)


def to_value(name: str, coordinate: float) -> float:
    """Return a parameter's value (Pa, mm) at its coordinate of theta."""
    return math.exp(coordinate) if is_logarithmic(name) else float(coordinate)
