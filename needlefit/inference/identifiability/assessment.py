"""Compare three measures of identifiability of one parameter: information, profile, posterior SD / prior SD.

The information at the optimum is local, the profile is not, and the SD ratio counts the bounds: where they
disagree, the sentence says which.
"""

import math
from dataclasses import dataclass

from needlefit.inference.identifiability.information import UNINFORMED_SD_RATIO, describe_precision
from needlefit.inference.identifiability.parameter_profiles import ParameterProfile
from needlefit.inference.identifiability.precision import is_determined_by_data
from needlefit.inference.parameters import is_logarithmic, to_value

NORMAL_95_HALF_WIDTH_SD = 1.96
"""Half width of a Gaussian 95 % interval, in standard deviations."""

AGREEMENT_FACTOR = 1.5
"""Half widths of intervals, and contractions, that differ by less than this factor agree."""

AGREEMENT = "information, profile and contraction agree"


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
        `AGREEMENT`, or where information, profile and contraction do not, in words.
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
    scatter: float = 1.0,
) -> Assessment:
    """Return the identifiability of one parameter, and where the measures disagree.

    Parameters
    ----------
    sds : tuple of two floats
        Standard deviation of its coordinate in the posterior, and in the prior.
    equal : tuple of two floats, optional
        Lowest and highest coordinate at which equally good starts ended.
    scatter : float
        How many times larger than from the noise the deviation is because needles differ.
    """
    profile, name = parameter.profile, parameter.name
    low, high = (to_value(name, end) for end in (profile.low, profile.high))
    faults = [
        *_compare_classes(parameter, sds),
        *_compare_widths(parameter),
        *_compare_starts(parameter, equal),
    ]
    if scatter > AGREEMENT_FACTOR:
        faults.append(f"needles differ by {scatter:.2g} times what the profile's noise allows")
    return Assessment(
        name=name,
        flat=profile.flat,
        determined=_classify_by_profile(parameter, sds[1]) == 2,
        interval=(low, high),
        profile_verdict=_describe_profile(parameter, low, high),
        agreement="; ".join(faults) if faults else AGREEMENT,
    )


def add_sampled_disagreement(agreement: str, expected: float, sampled: float) -> str:
    """Return the sentence on agreement, extended where the posterior draws contradict the information."""
    if 1 / AGREEMENT_FACTOR < sampled / expected < AGREEMENT_FACTOR:
        return agreement
    description = f"the draws contract to {sampled:.2g} of the prior, by the information {expected:.2g}"
    return description if agreement == AGREEMENT else f"{agreement}; {description}"


def describe_posterior_sd(name: str, sd: float) -> str:
    """Return in words how well a parameter is known, given the standard deviation of its coordinate."""
    return describe_precision(sd, is_logarithmic(name)) if math.isfinite(sd) else "not at all"


def _describe_profile(parameter: ParameterProfile, low: float, high: float) -> str:
    profile = parameter.profile
    if profile.flat:
        description = _describe_flat(parameter)
    elif profile.closed:
        description = f"{_print(low)} to {_print(high)} (95 %)"
    else:
        description = f"not identifiable: {_describe_open(parameter, low, high)}"
    return description + (f"; its profile has {profile.minima} minima" if profile.minima > 1 else "")


def _describe_flat(parameter: ParameterProfile) -> str:
    low, high = (to_value(parameter.name, end) for end in parameter.bounds)
    tip_range_mm = parameter.tip_range_mm
    tip = "" if tip_range_mm is None else f" and the tip moves by {_print_small(tip_range_mm)} mm"
    return (
        f"not identifiable: over its whole range, {_print(low)} to {_print(high)}, the deviance rises by "
        f"{_print_small(parameter.profile.rise)}{tip}"
    )


def _describe_open(parameter: ParameterProfile, low: float, high: float) -> str:
    """Return an interval that does not end on both sides."""
    sides = list(zip(("above", "below"), (low, high), parameter.profile.ends, strict=True))
    parts = [f"{side} {_print(value)} (95 %)" for side, value, end in sides if end == "closed"]
    parts += [f"open at its bound {_print(value)}" for _, value, end in sides if end == "bound"]
    parts += [f"no solution was found beyond {_print(value)}" for _, value, end in sides if end == "lost"]
    return ", ".join(parts)


def _compare_classes(parameter: ParameterProfile, sds: tuple[float, float]) -> list[str]:
    """Return where information and profile do not come to the same conclusion."""
    name, (sd, prior_sd) = parameter.name, sds
    by_profile = _classify_by_profile(parameter, prior_sd)
    by_information = (
        0 if sd > UNINFORMED_SD_RATIO * prior_sd else 2 if is_determined_by_data(name, sd, prior_sd) else 1
    )
    if by_profile == by_information:
        return []
    words = ("not at all", "in part", "determined")
    return [f"by the information {words[by_information]}, by the profile {words[by_profile]}"]


def _classify_by_profile(parameter: ParameterProfile, prior_sd: float) -> int:
    """Return the class of a parameter by its profile: 0 not determined, 1 in part, 2 determined."""
    profile = parameter.profile
    # divided by the factor of agreement too: the profile may be that much wider before the class changes
    sd = (profile.high - profile.low) / (2 * NORMAL_95_HALF_WIDTH_SD * AGREEMENT_FACTOR)
    return (
        0
        if profile.flat
        else 2
        if profile.closed and is_determined_by_data(parameter.name, sd, prior_sd)
        else 1
    )


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
            description.append(f"{ratio:.2g} times {'wider' if reach > half else 'narrower'} {side}")
    return [f"the profile is {' and '.join(description)} than by the information"] if description else []


def _compare_starts(parameter: ParameterProfile, equal: tuple[float, float] | None) -> list[str]:
    profile = parameter.profile
    if equal is None or (equal[0] >= profile.low - 1e-6 and equal[1] <= profile.high + 1e-6):
        return []
    low, high = (to_value(parameter.name, end) for end in equal)
    return [f"equally good starts end outside its interval, {_print(low)} to {_print(high)}"]


def _print_small(value: float) -> str:
    return "less than 1e-4" if value < 1e-4 else f"at most {value:.2g}"


def _print(value: float) -> str:
    """Return three digits: 2.13e5, not 2.13e+05."""
    mantissa, e, exponent = f"{value:.3g}".partition("e")
    return f"{mantissa}{e}{int(exponent)}" if e else mantissa
