"""A scene's insertion as it goes on: what is seen on the way from one step's end to the next."""

import math
from collections.abc import Iterator
from itertools import pairwise

from needlefit.mechanics.control import Step
from needlefit.mechanics.scene import Scene, at_contact
from needlefit.mechanics.session import Moment
from needlefit.schemas.limits import MAX_SHOWN_POSITIONS


def strides(scene: Scene, stride: float = 0.5) -> Iterator[tuple[float, Moment]]:
    """Yield how far the tip has gone (mm, back and forth) and the needle, from first contact on.

    The depths of the steps are among the places where it is seen, the others at most `stride` mm apart, or
    farther where that would be more than `MAX_SHOWN_POSITIONS`; it ends before a stride that fails.
    """
    depths = [0.0, *(step.depth for step in scene.steps)]
    path = sum(abs(b - a) for a, b in pairwise(depths))
    stride = max(stride, path / MAX_SHOWN_POSITIONS)
    session = at_contact(scene, scene.lattice.first_cell)
    gone = 0.0
    yield gone, session.now
    for step in scene.steps:
        start = session.depth
        count = max(1, math.ceil(abs(step.depth - start) / stride))
        for n in range(1, count + 1):
            part = n / count
            depth = step.depth if n == count else start + part * (step.depth - start)
            if not session.go(Step(depth, step.bevel, step.controls)).converged:
                return
            yield gone + part * abs(step.depth - start), session.now
        gone += abs(step.depth - start)
