"""What may have happened to a needle: a table of hypotheses, of which the one that explains it is found.

Each says how the insertion may have been, by a small change with at most two numbers: a size that is fitted,
and a choice, such as another needle; and along which axis. A further hypothesis is one row.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from needlefit.datasets.compared import MIN_LOG_ODDS
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import find_length_tolerance
from needlefit.inference.likelihood.nodes import enforce_order

#: distance within which a needle lies as predicted: one of 40 sound ones is farther
PREDICTED_SD = 2.0
#: what a number costs, Occam's factor: one that is fitted is known to about 1 % of its range
LOG_FITTED = math.log(100.0)
SIZE_TOLERANCE = 1e-4  #: of a fitted number, as part of its range
GRID_SIZES = 7  #: numbers of a hypothesis from which its search begins
IN_PLANE, ASIDE = 1, 2  #: axes of a needle's frame across it: in the plane of its bevel, and out of it


class Deviation(NamedTuple):
    """How far a needle lies from its prediction, in SDs, and the log density of what was measured."""

    sds: float
    log_density: float


#: an insertion as it may have been, and whether its points reach the tip -> its deviation
Measure = Callable[[Insertion, bool], Deviation]


class Hypothesis(NamedTuple):
    """How an insertion may have been: what is changed, by a size, along an axis and by what is chosen."""

    change: Callable[[Insertion, float, int, Any], Insertion]
    sizes: tuple[float, float] | None = None  #: range of the number that is fitted
    axes: tuple[int, ...] = (IN_PLANE,)  #: along which it may be; one out of the plane is seen in space alone
    #: the insertion, all others, the axis -> by its name what may be chosen
    list_choices: Callable[[Insertion, Sequence[Insertion], int], Mapping[str, Any]] = lambda *_: {"": None}
    log_volume: Callable[[float, int], float] = lambda size, count: 0.0  #: by which the data's volume grows
    reaches_tip: bool = True  #: whether the points do


class Explanation(NamedTuple):
    """What may have happened to a needle."""

    cause: str = ""  #: a key of `HYPOTHESES`; "" where none explains the needle
    axis: int = IN_PLANE
    size: float | None = None  #: ln of a factor, mm or degrees
    where: str = ""  #: what was chosen: the number of a point or boundary, or another needle


def _turn(insertion: Insertion, degrees: float, axis: int, _: None) -> Insertion:
    slope = math.tan(math.radians(degrees)) * np.eye(3)[axis]
    return insertion.map_points(lambda points: points - points[:, :1] * slope)


def _shift(insertion: Insertion, size: float, axis: int, first: int | None) -> Insertion:
    shift, begin = size * np.eye(3)[axis], insertion.points[first, 0] if first else -math.inf
    return insertion.map_points(lambda points: points - np.outer(points[:, 0] >= begin, shift))


def _find_step(insertion: Insertion, _: Sequence[Insertion], axis: int) -> dict[str, int]:
    """Return the point, from 0, with which a needle steps aside most beside its course, by its number."""
    gaps = np.diff(insertion.points[:, axis])
    if len(gaps) < 3:
        return {}
    first = 2 + int(np.argmax(np.abs(gaps[1:-1] - (gaps[:-2] + gaps[2:]) / 2)))
    return {str(first + 1): first}


def _list_boundaries(insertion: Insertion, *_: object) -> dict[str, int]:
    return {str(k + 1): k for k in range(len(insertion.boundaries))}


def _move_boundary(insertion: Insertion, size: float, _: int, number: int) -> Insertion:
    moved = insertion.boundaries + size * (np.arange(len(insertion.boundaries)) == number)
    return replace(insertion, boundaries=enforce_order(moved))


def _list_deeper(insertion: Insertion, others: Sequence[Insertion], _: int) -> dict[str, Insertion]:
    """Return the needles that are as deep as the points of one are long, or deeper."""
    length = insertion.measure_arc("plane")[-1]
    return {other.id: other for other in others if other.depth + find_length_tolerance(other.depth) >= length}


def _take_points(insertion: Insertion, _: float, __: int, other: Insertion) -> Insertion:
    """Return another insertion with the points of one."""
    pasted = replace(other, sd=insertion.sd).with_points(insertion.points)
    return replace(pasted, sections=insertion.sections)


#: by cause
HYPOTHESES: Mapping[str, Hypothesis] = {
    "mirrored": Hypothesis(lambda insertion, *_: insertion.map_points(lambda points: points * [1, -1, 1])),
    "exchanged_axes": Hypothesis(
        lambda insertion, *_: insertion.map_points(lambda points: points[:, [0, 2, 1]]), axes=(ASIDE,)
    ),
    "scaled": Hypothesis(
        lambda insertion, size, *_: insertion.map_points(lambda points: points / [1, math.exp(size), 1]),
        (math.log(0.05), math.log(20.0)),
        log_volume=lambda size, count: -count * size,
    ),
    "turned": Hypothesis(_turn, (-15.0, 15.0), (IN_PLANE, ASIDE)),
    "shifted": Hypothesis(_shift, (-20.0, 20.0), (IN_PLANE, ASIDE)),
    "stepped": Hypothesis(_shift, (-20.0, 20.0), (IN_PLANE, ASIDE), _find_step),
    "boundary": Hypothesis(_move_boundary, (-30.0, 30.0), list_choices=_list_boundaries),
    "cut_short": Hypothesis(lambda insertion, *_: insertion, reaches_tip=False),
    "of_another": Hypothesis(_take_points, list_choices=_list_deeper, reaches_tip=False),
}


def explain(
    insertion: Insertion, others: Sequence[Insertion], measure: Measure, directions: int
) -> Explanation:
    """Return the hypothesis that explains a needle alone, and better than any other; else an empty one.

    One of them is that nothing happened to it, as it did to any of the others before.
    """
    as_measured = measure(insertion, True)
    nothing = (as_measured.log_density + math.log(1 + len(others)), as_measured.sds, Explanation())
    rows = [nothing, *_list_explanations(insertion, others, measure, directions)]
    (best, sds, explanation), *rest = sorted(rows, key=lambda row: -row[0])
    next_best = next(odds for odds, _, other in rest if other.cause != explanation.cause)
    return explanation if sds <= PREDICTED_SD and best - next_best >= MIN_LOG_ODDS else Explanation()


def _list_explanations(
    insertion: Insertion, others: Sequence[Insertion], measure: Measure, directions: int
) -> Iterator[tuple[float, float, Explanation]]:
    """Yield of each hypothesis its log odds, the deviation that is left, and what it says."""
    places = (
        (cause, row, axis) for cause, row in HYPOTHESES.items() for axis in row.axes if axis <= directions
    )
    for cause, row, axis in places:
        choices = row.list_choices(insertion, others, axis)
        for where, choice in choices.items():
            size, odds, sds = _fit(row, insertion, axis, choice, measure)
            if size is not None or where:
                odds -= LOG_FITTED + math.log(len(choices))
            yield odds, sds, Explanation(cause, axis, size, where)


def _fit(
    row: Hypothesis, insertion: Insertion, axis: int, choice: object, measure: Measure
) -> tuple[float | None, float, float]:
    """Return the size that is most probable, its log odds, and the deviation that is left."""

    def weigh(size: float) -> tuple[float, float]:
        left = measure(row.change(insertion, size, axis, choice), row.reaches_tip)
        return left.log_density + row.log_volume(size, len(insertion.points)), left.sds

    if row.sizes is None:
        return None, *weigh(0.0)
    size = _search(lambda size: -weigh(size)[0], row.sizes)
    odds, sds = weigh(size)
    return size, odds, sds


def _search(cost: Callable[[float], float], sizes: tuple[float, float]) -> float:
    """Return the size of least cost."""
    grid = np.linspace(*sizes, GRID_SIZES)
    lowest = int(np.clip(np.argmin([cost(size) for size in grid]), 1, len(grid) - 2))
    bounds, near = (float(grid[lowest - 1]), float(grid[lowest + 1])), SIZE_TOLERANCE * (sizes[1] - sizes[0])
    return float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": near}).x)
