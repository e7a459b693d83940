"""Three ways of saying whether a parameter is determined, laid beside each other.

The information at the optimum is local, the profile is not, and the posterior's contraction counts the
bounds: where they say different things, the sentence says which.
"""

import math
from dataclasses import dataclass

from needlefit.inference.identifiability.examine import Examined
from needlefit.inference.identifiability.identify import NARROWED, SD_ALPHA, SD_LOG
from needlefit.inference.identifiability.information import precision_words
from needlefit.inference.parameters import in_logarithm

NORMAL = 1.96
"""Half width of a Gaussian 95 % interval, in standard deviations."""

LIKE = 1.5
"""Half widths of intervals, and contractions, that differ by less than this factor agree."""

NOTHING = 0.9
"""Contraction from which on the data add nothing to bounds and prior."""

AGREE = "information, profile and contraction agree"


@dataclass(frozen=True)
class Judgement:
    """What is to be said of one parameter.

    Attributes
    ----------
    name : str
    flat : bool
        Whether the data say nothing: every value between the bounds is within the interval.
    determined : bool
        Whether the 95 % interval of its profile ends on both sides and is as narrow as that of a parameter
        called determined.
    interval : tuple of two floats
        That interval (Pa, mm); the last values looked at where it does not end.
    says : str
        The profile in words.
    agreement : str
        `AGREE`, or where information, profile and contraction do not, in words.
    """

    name: str
    flat: bool
    determined: bool
    interval: tuple[float, float]
    says: str
    agreement: str


def judge(
    examined: Examined,
    known: tuple[float, float],
    equal: tuple[float, float] | None = None,
    scatter: float = 1.0,
) -> Judgement:
    """Return what to say of one parameter.

    Parameters
    ----------
    examined : Examined
    known : tuple of two floats
        Standard deviation of its coordinate in the posterior, and in the prior.
    equal : tuple of two floats, optional
        Lowest and highest coordinate at which equally good starts ended.
    scatter : float
        How many times larger than from the noise the deviation is because needles differ.
    """
    profile, name = examined.profile, examined.name
    low, high = (_value(name, end) for end in (profile.low, profile.high))
    faults = [*_classes(examined, known), *_bent(examined), *_outside(examined, equal)]
    if scatter > LIKE:
        faults.append(f"needles differ by {scatter:.2g} times what the profile's noise allows")
    return Judgement(
        name=name,
        flat=profile.flat,
        determined=_by_profile(examined, known[1]) == 2,
        interval=(low, high),
        says=_says(examined, low, high),
        agreement="; ".join(faults) if faults else AGREE,
    )


def is_small(name: str, sd: float, prior_sd: float) -> bool:
    """Return whether a parameter with this deviation is told by the data, not by its prior."""
    return sd < (SD_LOG if in_logarithm(name) else SD_ALPHA) and sd < NARROWED * prior_sd


def unlike(agreement: str, expected: float, sampled: float) -> str:
    """Return the sentence on agreement, with what the draws contract to where the information says else."""
    if 1 / LIKE < sampled / expected < LIKE:
        return agreement
    said = f"the draws contract to {sampled:.2g} of the prior, the information says {expected:.2g}"
    return said if agreement == AGREE else f"{agreement}; {said}"


def known_words(name: str, sd: float) -> str:
    """Return in words how well a parameter is known whose coordinate has this deviation."""
    return precision_words(sd, in_logarithm(name)) if math.isfinite(sd) else "not at all"


def _says(examined: Examined, low: float, high: float) -> str:
    profile = examined.profile
    if profile.flat:
        said = _flat(examined)
    elif profile.closed:
        said = f"{_print(low)} to {_print(high)} (95 %)"
    else:
        said = f"not identifiable: {_open(examined, low, high)}"
    return said + (f"; its profile has {profile.minima} minima" if profile.minima > 1 else "")


def _flat(examined: Examined) -> str:
    low, high = (_value(examined.name, end) for end in examined.bounds)
    moved = examined.tip_moves
    tip = "" if moved is None else f" and no tip moves by more than {_small(moved)} mm"
    return (
        f"not identifiable: over its whole range, {_print(low)} to {_print(high)}, the deviance rises by "
        f"{_small(examined.profile.rise)}{tip}"
    )


def _open(examined: Examined, low: float, high: float) -> str:
    """Return an interval that does not end on both sides."""
    sides = list(zip(("above", "below"), (low, high), examined.profile.ends, strict=True))
    parts = [f"{side} {_print(value)} (95 %)" for side, value, end in sides if end == "closed"]
    parts += [f"open at its bound {_print(value)}" for _, value, end in sides if end == "bound"]
    parts += [f"no solution was found beyond {_print(value)}" for _, value, end in sides if end == "lost"]
    return ", ".join(parts)


def _classes(examined: Examined, known: tuple[float, float]) -> list[str]:
    """Return where information and profile do not come to the same conclusion."""
    name, (sd, prior_sd) = examined.name, known
    by_profile = _by_profile(examined, prior_sd)
    by_information = 0 if sd > NOTHING * prior_sd else 2 if is_small(name, sd, prior_sd) else 1
    if by_profile == by_information:
        return []
    words = ("not at all", "in part", "determined")
    return [f"by the information {words[by_information]}, by the profile {words[by_profile]}"]


def _by_profile(examined: Examined, prior_sd: float) -> int:
    """Return what the profile says: 0 nothing, 1 something, 2 that the parameter is determined."""
    profile = examined.profile
    sd = (profile.high - profile.low) / (2 * NORMAL * LIKE)
    return 0 if profile.flat else 2 if profile.closed and is_small(examined.name, sd, prior_sd) else 1


def _bent(examined: Examined) -> list[str]:
    """Return where the profile's interval is not the one that the information implies."""
    profile = examined.profile
    half = NORMAL * profile.sd
    reaches = (("below", profile.best - profile.low), ("above", profile.high - profile.best))
    said = []
    for (side, reach), end in zip(reaches, profile.ends, strict=True):
        if end == "closed" and math.isfinite(half) and not 1 / LIKE < max(reach, 1e-9) / half < LIKE:
            ratio = max(reach / half, half / max(reach, 1e-9))
            said.append(f"{ratio:.2g} times {'wider' if reach > half else 'narrower'} {side}")
    return [f"the profile is {' and '.join(said)} than the information says"] if said else []


def _outside(examined: Examined, equal: tuple[float, float] | None) -> list[str]:
    profile = examined.profile
    if equal is None or (equal[0] >= profile.low - 1e-6 and equal[1] <= profile.high + 1e-6):
        return []
    low, high = (_value(examined.name, end) for end in equal)
    return [f"equally good starts end outside its interval, {_print(low)} to {_print(high)}"]


def _small(value: float) -> str:
    return "less than 1e-4" if value < 1e-4 else f"{value:.2g}"


def _print(value: float) -> str:
    """Return three digits: 2.13e5, not 2.13e+05."""
    mantissa, e, exponent = f"{value:.3g}".partition("e")
    return f"{mantissa}{e}{int(exponent)}" if e else mantissa


def _value(name: str, coordinate: float) -> float:
    return math.exp(coordinate) if in_logarithm(name) else coordinate
