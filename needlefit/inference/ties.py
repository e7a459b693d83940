"""Read ties between parameters: `"mu1_pa"` or `"10 * mu1_pa"` -> a factor and the parameter it refers to."""

import math
import re
from collections.abc import Mapping
from functools import cache

from needlefit.errors import ConfigError
from needlefit.project.toml_lines import add_key_context

NOISE_SCALE = "noise_scale"
"""Name of the estimated factor on the standard deviations of the noise of the points; no medium has it."""

BEVEL_SPREAD = "bevel_spread"
"""Name of the relative SD of b or θ between insertions, which is estimated; no medium has it."""

BEVEL_PARAMETERS = ("bevel_mm", "cut_angle_deg")
"""Names of what says how strongly a needle steers; a medium has one of them."""

_NAME = re.compile(
    r"([a-z]+(?:_[a-z]+)*)[1-9]\d*(_pa)?|(?:bevel|guide_distance)_mm|cut_angle_deg|noise_scale|bevel_spread"
)
_DIMENSIONS = ("modulus", "length", "angle", "factor")
_TIE = re.compile(r"\s*(?:(?P<factor>[^*\s]+)\s*\*\s*)?(?P<name>[A-Za-z_]\w*)\s*")


@cache  # asked for every parameter of every draw
def dimension(name: str) -> str:
    """Return what the parameter `name` measures: "modulus", "length", "angle" or "factor".

    Of a shape parameter of a law it is the name without the number of the layer, such as "alpha".

    Raises
    ------
    ConfigError
        If it is no parameter's name.
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


def is_shape_parameter(name: str) -> bool:
    """Return whether `name` is a shape parameter of a law in one layer, such as `alpha2`."""
    return dimension(name) not in _DIMENSIONS


def parse_tie(name: str, tie: str) -> tuple[float, str]:
    """Return (factor, source) of the tie that the parameter `name` states.

    Raises
    ------
    ConfigError
        If the tie cannot be read, joins different quantities, or its factor cannot be.
    """
    match = _TIE.fullmatch(tie)
    if match is None:
        raise _tie_error(name, tie, "cannot be read")
    try:
        factor = float(match["factor"] or 1.0)
    except ValueError:
        raise _tie_error(name, tie, f"has the factor `{match['factor']}`, which is no number") from None
    with add_key_context(f"parameters.{name}.tie"):
        source = dimension(match["name"])
    if source != dimension(name):
        raise _tie_error(name, tie, f"joins different quantities, {dimension(name)} and {source}")
    positive = not is_shape_parameter(name)
    if not math.isfinite(factor) or (positive and factor <= 0):
        raise _tie_error(name, tie, f"has the factor {factor:g}; moduli and lengths stay positive")
    return factor, match["name"]


def resolve_ties(
    ties: Mapping[str, tuple[float, str]], known: frozenset[str]
) -> dict[str, tuple[float, str]]:
    """Return each tied parameter's (factor, source) with a source that is itself not tied.

    Raises
    ------
    ConfigError
        If a tie leads to no parameter of the medium, or in a circle.
    """
    return {name: _resolve_tie(name, ties, known) for name in ties}


def _resolve_tie(
    name: str, ties: Mapping[str, tuple[float, str]], known: frozenset[str]
) -> tuple[float, str]:
    factor, at, visited = 1.0, name, [name]
    while at in ties:
        step, at = ties[at]
        factor *= step
        if at in visited:
            raise ConfigError(
                f"ties run in a circle: {' -> '.join([*visited, at])}",
                key=f"parameters.{name}.tie",
                fix="leave one of them free or fixed",
            )
        if at not in known:
            raise ConfigError(
                f"`{visited[-1]}` is tied to `{at}`, which is no parameter of this tissue model",
                key=f"parameters.{name}.tie",
                expected=f"one of {', '.join(sorted(known - set(visited)))}",
                fix="tie it to one of these, or give it bounds",
            )
        visited.append(at)
    return factor, at


def _tie_error(name: str, tie: str, fault: str) -> ConfigError:
    return ConfigError(
        f"the tie `{tie}` {fault}",
        key=f"parameters.{name}.tie",
        expected='another parameter of the same kind, with a factor if wanted: "mu1_pa" or "10 * mu1_pa"',
        fix="correct the tie, or give the parameter bounds",
    )
