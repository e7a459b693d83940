"""How fast this needle can be solved here, beside how seldom a hand asks for it."""

from time import perf_counter

from needlefit.mechanics.control import Step
from needlefit.mechanics.session import Session

LONG, OFTEN = 0.008, 3
"""Time of a trial, s, and how many there are: the fastest counts, as others on the machine only slow it."""


def sustained(session: Session, depth: float) -> float:
    """Return the steps a second that a needle makes about `depth` (mm) when nothing else is asked for.

    A step is what a frame asks for: the tip goes on by a constraint spacing, in and out by turns. Between the
    frames of a page the processor sleeps and forgets, and single steps take a few times as long.
    """
    other = session.copy()
    inputs, spacing = session.last, session.rules.spacing
    steps = [Step(place, inputs.bevel, inputs.controls) for place in (max(depth - spacing, 0.0), depth)]
    other.go(steps[1])
    return max(_trial(other, steps) for _ in range(OFTEN))


def _trial(session: Session, steps: list[Step]) -> float:
    before, began = session.solved, perf_counter()
    while (spent := perf_counter() - began) < LONG:
        for step in steps:
            session.go(step)
    return (session.solved - before) / spent
