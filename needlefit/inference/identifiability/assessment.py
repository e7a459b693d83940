"""Compare three measures of identifiability of one parameter: posterior SD, information and profile.

The information at the optimum is local, the profile is not, and the posterior SD is of draws where there are
any: where they disagree, the sentence says which.
"""

import math
from dataclasses import dataclass

from needlefit.inference.identifiability.information import UNINFORMED_SD_RATIO, describe_precision
from needlefit.inference.identifiability.parameter_profiles import ParameterProfile
from needlefit.inference.identifiability.precision import is_determined_by_data
from needlefit.inference.parameters import is_logarithmic, to_value
from needlefit.inference.quantity_text import format_quantity, format_quantity_range

NORMAL_95_HALF_WIDTH_SD = 1.96
"""Half width of a Gaussian 95 % interval, in standard deviations."""

AGREEMENT_FACTOR = 1.5
"""Half widths of intervals, and standard deviations, that differ by less than this factor agree."""

AGREEMENT = "standard deviation, information and profile agree"


@dataclass(frozen=True)
class Assessment:
    """How well one parameter is identified, by its profile and by the information.

    Attributes
    ----------
    flat : bool
        Whether the data determine nothing: every value between the bounds is within the interval.
    determined : bool
        Whether the 95 % interval of its profile ends on both sides and is as narrow as that of a parameter
        called determined.
    interval : tuple of two floats
        That interval (Pa, mm); the last values looked at where it does not end.
    profile_verdict : str
        The profile in words.
    agreement : str
        `AGREEMENT`, or where standard deviation, information and profile do not, in words.
    """

    name: str
    flat: bool
    determined: bool
    interval: tuple[float, float]
    profile_verdict: str
    agreement: str


def assess_parameter(
    parameter: ParameterProfile,
    sds: tuple[float, float],
    equal: tuple[float, float] | None = None,
) -> Assessment:
    """Return the identifiability of one parameter, and where the measures disagree.

    Parameters
    ----------
    sds : tuple of two floats
        Standard deviation of its coordinate in the posterior, and in the prior.
    equal : tuple of two floats, optional
        Lowest and highest coordinate at which equally good starts ended.
    """
    profile, name = parameter.profile, parameter.name
    low, high = (to_value(name, end) for end in (profile.low, profile.high))
    faults = [
        *_compare_classes(parameter, sds),
        *_compare_sds(parameter, sds),
        *_compare_widths(parameter),
        *_compare_starts(parameter, equal),
    ]
    return Assessment(
        name=name,
        flat=profile.flat,
        determined=_classify_by_profile(parameter, sds[1]) == 2,
        interval=(low, high),
        profile_verdict=_describe_profile(parameter, low, high),
        agreement="; ".join(faults) if faults else AGREEMENT,
    )


def describe_posterior_sd(name: str, sd: float) -> str:
    """Return in words how well a parameter is known, given the standard deviation of its coordinate."""
    return describe_precision(sd, is_logarithmic(name)) if math.isfinite(sd) else "not at all"


def _describe_profile(parameter: ParameterProfile, low: float, high: float) -> str:
    profile = parameter.profile
    if profile.flat:
        description = _describe_flat(parameter)
    elif profile.closed:
        description = f"{format_quantity_range(parameter.name, low, high)} (95 %)"
    else:
        description = f"not identifiable: {_describe_open(parameter, low, high)}"
    return description + (f"; its profile has {profile.minima} minima" if profile.minima > 1 else "")


def _describe_flat(parameter: ParameterProfile) -> str:
    low, high = (to_value(parameter.name, end) for end in parameter.bounds)
    tip_range_mm = parameter.tip_range_mm
    tip = "" if tip_range_mm is None else f" and the tip moves by {_print_small(tip_range_mm)} mm"
    return (
        f"not identifiable: over its whole range, {format_quantity_range(parameter.name, low, high)}, the "
        f"deviance rises by {_print_small(parameter.profile.rise)}{tip}"
    )


def _describe_open(parameter: ParameterProfile, low: float, high: float) -> str:
    """Return an interval that does not end on both sides."""
    values = (format_quantity(parameter.name, end) for end in (low, high))
    sides = list(zip(("above", "below"), values, parameter.profile.ends, strict=True))
    parts = [f"{side} {value} (95 %)" for side, value, end in sides if end == "closed"]
    parts += [f"open at its bound {value}" for _, value, end in sides if end == "bound"]
    parts += [f"no solution was found beyond {value}" for _, value, end in sides if end == "lost"]
    return ", ".join(parts)


def _compare_classes(parameter: ParameterProfile, sds: tuple[float, float]) -> list[str]:
    """Return where posterior SD and profile do not come to the same conclusion."""
    name, (sd, prior_sd) = parameter.name, sds
    by_profile = _classify_by_profile(parameter, prior_sd)
    by_sd = (
        0 if sd > UNINFORMED_SD_RATIO * prior_sd else 2 if is_determined_by_data(name, sd, prior_sd) else 1
    )
    if by_profile == by_sd:
        return []
    words = ("not determined", "determined in part", "determined")
    return [f"{words[by_sd]} by the posterior SD, {words[by_profile]} by the profile"]


def _classify_by_profile(parameter: ParameterProfile, prior_sd: float) -> int:
    """Return the class of a parameter by its profile: 0 not determined, 1 in part, 2 determined."""
    profile = parameter.profile
    sd = (profile.high - profile.low) / (2 * NORMAL_95_HALF_WIDTH_SD)  # of a Gaussian interval of this width
    return (
        0
        if profile.flat
        else 2
        if profile.closed and is_determined_by_data(parameter.name, sd, prior_sd)
        else 1
    )


def _compare_sds(parameter: ParameterProfile, sds: tuple[float, float]) -> list[str]:
    """Return where the posterior SD is not the one that the profile's curvature at the optimum implies."""
    sd, prior_sd = sds
    ratio = sd * math.hypot(1 / parameter.profile.sd, 1 / prior_sd)
    if 1 / AGREEMENT_FACTOR < ratio < AGREEMENT_FACTOR:
        return []
    return [f"the posterior SD is {ratio:.2g} times that by the information"]


def _compare_widths(parameter: ParameterProfile) -> list[str]:
    """Return where the profile's interval is not the one that the information implies."""
    profile = parameter.profile
    half = NORMAL_95_HALF_WIDTH_SD * profile.sd
    reaches = (("below", profile.best - profile.low), ("above", profile.high - profile.best))
    description = []
    for (side, reach), end in zip(reaches, profile.ends, strict=True):
        if (
            end == "closed"
            and math.isfinite(half)
            # 1e-9: the reach is divided by below, and may be 0
            and not 1 / AGREEMENT_FACTOR < max(reach, 1e-9) / half < AGREEMENT_FACTOR
        ):
            ratio = max(reach / half, half / max(reach, 1e-9))
            description.append(f"{ratio:.2g} times {'farther' if reach > half else 'nearer'} {side}")
    if not description:
        return []
    return [
        f"the profile’s interval ends {' and '.join(description)} the optimum than the information implies"
    ]


def _compare_starts(parameter: ParameterProfile, equal: tuple[float, float] | None) -> list[str]:
    profile = parameter.profile
    if equal is None or (equal[0] >= profile.low - 1e-6 and equal[1] <= profile.high + 1e-6):
        return []
    low, high = (to_value(parameter.name, end) for end in equal)
    between = format_quantity_range(parameter.name, low, high)
    return [f"equally good starts end outside its interval, {between}"]


def _print_small(value: float) -> str:
    return "less than 1e-4" if value < 1e-4 else f"at most {value:.2g}"
