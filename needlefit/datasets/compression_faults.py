"""What can be wrong with the loading of one specimen, and where its loading ends."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.faults import Fault

Floats = NDArray[np.float64]

FEWEST = 6
"""Different stretches of a loading, at least: two are spent on mu and alpha."""

ABOVE_ONE = 2e-3
"""Stretches may lie this far from 1 unloaded: the zero of a machine is not exact."""

A_TURN = 0.05
"""A way back longer than this part of the whole range is a turn of the machine, not noise."""

PRELOAD = 0.03
"""A stress at stretch 1 above this part of the largest is told: mu and alpha have to bend to it."""

OTHER_SIGN = 0.05
"""Stresses of the other sign larger than this part of the largest are no noise about zero."""


def stretch_faults(stretch: Floats, stress: Floats, where: str, name: str) -> Iterator[Fault]:
    """Say why these numbers (N,) are no stretches in compression."""
    low, high = float(stretch.min()), float(stretch.max())
    here = f"stretch of specimen {name} goes from {low:g} to {high:g}"
    expected = "height now over height before: 1 unloaded, falling to e.g. 0.8"
    if high > 3:
        yield Fault(where, f"{here}: this looks like percent", expected, "divide the column by 100")
    elif _rests_at_zero(stretch, stress) and high < 1 + ABOVE_ONE:
        fix = "stretch = 1 - strain, where the strain is positive in compression"
        yield Fault(
            where, f"{here} and is about 0 where the stress is: this looks like strain", expected, fix
        )
    elif low <= 0:
        yield Fault(where, here, expected, "a height cannot reach 0: check height_mm, or the unit")
    elif low >= 1 - ABOVE_ONE and high <= 1 + ABOVE_ONE:
        yield Fault(
            where, f"{here}: it is hardly compressed", expected, "compress it further, or check the unit"
        )
    elif low >= 1 - ABOVE_ONE:
        fix = "measure in compression: the model's tissue is compressed only (stretch at most 1)"
        yield Fault(where, f"{here}: this is tension", expected, fix)
    elif high > 1 + ABOVE_ONE:
        fix = "keep the rows in compression; displacement_mm, if it is that, is positive toward the specimen"
        yield Fault(where, f"{here}: tension and compression in one test", expected, fix)


def stress_faults(stress: Floats, where: str, name: str) -> Iterator[Fault]:
    """Say why these numbers (N,) are no stresses of one sign."""
    low, high = float(stress.min()), float(stress.max())
    largest = max(abs(low), abs(high))
    if largest == 0:
        yield Fault(
            where, f"stress of specimen {name} is 0 throughout", "a measured stress", "check the column"
        )
    elif min(abs(low), abs(high)) > OTHER_SIGN * largest and low < 0 < high:
        yield Fault(
            where,
            f"stress of specimen {name} goes from {low:.3g} to {high:.3g} MPa, through zero",
            "one sign: all positive or all negative in compression",
            "remove the offset of the load cell, or the rows in which the specimen is pulled",
        )


def turns(stretch: Floats) -> list[int]:
    """Return the rows at which the machine turns round; noise is no turn."""
    wide = A_TURN * float(np.ptp(stretch))
    found, extreme, direction = [], 0, -1
    for n in range(1, len(stretch)):
        if direction * (stretch[n] - stretch[extreme]) > 0:
            extreme = n
        elif direction * (stretch[extreme] - stretch[n]) > wide:
            found.append(extreme)
            direction, extreme = -direction, n
    return found


def lost_work(stretch: Floats, stress: Floats, turn: int) -> float:
    """Return the part of the work of loading that the unloading after row `turn` does not give back."""
    back = slice(turn, None)
    low, high = float(stretch[turn]), min(float(stretch[: turn + 1].max()), float(stretch[back].max()))
    at = np.linspace(low, high, 200)
    loading, unloading = (
        np.trapezoid(np.interp(at, *_sorted(stretch[part], stress[part])), at)
        for part in (slice(0, turn + 1), back)
    )
    return float(1 - unloading / loading)


def preload(stretch: Floats, stress: Floats) -> float:
    """Return the stress that a loading, sorted (N,), has at stretch 1 already, as a part of its largest.

    A line through its first tenth says it; what begins far from 1 has none that could be told.
    """
    first = max(FEWEST, len(stretch) // 10)
    if abs(1 - stretch[0]) > ABOVE_ONE:
        return 0.0
    if np.ptp(stretch[:first]) == 0:  # the machine waited: there is no line through one stretch
        at_one = stress[:first].mean()
    else:
        _, at_one = np.polyfit(stretch[:first] - 1, stress[:first], 1)
    return float(at_one / np.max(np.abs(stress)))


def _sorted(stretch: Floats, stress: Floats) -> tuple[Floats, Floats]:
    order = np.argsort(stretch, kind="stable")
    return stretch[order], stress[order]


def _rests_at_zero(stretch: Floats, stress: Floats) -> bool:
    """Say whether the `stretch` of the least stressed row is nearer to 0 than to 1."""
    rest = abs(float(stretch[int(np.argmin(np.abs(stress)))]))
    return rest < 0.5
