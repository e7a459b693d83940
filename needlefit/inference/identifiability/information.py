"""Compute Fisher information: difference Jacobians, Cramer-Rao deviations, directions in words."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.ties import BEVEL_SPREAD

LOG_STEP, SHAPE_STEP = 1e-3, 5e-2
"""Steps of the differences: in a logarithm, and in a shape parameter, on which needles hardly depend."""

NEARLY_FREE_SD = 0.5
"""SD of a combination's logarithm (of a sum with shape parameters) above which it is called nearly free."""

UNINFORMED_SD_RATIO = 0.9
"""Posterior SD / prior SD from which on the data add nothing to what ties, priors and bounds say."""

KNOWN_BY_PRIOR = ", by the stated ties, priors or bounds alone"
"""What is added to the words of such a direction."""

MIN_RELATIVE_WEIGHT = 0.05
"""Weights below this part of the largest are left out of the words."""


@dataclass(frozen=True)
class Direction:
    """One principal direction of the information on theta, with its standard deviation.

    Attributes
    ----------
    sd : float
        Standard deviation of theta along it (unit length in theta).
    weights : tuple of float
        Its components, in the order of the free parameters.
    words : str
        The same in words, for a person.
    prior_sd : float
        Standard deviation of the prior along it; infinite where none is given.
    """

    sd: float
    weights: tuple[float, ...]
    words: str
    prior_sd: float = math.inf

    @property
    def sd_ratio(self) -> float:
        """Posterior SD / prior SD."""
        return self.sd / self.prior_sd

    @property
    def is_informed(self) -> bool:
        """Whether the data, not ties, priors or bounds alone, say something about it."""
        return not self.sd_ratio >= UNINFORMED_SD_RATIO  # NaN: neither is finite


def difference_jacobian(residuals: Callable[[Floats], Floats], theta: Floats, steps: Floats) -> Floats:
    """Return d residuals / d theta (R, P): central differences, one-sided where one neighbour fails.

    A column is NaN where neither neighbour can be solved.
    """
    centre = residuals(theta)
    columns = []
    for k, step in enumerate(steps):
        move = step * np.eye(len(theta))[k]
        ahead, behind = residuals(theta + move), residuals(theta - move)
        column = (ahead - behind) / (2 * step)
        if not np.all(np.isfinite(column)):
            forward, backward = (ahead - centre) / step, (centre - behind) / step
            column = forward if np.all(np.isfinite(forward)) else backward
        columns.append(column)
    return np.stack(columns, axis=1) if columns else np.empty((len(centre), 0))


def difference_steps(names: Sequence[str]) -> Floats:
    """Return the step (P,) of the finite differences for each parameter of theta."""
    return np.array([LOG_STEP if is_logarithmic(name) else SHAPE_STEP for name in names])


def cramer_rao(information: Floats) -> Floats:
    """Return the Cramer-Rao standard deviations (P,) of theta; infinite where there is no information."""
    precision, vectors = np.linalg.eigh(information)
    with np.errstate(divide="ignore", invalid="ignore"):
        # a singular direction must make only its own parameters infinite: components below rounding would
        # give 0 / 0
        variance = np.where(vectors**2 > 1e-14, vectors**2 / np.maximum(precision, 0.0), 0.0)
    sd: Floats = np.sqrt(variance.sum(axis=1))
    return sd


def principal_directions(
    information: Floats, names: Sequence[str], prior: Floats | None = None
) -> tuple[Direction, ...]:
    """Return the principal directions of the information (P, P), best known first, in words.

    With the information (P, P) of the prior, which is a part of it, those that it alone knows are marked.
    """
    precision, vectors = np.linalg.eigh(information)
    before = None if prior is None else np.linalg.inv(prior)
    found = []
    for value, vector in zip(precision[::-1], vectors.T[::-1], strict=True):
        sd = 1 / math.sqrt(value) if value > 0 else math.inf
        # the sign of an eigenvector is arbitrary: the largest component is made positive, so that words do
        # not change
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        prior_sd = math.inf if before is None else math.sqrt(vector @ before @ vector)
        words = _describe_direction(sd, vector, names)
        one = Direction(sd, tuple(vector.tolist()), words, prior_sd)
        found.append(one if one.is_informed else replace(one, words=f"{words}{KNOWN_BY_PRIOR}"))
    return tuple(found)


def describe_combination(weights: Floats, names: Sequence[str]) -> str:
    """Return a combination in words, its largest weight 1: `mu1 * b^1.9`; a sum with shape parameters."""
    scaled = weights / np.max(np.abs(weights))
    parts = [(name, float(w)) for name, w in zip(names, scaled, strict=True) if abs(w) >= MIN_RELATIVE_WEIGHT]
    if all(is_logarithmic(name) for name, _ in parts):
        return " * ".join(_print_power(short_name(name), weight) for name, weight in parts)
    terms = [_print_term(f"ln {short_name(n)}" if is_logarithmic(n) else short_name(n), w) for n, w in parts]
    return " ".join(terms).removeprefix("+ ")


def short_name(name: str) -> str:
    """Return a parameter's name in a sentence: no unit; b and θ as tables have them."""
    named = {
        "bevel_mm": "b",
        "cut_angle_deg": "θ",  # "theta" is the vector of all parameters
        "guide_distance_mm": "guide_distance",
        BEVEL_SPREAD: "relative bevel SD",
    }
    return named.get(name, name.removesuffix("_pa"))


def format_sd(sd: float, logarithm: bool) -> str:
    """Return a standard deviation: "0.3", and of a logarithm "12 %" or "factor 2.9"."""
    if not logarithm:
        return f"{sd:.2g}"
    return f"{100 * sd:.2g} %" if sd < NEARLY_FREE_SD else f"factor {_print_factor(sd)}"


def describe_precision(sd: float, logarithm: bool) -> str:
    """Return in words how well a quantity is known, given the deviation of its value or logarithm."""
    if logarithm and sd >= NEARLY_FREE_SD:
        return f"within a factor of {_print_factor(sd)} only"
    return f"to {format_sd(sd, logarithm)}"


def format_combination_sd(sd: float, weights: Floats, names: Sequence[str]) -> str:
    """Return the standard deviation of a combination as `describe_combination` writes it."""
    return format_sd(*_scale_sd(sd, weights, names))


def _scale_sd(sd: float, weights: Floats, names: Sequence[str]) -> tuple[float, bool]:
    """Return the deviation of a combination whose largest weight is 1, and whether it is of a logarithm."""
    scaled = np.abs(weights) / np.max(np.abs(weights))
    kept = (name for name, weight in zip(names, scaled, strict=True) if weight >= MIN_RELATIVE_WEIGHT)
    return sd / float(np.max(np.abs(weights))), all(map(is_logarithmic, kept))


def _describe_direction(sd: float, weights: Floats, names: Sequence[str]) -> str:
    scaled_sd, logarithm = _scale_sd(sd, weights, names)
    known = "is known" if scaled_sd < NEARLY_FREE_SD else "is nearly free: known"
    return f"{describe_combination(weights, names)} {known} {describe_precision(scaled_sd, logarithm)}"


def _print_factor(sd: float) -> str:
    factor = math.exp(min(sd, math.log(1e6)))
    return "more than 1e6" if factor >= 1e6 else f"{factor:.2g}" if factor < 10 else f"{factor:.0f}"


def _print_power(name: str, weight: float) -> str:
    return name if abs(weight - 1) < 0.005 else f"{name}^{weight:.2g}"


def _print_term(name: str, weight: float) -> str:
    sign = "-" if weight < 0 else "+"
    return f"{sign} {name}" if abs(abs(weight) - 1) < 0.005 else f"{sign} {abs(weight):.2g} {name}"
