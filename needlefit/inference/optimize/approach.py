"""The cheap way to where a search begins: down an easier goal first; starts that meet there go on as one.

With uncertain depths every needle is simulated many times. Depths taken as stated make a posterior whose
hills lie next to those of the whole one, at a fraction of the cost.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.inference.starts import INTERRUPTED, Start

SAME_VALUE, SAME_PLACE = 1e-3, 1e-2
"""Differences of the easier goal, and of every parameter of theta, up to which two ends are one."""


def leaders(ends: Sequence[Start]) -> dict[int, int]:
    """Return, by the index of each start, whose way it goes on: its own, or that of a better one it has met.

    An end without a finite value has met nobody.
    """
    chosen: dict[int, int] = {}
    first: list[Start] = []
    for end in sorted(ends, key=lambda s: (s.objective, s.index)):
        leader = next((other for other in first if _met(end, other)), end)
        chosen[end.index] = leader.index
        if leader is end:
            first.append(end)
    return chosen


def went_on(end: Start, led: Start) -> Start:
    """Return the whole search of the start whose approach is `end`, given what came of its leader's."""
    alone = led.index == end.index
    return replace(
        led,
        index=end.index,
        theta0=end.theta0,
        evaluations=end.evaluations + (led.evaluations if alone else 0),
        gradients=end.gradients + (led.gradients if alone else 0),
        failures=end.failures + (led.failures if alone else 0),
        failed=end.failed + (led.failed if alone else ()),
        joined=None if alone else led.index,
    )


def broken_off(end: Start, value: float) -> Start:
    """Return an approach as a search that was interrupted; `value` is the whole goal's at its end."""
    objective = value if math.isfinite(value) else math.inf
    return replace(end, objective=objective, evaluations=end.evaluations + 1, stopped=INTERRUPTED)


def _met(end: Start, other: Start) -> bool:
    if not math.isfinite(end.objective):
        return False
    apart = np.abs(np.subtract(end.theta, other.theta))
    return abs(end.objective - other.objective) < SAME_VALUE and bool(np.all(apart < SAME_PLACE))
