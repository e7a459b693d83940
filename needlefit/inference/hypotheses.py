"""What may have happened to a needle, or to all alike: a table of hypotheses, of which the best is found.

Each says how an insertion may have been, by a small change with at most two numbers: a size that is fitted,
and a choice, such as another needle; and along which axis. A further hypothesis is one row.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from needlefit.datasets.compared import MIN_LOG_ODDS
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import find_length_tolerance
from needlefit.inference.likelihood.nodes import enforce_order

#: smallest log odds that something happened to a needle: 150 are very strong evidence (Kass and Raftery). Of
#: 101 sound sets of benchmarks/mistakes.py none has more than -0.9; of 17 needles scaled or turned 16 have 12
HAPPENED_LOG_ODDS = math.log(150.0)
#: largest distance, in SDs, within which a needle lies as predicted: one of 40 sound ones is farther
PREDICTED_SD = 2.0
#: logarithm of the odds that a fitted number costs, Occam's factor: it is known to about 1 % of its range
LOG_FITTED = math.log(100.0)
START_SIZES = 7  #: number of sizes, over the range, from which the search of a size begins
SEARCH_STEPS = 5  #: number of steps of that search, by parabolas
SIZE_TOLERANCE = 1e-3  #: tolerance of a size, as a fraction of its range
IN_PLANE, ASIDE = 1, 2  #: axes of a needle's frame across it: in the plane of its bevel, and out of it


class Deviation(NamedTuple):
    """How far needles lie from their prediction, in SDs, and the log density of what was measured."""

    sds: float
    log_density: float
    misfit: float = 1.0  #: mean squared residual, by which differences of log densities are divided


class Hypothesis(NamedTuple):
    """How an insertion may have been: what is changed, by a size, along an axis and by what is chosen."""

    change: Callable[[Insertion, float, int, Any], Insertion]
    sizes: tuple[float, float] | None = None  #: range of the number that is fitted
    axes: tuple[int, ...] = (IN_PLANE,)  #: along which it may be; one out of the plane is seen in space alone
    #: the insertion, all others, the axis -> by its name what may be chosen
    list_choices: Callable[[Insertion, Sequence[Insertion], int], Mapping[str, Any]] = lambda *_: {"": None}
    #: by which the volume of what was measured grows, by the size and the number of residuals
    log_volume: Callable[[float, float], float] = lambda size, count: 0.0
    reaches_tip: bool = True  #: whether the points do
    changes_model: bool = False  #: whether another needle is simulated
    is_mistake: bool = True  #: in data, which is named; else it competes with these alone
    report: Callable[[float], float] = float  #: the size -> the number that is reported
    common_sizes: tuple[float, ...] = ()  #: by which all needles alike may be changed so, mm or degrees


class Change(NamedTuple):
    """A hypothesis with its axis and choice."""

    cause: str  #: a key of `HYPOTHESES`
    axis: int = IN_PLANE
    where: str = ""  #: what was chosen: the number of a point or boundary, or another needle
    choice: Any = None
    starts: Collection[float] = (0.0,)  #: sizes from which the search begins
    units: Collection[float] = ()  #: sizes that cost the choice among them alone
    cost: float = 0.0  #: of its numbers, as log odds

    @property
    def row(self) -> Hypothesis:
        """What may have happened."""
        return HYPOTHESES[self.cause]

    def apply(self, insertion: Insertion, size: float) -> Insertion:
        """Return the insertion as it may have been."""
        return self.row.change(insertion, size, self.axis, self.choice)

    def compute_odds(self, size: float, left: Deviation) -> float:
        """Return log odds that count the numbers that were fitted."""
        cost = math.log(len(self.units)) if size in self.units else self.cost
        return left.log_density / left.misfit - cost


#: a change -> deviations of needles changed so, by size, and the SD of the likeliest size
Search = Callable[[Change], tuple[dict[float, Deviation], float]]


class Explanation(NamedTuple):
    """What may have happened to a needle, or to all."""

    change: Change
    size: float  #: ln of a factor, mm or degrees; 0 where none is fitted
    sd: float  #: of the size
    sds: float  #: how far the needle then lies from its prediction, in SDs
    log_odds: float  #: that something happened
    #: whether that is far more probable than nothing, its size is known, and nothing else explains the
    #: measured points nearly as well
    is_clear: bool = False

    def describe(self) -> dict[str, Any]:
        """Return what `DoubtMetadata` states of it."""
        change = self.change
        about = {"cause": change.cause, "aside": change.axis == ASIDE, "where": change.where}
        if change.row.sizes:
            about |= {"size": change.row.report(self.size), "sd": self.sd}
        if change.cause == "boundary":
            number, deepest = change.choice
            about["stated"] = float(deepest.boundaries[number])
        return about


def _turn(insertion: Insertion, degrees: float, axis: int, _: None) -> Insertion:
    slope = math.tan(math.radians(degrees)) * np.eye(3)[axis]
    return insertion.map_points(lambda points: points - points[:, :1] * slope)


def _shift(insertion: Insertion, size: float, axis: int, first: int | None) -> Insertion:
    shift, begin = size * np.eye(3)[axis], insertion.points[first, 0] if first else -math.inf
    return insertion.map_points(lambda points: points - np.outer(points[:, 0] >= begin, shift))


def _give_way(insertion: Insertion, size: float, axis: int, first: None) -> Insertion:
    return _shift(insertion, insertion.side * size, axis, first)


def _find_step(insertion: Insertion, _: Sequence[Insertion], axis: int) -> dict[str, int]:
    """Return the point, from 0, with which a needle steps aside most beside its course, by its number."""
    gaps = np.diff(insertion.points[:, axis])
    if len(gaps) < 3:
        return {}
    first = 2 + int(np.argmax(np.abs(gaps[1:-1] - (gaps[:-2] + gaps[2:]) / 2)))
    return {str(first + 1): first}


def _find_tip(insertion: Insertion, *_: Any) -> dict[str, int]:  # noqa: ANN401 - others and axis
    """Return the last point, from 0, by its number; none of few. Neighbours tell which other point is off."""
    count = len(insertion.points)
    return {str(count): count - 1} if count > 3 else {}


def list_boundaries(
    insertion: Insertion, others: Sequence[Insertion], _: int = IN_PLANE
) -> dict[str, tuple[int, Insertion]]:
    """Return by its number each boundary that any needle reached, from 0, and one that reached all."""
    deepest = max((insertion, *others), key=lambda one: len(one.boundaries))
    return {str(k + 1): (k, deepest) for k in range(len(deepest.boundaries))}


def _move_boundary(insertion: Insertion, size: float, _: int, choice: tuple[int, Insertion]) -> Insertion:
    """Return an insertion with a boundary moved, also if it did not reach it."""
    number, deepest = choice
    own = insertion.boundaries
    boundaries = np.append(own, deepest.boundaries[len(own) : number + 1])
    moved = enforce_order(boundaries + size * (np.arange(len(boundaries)) == number))
    sequence = (*insertion.sequence, *deepest.sequence[len(own) + 1 : len(moved) + 1])
    return replace(insertion, boundaries=moved, sequence=sequence)


def _list_deeper(insertion: Insertion, others: Sequence[Insertion], _: int) -> dict[str, Insertion]:
    """Return the needles that are as deep as the points of one are long, or deeper."""
    length = insertion.measure_arc("plane")[-1]
    return {other.id: other for other in others if other.depth + find_length_tolerance(other.depth) >= length}


def _take_points(insertion: Insertion, _: float, __: int, other: Insertion) -> Insertion:
    """Return another insertion with the points of one."""
    pasted = replace(other, sd=insertion.sd).with_points(insertion.points)
    return replace(pasted, sections=insertion.sections)


# hypotheses by cause. A needle whose last part and depth were left out lies as predicted, within 3 SD at 0.02
# mm of noise: the shape that is left is nearly that at the smaller depth
HYPOTHESES: Mapping[str, Hypothesis] = {
    "mirrored": Hypothesis(lambda insertion, *_: insertion.map_points(lambda points: points * [1, -1, 1])),
    "exchanged_axes": Hypothesis(
        lambda insertion, *_: insertion.map_points(lambda points: points[:, [0, 2, 1]]), axes=(ASIDE,)
    ),
    "scaled": Hypothesis(
        lambda insertion, size, *_: insertion.map_points(lambda points: points / [1, math.exp(size), 1]),
        (math.log(0.05), math.log(20.0)),
        report=math.exp,
        log_volume=lambda size, count: -count * size,
    ),
    "turned": Hypothesis(_turn, (-15.0, 15.0), (IN_PLANE, ASIDE), common_sizes=(-5.0, 0.0, 5.0)),
    "shifted": Hypothesis(_shift, (-20.0, 20.0), (IN_PLANE, ASIDE), common_sizes=(-5.0, 0.0, 5.0)),
    # a guide, or soft tissue at the entry, gives way toward the bevel
    "given_way": Hypothesis(_give_way, axes=(), is_mistake=False, common_sizes=(0.0, 2.5, 5.0)),
    "stepped": Hypothesis(_shift, (-20.0, 20.0), (IN_PLANE, ASIDE), _find_step),
    # an entry that gave way would look like a first point that is off
    "tip_off": Hypothesis(_shift, (-20.0, 20.0), (IN_PLANE, ASIDE), _find_tip),
    "boundary": Hypothesis(_move_boundary, (-30.0, 30.0), list_choices=list_boundaries, changes_model=True),
    "of_another": Hypothesis(_take_points, list_choices=_list_deeper, reaches_tip=False, changes_model=True),
}


def list_changes(insertion: Insertion, others: Sequence[Insertion], directions: int) -> Iterator[Change]:
    """Yield what may have happened to a needle alone."""
    for cause, row in HYPOTHESES.items():
        starts = (0.0,) if row.sizes is None else tuple(np.linspace(*row.sizes, START_SIZES).tolist())
        for axis in (axis for axis in row.axes if axis <= directions):
            choices = row.list_choices(insertion, others, axis)
            for where, choice in choices.items():
                is_fitted = row.sizes is not None or where != ""
                cost = LOG_FITTED + math.log(len(choices)) if is_fitted else 0.0
                yield Change(cause, axis, where, choice, starts, (), cost)


def explain(
    changes: Iterable[Change], search: Search, nothing: float, least: float = HAPPENED_LOG_ODDS
) -> Explanation | None:
    """Return what explains the needles best, if they then lie as predicted.

    `nothing`: log odds that nothing happened, which is one of the hypotheses. `least`: log odds from which on
    something did.
    """
    rows = list[Explanation]()
    for change in changes:
        deviations, sd = search(change)
        odds = {size: change.compute_odds(size, left) - nothing for size, left in deviations.items()}
        size = max(odds, key=lambda size: odds[size])
        # another unit is the usual mistake: any other size must be far more probable than that
        units = {unit: odds[unit] for unit in change.units if odds[unit] > odds[size] - MIN_LOG_ODDS}
        size = max(units, key=lambda unit: units[unit], default=size)
        sd *= math.sqrt(deviations[size].misfit)
        rows.append(Explanation(change, size, sd, deviations[size].sds, odds[size]))
    right = [row for row in rows if math.isfinite(row.sds)]
    best = max(right, key=lambda row: row.log_odds, default=None)
    if best is None or best.sds > PREDICTED_SD:
        return None
    # of other causes those that can be; of the same one also what cannot be: then another number is wrong
    others = [row for row in rows if (row.change.cause == best.change.cause) == math.isinf(row.sds)]
    other = max((row.log_odds for row in others), default=0.0)
    is_sized = len(best.change.starts) == 1 or math.isfinite(best.sd)
    is_clear = best.log_odds >= max(least, other + MIN_LOG_ODDS)
    return best._replace(is_clear=is_sized and is_clear)


def search_sizes(
    measure: Callable[[Sequence[float]], Sequence[Deviation]], starts: Collection[float]
) -> tuple[dict[float, Deviation], float]:
    """Return deviations by size, also near the likeliest, and the SD of that: of the last parabola.

    The SD is infinite where the likeliest size lies at an end of the range.
    """
    begin = sorted(starts, key=abs)
    found = dict(zip(begin, measure(begin), strict=True))
    sd = math.inf
    for _ in range(SEARCH_STEPS if len(found) > 2 else 0):
        sizes = sorted(found)
        values = [found[size].log_density for size in sizes]
        peak = int(np.clip(np.argmax(values), 1, len(sizes) - 2))
        three = np.array(sizes[peak - 1 : peak + 2])
        square, slope, _ = np.polyfit(three, values[peak - 1 : peak + 2], 2)
        if not square < 0:
            break
        sd, vertex = float(1 / math.sqrt(-2 * square)), float(-slope / (2 * square))
        is_near = np.min(np.abs(three - vertex)) < SIZE_TOLERANCE * (sizes[-1] - sizes[0])
        if not sizes[0] < vertex < sizes[-1]:
            sd = math.inf
        if not three[0] < vertex < three[-1] or is_near:
            break
        (found[vertex],) = measure([vertex])
    return found, sd
