"""Find needles that a fit to the others does not predict, and name what may have happened to each.

Every needle is predicted from the others: by the fit without it, linear in the parameters, in the stated
covariance. Needles of a medium differ besides by nature: by as much as makes the others most probable, with
their misfit for scale, so that a model that fits none of them well accuses none. What may have happened to an
odd needle is a table of changes of its points (`HYPOTHESES`): the one that explains it is named, if it does.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.identifiability.precision import prior_information
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import NeedleDoubtMetadata

MIN_NEEDLES = 4  #: from so many on one is predicted from the others
MAX_ODD_PART = 0.25  #: part of the needles beyond which the model does not fit, and none is accused
#: distance of an odd needle from its prediction, in SDs, as of all outliers that are named
MIN_ODD_SD = 5.0
MAX_EXPLAINED_SD = 2.0  #: of the deviation that is left of a needle that a hypothesis explains
MIN_LOG_ODDS = 3.0  #: by which the best hypothesis must be more probable than the next, a factor of 20
#: SDs of the moduli between needles, of ln; specimens of one medium differ by up to 40 %
SPREADS = (0.03, 0.1, 0.2, 0.4)
BEVEL_PART = 1 / 3  #: of this SD that the bevel has: all needles have the same
QUANTILE = 0.75  #: of the misfits of the others, that is the scale
GRID_SIZES = 9  #: numbers of a hypothesis from which its search begins
MAX_STEPS, MAX_STEP = 8, 1.0  #: of the search without odd needles, and of its coordinates


class Block(NamedTuple):
    """Residuals (R,) of one needle at some theta, of unit variance, and their derivatives (R, P)."""

    residuals: Floats
    slope: Floats


class Prediction(NamedTuple):
    """What the others predict of theta in one needle: its mean (P,) and covariance (P, P)."""

    theta: Floats
    covariance: Floats
    scale: float = 1.0  #: of their squared misfits


Change = Callable[[Floats, float], Floats]  #: points (N, 3) and a size -> points as they may have been


class Hypothesis(NamedTuple):
    """What may have happened to the points of a needle."""

    change: Change
    sizes: tuple[float, float] | None = None  #: range of the number that is fitted
    log_volume: Callable[[float, int], float] = lambda size, count: 0.0  #: by which the data's volume grows
    in_space: bool = False  #: whether it is seen along z alone


def _turn(points: Floats, degrees: float, *toward: int) -> Floats:
    return points - math.tan(math.radians(degrees)) * points[:, :1] * np.array(toward)


#: by cause
HYPOTHESES: Mapping[str, Hypothesis] = {
    "mirrored": Hypothesis(lambda points, _: points * [1, -1, 1]),
    "exchanged_axes": Hypothesis(lambda points, _: points[:, [0, 2, 1]], in_space=True),
    "scaled": Hypothesis(
        lambda points, size: points / [1, math.exp(size), 1],
        (math.log(0.05), math.log(20.0)),
        lambda size, count: -count * size,
    ),
    "turned": Hypothesis(lambda points, size: _turn(points, size, 0, 1, 0), (-15.0, 15.0)),
    "turned_aside": Hypothesis(
        lambda points, size: _turn(points, size, 0, 0, 1), (-15.0, 15.0), in_space=True
    ),
    "shifted": Hypothesis(lambda points, size: points - [0, size, 0], (-20.0, 20.0)),
    "shifted_aside": Hypothesis(lambda points, size: points - [0, 0, size], (-20.0, 20.0), in_space=True),
}


def find_doubts(problem: Problem, theta: Floats) -> list[NeedleDoubtMetadata]:
    """Return the needles that a fit to the others does not predict, the oddest first.

    `theta` (P,): the fit to all. None where nothing can be said: of few needles, of tip tracks, without
    stated noise; or where more than a quarter of the needles deviate.
    """
    every = problem.insertions
    if len(every) < MIN_NEEDLES or not problem.dataset.noise_is_stated or problem.dataset.pose == "tracker":
        return []
    odd, fitted = list[int](), theta
    while True:
        rest = [k for k in range(len(every)) if k not in odd]
        theta = refit(problem, rest, theta) if odd else theta
        blocks = [_linearize(problem, one, theta) for one in every]
        weighed = _weigh_all(problem, blocks)
        found = {k: _predict(problem, [j for j in rest if j != k], weighed, theta) for k in range(len(every))}
        sds = {k: _measure(blocks[k], theta, found[k]).sds for k in range(len(every))}
        worst = max(rest, key=lambda k: sds[k])
        if sds[worst] < MIN_ODD_SD:
            break
        odd.append(worst)
        if len(odd) > MAX_ODD_PART * len(every):
            return []
    with_it, without_it = _list_values(problem, fitted), _list_values(problem, theta)
    doubts = []
    for k in sorted((k for k in odd if sds[k] >= MIN_ODD_SD), key=lambda k: -sds[k]):
        cause, size = _find_cause(problem, every[k], theta, found[k])
        about = {"insertion": every[k].id, "sds": sds[k], "cause": cause, "size": size}
        doubts.append(NeedleDoubtMetadata(**about, with_it=with_it, without_it=without_it))
    return doubts


def _list_values(problem: Problem, theta: Floats) -> dict[str, float]:
    """Return the free moduli and the bevel's parameter, Pa and mm."""
    names = [name for name in problem.names if name.startswith("mu") or name in BEVEL_PARAMETERS]
    values = problem.values(theta)
    return {name: values[name] for name in names}


def _linearize(problem: Problem, insertion: Insertion, theta: Floats) -> Block:
    """Return the residuals of one needle by itself, without the prior's."""
    alone = replace(problem, insertions=(insertion,))
    residuals, slope = alone.jacobian(theta)
    count = sum(alone.density.residual_counts)
    return Block(residuals[:count], slope[:count])


def _list_spreads(problem: Problem) -> Floats:
    """Return the SD (P,) of each parameter between needles, over that of the moduli."""
    return np.array([BEVEL_PART if name in BEVEL_PARAMETERS else 1.0 for name in problem.names])


class Weighed(NamedTuple):
    """A block with the differences between needles in its covariance (R, R)."""

    block: Block
    covariance: Floats
    information: Floats  #: (P, P)
    pull: Floats  #: (P,)


def _weigh(block: Block, spread: Floats) -> Weighed:
    """Return a block with differences between needles, of these SDs (P,)."""
    loaded = block.slope * spread
    covariance = np.eye(len(loaded)) + loaded @ loaded.T
    solved = np.linalg.solve(covariance, np.column_stack([block.slope, block.residuals]))
    both = block.slope.T @ solved
    return Weighed(block, covariance, both[:, :-1], both[:, -1])


#: by the SDs (P,) between needles, all blocks
WeighedBlocks = Sequence[tuple[Floats, Sequence[Weighed]]]


def _weigh_all(problem: Problem, blocks: Sequence[Block]) -> WeighedBlocks:
    spreads = [size * _list_spreads(problem) for size in SPREADS]
    return [(spread, [_weigh(block, spread) for block in blocks]) for spread in spreads]


def _predict(problem: Problem, places: Sequence[int], weighed: WeighedBlocks, theta: Floats) -> Prediction:
    """Return what some needles predict of another, linear about `theta`, with their likeliest spread."""
    best: tuple[float, Prediction] | None = None
    for spread, every in weighed:
        some = [every[k] for k in places]
        precision = prior_information(problem) + sum(one.information for one in some)
        step = -np.linalg.solve(precision, sum(one.pull for one in some))
        covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
        evidence, misfits = -0.5 * np.linalg.slogdet(precision)[1], []
        for one in some:
            off = one.block.residuals + one.block.slope @ step
            misfits.append(float(off @ np.linalg.solve(one.covariance, off)) / len(off))
            evidence -= 0.5 * (misfits[-1] * len(off) + np.linalg.slogdet(one.covariance)[1])
        scale = max(1.0, float(np.quantile(misfits, QUANTILE)))
        found = Prediction(theta + step, covariance + np.diag(spread**2), scale)
        if best is None or evidence > best[0]:
            best = evidence, found
    assert best is not None
    return best[1]


class Deviation(NamedTuple):
    """How far a needle lies from its prediction, in SDs, and the log density of its points."""

    sds: float
    log_density: float


def _measure(block: Block, theta: Floats, predicted: Prediction) -> Deviation:
    """Return how far a needle lies from what is predicted, given its residuals at `theta` (P,).

    The squared distance is chi-square; its cube root is nearly normal (E. B. Wilson, M. M. Hilferty, Proc.
    Natl. Acad. Sci. 17 (1931) 684).
    """
    off = block.residuals + block.slope @ (predicted.theta - theta)
    covariance = np.eye(len(off)) + block.slope @ predicted.covariance @ block.slope.T
    covariance *= predicted.scale
    square, count = float(off @ np.linalg.solve(covariance, off)), len(off)
    shape = 2 / (9 * count)
    sds = ((square / count) ** (1 / 3) - (1 - shape)) / math.sqrt(shape)
    return Deviation(sds, -0.5 * (square + float(np.linalg.slogdet(covariance)[1])))


def refit(problem: Problem, places: Sequence[int], theta: Floats) -> Floats:
    """Return the fit (P,) to some of the needles, from a fit `theta` (P,) to all."""
    spread = SPREADS[0] * _list_spreads(problem)

    def weigh(at: Floats) -> tuple[float, Floats, Floats]:
        blocks = [_linearize(problem, problem.insertions[k], at) for k in places]
        total, precision, pull = 0.0, prior_information(problem), np.zeros(len(at))
        for block in blocks:
            one = _weigh(block, spread)
            total += 0.5 * float(block.residuals @ np.linalg.solve(one.covariance, block.residuals))
            precision, pull = precision + one.information, pull + one.pull
        return total, precision, pull

    damping, (total, precision, pull) = 1e-3, weigh(theta)
    for _ in range(MAX_STEPS):
        step = -np.linalg.solve(precision + damping * np.diag(np.diag(precision)), pull)
        new = np.clip(theta + np.clip(step, -MAX_STEP, MAX_STEP), problem.lower, problem.upper)
        found = weigh(new)
        if found[0] < total:
            gain, damping = total - found[0], damping / 5
            theta, (total, precision, pull) = new, found
            if gain < 0.05:
                break
        else:
            damping *= 10
    return theta


# ---- what may have happened


def _find_cause(
    problem: Problem, insertion: Insertion, theta: Floats, predicted: Prediction
) -> tuple[str, float | None]:
    """Return the hypothesis that explains a needle, with its fitted number; "" if none does alone."""
    rows = sorted(_list_explanations(problem, insertion, theta, predicted), key=lambda row: -row[0])
    if not rows:
        return "", None
    (best, deviation, cause, size), *others = rows
    others = [row for row in others if row[2].partition("_")[0] != cause.partition("_")[0]]
    if deviation > MAX_EXPLAINED_SD or (others and best - others[0][0] < MIN_LOG_ODDS):
        return "", None
    return cause, size


def _list_explanations(
    problem: Problem, insertion: Insertion, theta: Floats, predicted: Prediction
) -> Iterator[tuple[float, float, str, float | None]]:
    """Yield of each hypothesis its log density, the deviation that is left, its name and number."""
    count = len(insertion.points)

    def measure(points: Floats, log_volume: float) -> tuple[float, float]:
        changed = _change_points(insertion, points)
        found = _measure(_linearize(problem, changed, theta), theta, predicted)
        return found.log_density + log_volume, found.sds

    for cause, row in HYPOTHESES.items():
        if row.in_space and problem.dataset.directions == 1:
            continue
        if row.sizes is None:
            yield (*measure(row.change(insertion.points, 0.0), 0.0), cause, None)
            continue

        def cost(size: float, row: Hypothesis = row) -> float:
            return -measure(row.change(insertion.points, size), row.log_volume(size, count))[0]

        grid = np.linspace(*row.sizes, GRID_SIZES)
        at = int(np.clip(np.argmin([cost(size) for size in grid]), 1, len(grid) - 2))
        between = (grid[at - 1], grid[at + 1])
        size = float(minimize_scalar(cost, bounds=between, method="bounded").x)
        # the fitted number takes a part of what it may be: Occam's factor, as of 1 % of the range
        density, left = measure(row.change(insertion.points, size), row.log_volume(size, count))
        yield density - math.log(100.0), left, cause, size


def _change_points(insertion: Insertion, points: Floats) -> Insertion:
    """Return an insertion as if its points were `points` (N, 3), with the errors that it has."""
    world = insertion.frame.to_world(points)
    return replace(insertion, points=points, centerline=world, sections=None)
