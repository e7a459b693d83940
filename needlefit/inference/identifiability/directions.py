"""Principal directions of the information and standard deviations of theta, in words."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.parameter_names import BEVEL_SPREAD, is_logarithmic

#: SD of a combination's logarithm (of a sum with shape parameters) above which it is called nearly free
NEARLY_FREE_SD = 0.5
#: smallest posterior SD over prior SD at which the data add nothing to ties, priors and bounds
UNINFORMED_SD_RATIO = 0.9
#: words that are added to such a direction
KNOWN_BY_PRIOR = ", by the stated ties, priors or bounds alone"
MIN_RELATIVE_WEIGHT = 0.05  #: smallest weight, as a fraction of the largest, that is named in words


@dataclass(frozen=True)
class Direction:
    """One principal direction of the information on theta, with its standard deviation."""

    sd: float  #: standard deviation of theta along it (unit length in theta)
    weights: tuple[float, ...]  #: its components, in the order of the free parameters
    words: str  #: the same in words, for a person
    prior_sd: float = math.inf  #: standard deviation of the prior along it; infinite where none is given

    @property
    def sd_ratio(self) -> float:
        """Posterior SD / prior SD."""
        return self.sd / self.prior_sd

    @property
    def parameters(self) -> int:
        """How many parameters its words name."""
        largest = max(map(abs, self.weights))
        return sum(abs(weight) >= MIN_RELATIVE_WEIGHT * largest for weight in self.weights)

    @property
    def is_informed(self) -> bool:
        """Whether the data, not ties, priors or bounds alone, say something about it."""
        return not self.sd_ratio >= UNINFORMED_SD_RATIO  # NaN: neither is finite


def principal_directions(
    information: Floats, names: Sequence[str], prior: Floats | None = None
) -> tuple[Direction, ...]:
    """Return the principal directions of the information (P, P), best known first, in words.

    With the information (P, P) of the prior, which is a part of it, those that it alone knows are marked.
    """
    precision, vectors = np.linalg.eigh(information)
    before = None if prior is None else np.linalg.inv(prior)
    directions = []
    for value, vector in zip(precision[::-1], vectors.T[::-1], strict=True):
        sd = 1 / math.sqrt(value) if value > 0 else math.inf
        # the sign of an eigenvector is arbitrary: the largest component is made positive, so that words do
        # not change
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        prior_sd = math.inf if before is None else math.sqrt(vector @ before @ vector)
        size = np.abs(vector) / np.max(np.abs(vector))
        kept = (name for name, weight in zip(names, size, strict=True) if weight >= MIN_RELATIVE_WEIGHT)
        # of the combination whose largest weight is 1, and whether that is a logarithm
        scaled_sd, logarithm = sd / float(np.max(np.abs(vector))), all(map(is_logarithmic, kept))
        free = scaled_sd >= NEARLY_FREE_SD
        words_of_sd = f"to {format_sd(scaled_sd, logarithm)}"
        if logarithm and free:
            words_of_sd = f"within a factor of {_print_factor(scaled_sd)} only"
        nearly = "is nearly free: known" if free else "is known"
        words = f"{describe_combination(vector, names)} {nearly} {words_of_sd}"
        direction = Direction(sd, tuple(vector.tolist()), words, prior_sd)
        directions.append(
            direction if direction.is_informed else replace(direction, words=f"{words}{KNOWN_BY_PRIOR}")
        )
    return tuple(directions)


def describe_combination(weights: Floats, names: Sequence[str]) -> str:
    """Return a combination in words, its largest weight 1: `mu1 * b^1.9`; a sum with shape parameters."""
    scaled = weights / np.max(np.abs(weights))
    parts = [(name, float(w)) for name, w in zip(names, scaled, strict=True) if abs(w) >= MIN_RELATIVE_WEIGHT]
    if all(is_logarithmic(name) for name, _ in parts):
        powers = ((short_name(n), "" if abs(w - 1) < 0.005 else f"^{w:.2g}") for n, w in parts)
        return " * ".join(map("".join, powers))
    terms = []
    for name, weight in parts:
        factor = "" if abs(abs(weight) - 1) < 0.005 else f"{abs(weight):.2g} "
        term = f"ln {short_name(name)}" if is_logarithmic(name) else short_name(name)
        terms.append(f"{'-' if weight < 0 else '+'} {factor}{term}")
    return " ".join(terms).removeprefix("+ ")


def short_name(name: str) -> str:
    """Return a parameter's name in a sentence: no unit; b and θ as tables have them."""
    named = {
        "bevel_mm": "b",
        "cut_angle_deg": "θ",  # "theta" is the vector of all parameters
        "guide_distance_mm": "guide_distance",
        BEVEL_SPREAD: "bevel CV",
    }
    return named.get(name, name.removesuffix("_pa"))


def format_sd(sd: float, logarithm: bool) -> str:
    """Return a standard deviation: "0.3", and of a logarithm "12 %" or "factor 2.9"."""
    if not logarithm:
        return f"{sd:.2g}"
    return f"{100 * sd:.2g} %" if sd < NEARLY_FREE_SD else f"factor {_print_factor(sd)}"


def _print_factor(sd: float) -> str:
    factor = math.exp(min(sd, math.log(1e6)))
    return "more than 1e6" if factor >= 1e6 else f"{factor:.2g}" if factor < 10 else f"{factor:.0f}"


NORMAL_95_HALF_WIDTH_SD = 1.96  #: half width of a Gaussian 95 % interval, in standard deviations
MAX_FACTOR = 2.0  #: largest factor between the ends of the 95 % interval of a determined modulus or length
#: largest SD of the logarithm of a parameter called determined
MAX_LOG_SD = math.log(MAX_FACTOR) / (2 * NORMAL_95_HALF_WIDTH_SD)
MAX_SHAPE_SD = 0.5  #: largest SD of a shape parameter called determined
#: largest posterior SD over prior SD of a parameter that the shapes, not the prior, determine
MAX_SD_RATIO = 0.5
#: distance from a bound, as a fraction of the range, below which a parameter lies at it
BOUND_FRACTION = 1e-3
#: distance of the end of a 95 % interval from a bound, as a fraction of the range, below which it is cut off
#: there
CUT_OFF_FRACTION = 0.01


def find_bound_side(
    name: str, value: float, low: float, high: float, near: float = BOUND_FRACTION
) -> Literal["lower", "upper", ""]:
    """Return the bound at which a parameter lies, to within the part `near` of them; NaN lies at none."""
    least, coordinate, most = (
        math.log(bound) if is_logarithmic(name) else bound for bound in (low, value, high)
    )
    place = (coordinate - least) / (most - least)
    return "lower" if place < near else "upper" if place > 1 - near else ""


#: whether data determine a parameter: by itself, only together with others (where these are held), or not
Determined = Literal["yes", "only together", "no"]
DETERMINED: tuple[Determined, ...] = get_args(Determined)


def name_determined(alone: bool, together: bool) -> Determined:
    """Return the word for a parameter that data determine alone, or together with others, or not."""
    return "yes" if alone else "only together" if together else "no"


def find_least_determined(words: Iterable[str]) -> str:
    """Return the word of the fold, of several, in which a parameter is determined least; "" for no word."""
    determined = set(words)
    return next((word for word in reversed(DETERMINED) if word in determined), "")


def widest_interval(name: str) -> float:
    """Return the width of theta's coordinate that no 95 % interval of a determined parameter exceeds."""
    return 2 * NORMAL_95_HALF_WIDTH_SD * (MAX_LOG_SD if is_logarithmic(name) else MAX_SHAPE_SD)


def is_determined_by_data(name: str, sd: float, prior_sd: float) -> bool:
    """Return whether a posterior standard deviation is small enough by the data, not only by the prior."""
    return sd < (MAX_LOG_SD if is_logarithmic(name) else MAX_SHAPE_SD) and sd < MAX_SD_RATIO * prior_sd
