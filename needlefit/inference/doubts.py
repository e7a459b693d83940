"""Find needles that a fit to the others does not predict, and name what may have happened to each, or to all.

The misfit of the others is the scale, so that a model that fits none of them well accuses none. What may have
happened to a needle is found in `hypotheses.py`; all alike may be turned or shifted.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Self

import numpy as np
from scipy.special import ndtr, ndtri, softmax

from needlefit.arrays import Bools, Floats
from needlefit.datasets.compared import MIN_LOG_ODDS, SIGNIFICANT_SD, leaves_plane
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.outlying_points import MAX_OUTLYING_PART, OUTLIER_SD
from needlefit.inference.fit import EvaluationRecorder
from needlefit.inference.hypotheses import (
    ASIDE,
    HAPPENED_LOG_ODDS,
    HYPOTHESES,
    IN_PLANE,
    LOG_FITTED,
    PREDICTED_SD,
    SEARCH_STEPS,
    START_SIZES,
    Change,
    Deviation,
    Explanation,
    explain,
    list_boundaries,
    list_changes,
    search_sizes,
)
from needlefit.inference.identifiability.information import (
    linearize,
    prior_and_noise_information,
    prior_information,
)
from needlefit.inference.least_squares import run_least_squares
from needlefit.inference.optimize import starting_points
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.inference.plausible import list_implausible
from needlefit.inference.posterior_density import KnownPoints
from needlefit.inference.problem import APPROACH_TOLERANCE, Problem, make_posterior_objective
from needlefit.project.callbacks import never_stop
from needlefit.project.unit_warnings import LENGTH_UNITS
from needlefit.schemas.run_metadata import DepthMetadata, DoubtMetadata

# ---- needles linearised each by itself about a fit, and what some of them predict of another
#
# The prediction is the fit to the others, linear in the parameters, in the stated covariance. Needles of a
# medium differ besides by nature, by a spread that they show themselves.


#: smallest number of needles of which one is predicted from the others; parameters take up what fewer show
MIN_NEEDLES = 4
#: SDs of ln moduli between needles: from one block of gel to biological tissue. The evidence of the needles
#: weights them; benchmarks/mistakes.py shows that with these no set without mistakes is warned about.
SPREADS = (0.03, 0.1, 0.2, 0.4)
#: SD of ln b between needles over that of their moduli: deflections grow with b, and with mu^(1/4) on an
#: elastic foundation
BEVEL_PART = 1 / 4
QUICK_STARTS = 3  #: number of starts of a quick fit, beside the middle of the prior
QUICK_EVALUATIONS = 60  #: largest number of evaluations of each search of a quick fit


class Blocks(NamedTuple):
    """The squared residuals of needles, each as a quadratic of theta about a fit.

    They are square + 2 pull t + t' information t at a distance t (P,) from it.
    """

    squares: Floats  #: (N,)
    pulls: Floats  #: (N, P)
    informations: Floats  #: (N, P, P)
    residual_counts: Floats  #: (N,)
    log_norms: Floats  #: (N,); of their Gaussians in what was measured

    def select(self, number: int) -> Self:
        """Return the block of one needle."""
        return type(self)(*(values[number : number + 1] for values in self))

    def measure(self, steps: Floats) -> Floats:
        """Return the squared residuals (K, N) at distances (K, P) from the fit."""
        bent = np.einsum("kp,npq,kq->kn", steps, self.informations, steps, optimize=True)
        return self.squares + 2 * steps @ self.pulls.T + bent

    def widen(self, covariance: Floats) -> Self:
        """Return the blocks of needles whose theta differs besides by this covariance (P, P)."""
        growth = np.eye(len(covariance)) + covariance @ self.informations
        inverse = np.linalg.inv(growth)
        moved = np.einsum("npq,np->nq", inverse, self.pulls)
        return self._replace(
            squares=self.squares - np.sum(moved @ covariance * self.pulls, axis=1),
            pulls=moved,
            informations=np.swapaxes(inverse, 1, 2) @ self.informations,
            log_norms=self.log_norms - 0.5 * np.linalg.slogdet(growth)[1],
        )


class Prediction(NamedTuple):
    """What some needles predict of theta in another: its mean (P,) and covariance (P, P)."""

    theta: Floats
    covariance: Floats
    scale: float  #: of their squared misfits
    log_density: float  #: of these needles and the prior, their differences integrated out
    chi_square: float  #: mean of their squared residuals

    def describes(self, residuals: float) -> bool:
        """Whether these needles lie as far from the fit as errors do, by so many residuals."""
        return self.chi_square <= 1 + PREDICTED_SD * math.sqrt(2 / residuals)


def fit_quickly(problem: Problem, *near: Floats) -> Floats:
    """Return a fit (P,) to all needles with depths as stated: the best of some searches, also from `near`."""
    rng = np.random.default_rng(0)
    drawn = starting_points(problem.lower, problem.upper, QUICK_STARTS, rng)
    starts = (*near, problem.parameters.expected, *drawn)
    ends = [refit(problem, problem.insertions, start) for start in starts]
    easier = problem.plain or problem
    return min(ends, key=lambda theta: -easier.log_posterior(theta))


def refit(problem: Problem, some: Sequence[Insertion], theta: Floats) -> Floats:
    """Return the fit (P,) to some of the needles, with depths as stated, from a fit `theta` (P,) to all."""
    part = replace(problem, insertions=tuple(some))
    goal = make_posterior_objective(part.plain or part, APPROACH_TOLERANCE)
    recorder = EvaluationRecorder(goal, QUICK_EVALUATIONS, never_stop)
    recorder.run(run_least_squares, theta)
    return theta if recorder.theta is None else recorder.theta


def linearize_needles(
    problem: Problem,
    insertions: Sequence[Insertion],
    theta: Floats,
    *,
    reaches_tip: bool = True,
    known: KnownPoints | None = None,
) -> Blocks:
    """Return the residuals of needles, each by itself, about `theta` (P,), without the prior's.

    They share neither layers nor bevels. Points that do not reach the tip lie at their own distances from
    the entry. `known`: as of `PosteriorDensity.differentiate_points`.
    """
    apart = tuple(replace(insertion, specimen=str(n)) for n, insertion in enumerate(insertions))
    likelihood = problem.likelihood.model_copy(update={"bevel_spread": 0.0})
    density = replace(problem, insertions=apart, likelihood=likelihood).density
    if not reaches_tip:
        cut = []
        for insertion, observation in zip(insertions, density.observations, strict=True):
            part = min(1.0, insertion.measure_arc(problem.dataset.compared)[-1] / insertion.depth)
            nodes = replace(observation.nodes, s=part * observation.nodes.s)
            cut.append(replace(observation, nodes=nodes))
        density = replace(density, observations=tuple(cut))
    values = problem.values(theta)
    points = density.differentiate_points(values, known)
    ((residuals, slopes),) = density.jacobians([values], points=points)
    ends = np.cumsum(density.residual_counts)
    pairs = zip(np.split(residuals, ends)[:-1], np.split(slopes, ends)[:-1], strict=True)
    squares, pulls, informations = zip(
        *((some @ some, slope.T @ some, slope.T @ slope) for some, slope in pairs), strict=True
    )
    log_norms = [observation.log_norm for observation in density.observations]
    counts = np.array(density.residual_counts, dtype=np.float64)
    return Blocks(np.array(squares), np.array(pulls), np.array(informations), counts, np.array(log_norms))


def predict_from(problem: Problem, blocks: Blocks, uses: Bools, theta: Floats) -> list[Prediction]:
    """Return what some needles predict of another, linear about `theta`, on the mean over their spread.

    By row of `uses` (K, N): from which of them.
    """
    (of_prior,) = problem.parameters.prior.log_density([problem.values(theta)])
    parts = np.array([BEVEL_PART if name in BEVEL_PARAMETERS else 1.0 for name in problem.names])
    by_spread = []
    for size in SPREADS:
        among = np.diag((size * parts) ** 2)
        wide = blocks.widen(among)
        precisions = prior_information(problem) + np.tensordot(uses, wide.informations, 1)
        covariances = np.linalg.inv(precisions)
        steps = -np.einsum("kpq,kq->kp", covariances, uses @ wide.pulls)
        squares = np.where(uses, wide.measure(steps), np.nan)
        sums = np.nansum(squares, axis=1)
        densities = of_prior + uses @ wide.log_norms - 0.5 * sums
        evidences = densities - 0.5 * np.linalg.slogdet(precisions)[1]  # all parameters integrated out
        misfits = squares / wide.residual_counts
        scales = np.maximum(1.0, np.nanquantile(misfits, 1 - MAX_OUTLYING_PART, axis=1))
        chi_squares = sums / (uses @ wide.residual_counts)
        by_spread.append((evidences, theta + steps, covariances + among, scales, densities, chi_squares))
    all_evidences, thetas, *others = map(np.array, zip(*by_spread, strict=True))
    weights = softmax(all_evidences, axis=0)
    mean, covariance, *rest = (np.einsum("sk,sk...->k...", weights, some) for some in (thetas, *others))
    covariance = covariance + np.einsum("sk,skp,skq->kpq", weights, thetas - mean, thetas - mean)
    return [Prediction(*row) for row in zip(mean, covariance, *rest, strict=True)]


def measure_deviations(blocks: Blocks, theta: Floats, predicted: Prediction) -> list[Deviation]:
    """Return how far needles lie from what is predicted of one, given their blocks about `theta` (P,).

    The squared distance is chi-square; its cube root is nearly normal (E. B. Wilson, M. M. Hilferty, Proc.
    Natl. Acad. Sci. 17 (1931) 684).
    """
    step, counts = predicted.theta - theta, blocks.residual_counts
    (squares,) = blocks.measure(step[None])
    moved = blocks._replace(squares=squares, pulls=blocks.pulls + blocks.informations @ step)
    widened = moved.widen(predicted.covariance)
    squares, shapes = widened.squares / predicted.scale, 2 / (9 * counts)
    sds = ((squares / counts) ** (1 / 3) - (1 - shapes)) / np.sqrt(shapes)
    densities = widened.log_norms - 0.5 * (squares + counts * math.log(predicted.scale))
    return [Deviation(*pair) for pair in zip(sds.tolist(), densities.tolist(), strict=True)]


# ---- what may have happened to all needles alike: they are turned, or shifted, or a boundary lies elsewhere
#
# A boundary that lies elsewhere changes the model: all needles are fitted again, and it is named only where
# errors alone are left, of parameters that a soft tissue and a bevel have. Where the law of the tissue is
# another, stiff layers and flat cuts may describe the needles; where the guide, or tissue at the entry, gave
# way toward the bevels, another boundary may: that is asked too, and not named.


#: smallest shift (mm) of a boundary that is named: beside one a needle bends over (EI / mu)^(1/4), 6 to 15
#: mm, and an error of the model looks like a shift by a part of it
MIN_SHIFT_MM = 5.0


def change_all(problem: Problem, change: Change, size: float) -> Problem:
    """Return the problem with all needles as they may have been."""
    return replace(problem, insertions=tuple(change.apply(one, size) for one in problem.insertions))


def find_common(problem: Problem, theta: Floats) -> Explanation | None:
    """Return what may have happened to all needles alike, if that makes them far more probable.

    `theta` (P,): the fit to them.
    """
    count = sum(problem.density.residual_counts)

    simulated = KnownPoints()  # of these needles: turns and shifts change what was measured alone

    def predict(changed: Problem, fitted: Floats, known: KnownPoints | None = None) -> Prediction:
        uses = np.ones((1, len(changed.insertions)), dtype=bool)
        blocks = linearize_needles(changed, changed.insertions, fitted, known=known)
        return predict_from(changed, blocks, uses, fitted)[0]

    before = predict(problem, theta, simulated)

    def search(change: Change) -> tuple[dict[float, Deviation], float]:
        """Search the size of what happened in turn with the other parameters.

        About a fit needles are linear in both; but for those that are simulated anew, each with its own fit.
        """
        fits, size, changes_model = {0.0: theta}, 0.0, change.row.changes_model
        nearby = simulated  # about the fit in use: of a needle 0.4 MB

        def measure(sizes: Sequence[float]) -> list[Deviation]:
            return [measure_one(size) for size in sizes]

        def measure_one(size: float) -> Deviation:
            changed, fitted = change_all(problem, change, size), fits[min(fits, key=lambda k: abs(k - size))]
            if changes_model:
                fitted = fits[size] = refit(changed, changed.insertions, fitted)
            after = predict(changed, fitted, None if changes_model else nearby)
            is_plausible = not list_implausible(problem.values(fitted), problem.medium.constraint_spacing_mm)
            is_right = not changes_model or (is_plausible and after.describes(count))
            gain = after.log_density - before.log_density
            return Deviation(0.0 if is_right else math.inf, gain, max(1.0, after.chi_square))

        for _ in range(SEARCH_STEPS):
            found, sd = search_sizes(measure, change.starts)
            likeliest = max(found, key=lambda k: found[k].log_density)
            gain, moved = found[likeliest].log_density, abs(likeliest - size)
            if changes_model or gain <= LOG_FITTED or moved < sd / 2:
                break
            # the fit to needles as measured may have ended far away
            fits = {likeliest: fit_quickly(change_all(problem, change, likeliest), fits[size])}
            size, nearby = likeliest, KnownPoints()
        return found, sd

    # of bevels that all face one way an error of the model looks like any change in their plane
    is_one_sided = len({insertion.side for insertion in problem.insertions}) == 1
    in_plane = () if is_one_sided else (*_list_poses(problem, IN_PLANE), *list_boundary_shifts(problem))
    aside = _list_poses(problem, ASIDE) if problem.dataset.directions == 2 else ()
    # of 147 sound sets of benchmarks/mistakes.py none has log odds above 0.7
    found = explain([*in_plane, *aside], search, 0.0, MIN_LOG_ODDS)
    if found is None or not found.is_clear or not found.change.row.is_mistake:
        return None
    stated_sd = max(insertion.boundary_sd for insertion in problem.insertions)
    least = max(MIN_SHIFT_MM, SIGNIFICANT_SD * max(stated_sd, found.sd))
    return found if not found.change.row.changes_model or abs(found.size) >= least else None


def _list_poses(problem: Problem, axis: int) -> Iterator[Change]:
    """Yield turns and shifts of all needles; shapes of unknown pose are aligned: they change nothing."""
    for cause, row in HYPOTHESES.items() if problem.dataset.pose != "free" else ():
        if row.common_sizes and (row.axes or axis == IN_PLANE):
            yield Change(cause, axis, starts=row.common_sizes, cost=LOG_FITTED)


def list_boundary_shifts(problem: Problem) -> Iterator[Change]:
    """Yield for each boundary that it lies elsewhere, between its neighbours, in all needles.

    None where depths are crossings of surfaces; with noise that is estimated any boundary describes needles.
    """
    first, *others = insertions = problem.insertions
    if problem.likelihood.noise_scale == "estimated" or any(insertion.surfaces for insertion in insertions):
        return
    boundaries = list_boundaries(first, others)
    for where, (number, deepest) in boundaries.items():
        ends = np.array([0.0, *deepest.boundaries, max(insertion.depth for insertion in insertions)])
        low, stated, high = ends[number : number + 3]
        # from these a search begins, too: on an even grid alone it ended in a local optimum, 8 mm off
        depths = [factor * stated for factor in LENGTH_UNITS.values()]
        units = {float(depth - stated) for depth in depths if stated < depth < high}
        evenly = np.linspace(low, high, START_SIZES)[1:-1] - stated
        cost = LOG_FITTED + math.log(len(boundaries))
        yield Change(
            "boundary", IN_PLANE, where, (number, deepest), {0.0, *units, *evenly.tolist()}, units, cost
        )


# ---- needles that a fit to the others does not predict

#: largest number of needles by which a change of all alike is searched: eight needles of
#: benchmarks/mistakes.py show it
COMMON_NEEDLES = 30


class Doubts(NamedTuple):
    """The needles that a fit to the others does not predict, the oddest first; names as of `FitMetadata`."""

    odd_needles: Sequence[DoubtMetadata] = ()
    #: how many of how many needles deviate, where so many do that the model does not fit
    deviating: tuple[int, int] | None = None
    common_doubt: DoubtMetadata | None = None  #: what may have happened to all needles alike
    #: why none was compared with the others: "few" needles, without "noise", out of their "plane", "unsolved"
    unjudged: str = ""


def find_doubts(problem: Problem, theta: Floats | None = None, *, seeks_common: bool = True) -> Doubts:
    """Return the needles that a fit to the others does not predict, and what happened to all if it is sought.

    `theta` (P,): the fit to all; None: a quick one.
    """
    insertions, count, dataset = problem.insertions, len(problem.insertions), problem.dataset
    if count < MIN_NEEDLES:
        return Doubts(unjudged="few")
    if not dataset.noise_is_stated:
        return Doubts(unjudged="noise")
    if dataset.compared == "plane" and any(leaves_plane(needle, dataset.noise) for needle in insertions):
        return Doubts(unjudged="plane")
    fitted = fit_quickly(problem) if theta is None else theta
    odd, limit = list[int](), find_limit(count)

    def describe(k: int) -> DoubtMetadata | None:
        return _describe(problem, k, fitted, predictions[k], sds[k], limit)

    while True:
        rest = [k for k in range(count) if k not in odd]
        fitted = refit(problem, [insertions[k] for k in rest], fitted) if odd else fitted
        blocks = linearize_needles(problem, insertions, fitted)
        if not np.isfinite(blocks.squares).all():
            return Doubts(unjudged="unsolved")
        uses = np.isin(np.arange(count), rest) & ~np.eye(count, dtype=bool)
        predictions = predict_from(problem, blocks, uses, fitted)
        pairs = [(blocks.select(k), predicted) for k, predicted in enumerate(predictions)]
        sds = [measure_deviations(block, fitted, predicted)[0].sds for block, predicted in pairs]
        oddest = sorted(rest, key=lambda k: -sds[k])
        worst = next(filter(describe, oddest), None) if len(odd) + 1 <= MAX_OUTLYING_PART * count else None
        if worst is None:
            break
        odd.append(worst)
    names = {insertions[k].id for k in odd}
    if seeks_common and (shared := _find_shared(problem, fitted, names)) is not None:
        return shared
    # in the stated errors alone, whatever the misfit of the others is
    stated = (
        measure_deviations(block, fitted, predicted._replace(scale=1.0))[0].sds for block, predicted in pairs
    )
    deviating = sum(sds >= limit for sds in stated)
    if deviating > MAX_OUTLYING_PART * count:
        return Doubts(deviating=(deviating, count))
    needles = map(describe, sorted(odd, key=lambda k: -sds[k]))
    return Doubts([needle for needle in needles if needle is not None])


def find_limit(count: int) -> float:
    """Return the distance (SD) beyond which any of `count` needles lies as rarely as one beyond `OUTLIER_SD`.

    It is Bonferroni's.
    """
    return float(-ndtri(ndtr(-OUTLIER_SD) / count))


def _find_shared(problem: Problem, theta: Floats, odd: set[str]) -> Doubts | None:
    """Return what happened to all needles alike, and which are odd besides; None if nothing did.

    `odd`: needles that do not count. The size of what happened is found again without those that are found.
    """
    doubts = None
    while True:
        sound = [insertion for insertion in problem.insertions if insertion.id not in odd]
        drawn = np.sort(np.random.default_rng(0).permutation(len(sound))[:COMMON_NEEDLES])
        found = find_common(replace(problem, insertions=tuple(sound[k] for k in drawn)), theta)
        if found is None:
            return doubts
        changed = change_all(problem, found.change, found.size)
        again = find_doubts(changed, refit(changed, changed.insertions, theta), seeks_common=False)
        doubts = again._replace(common_doubt=DoubtMetadata(**found.describe()))
        names = {needle.insertion for needle in again.odd_needles}
        if names <= odd:
            return doubts
        odd = odd | names


def _describe(
    problem: Problem, number: int, theta: Floats, predicted: Prediction, sds: float, limit: float
) -> DoubtMetadata | None:
    """Return what is known of a needle, given what the others predict; None if it is not odd.

    It is odd if it lies beyond the `limit` (SD) from its prediction. So it is if it lies farther than most,
    and a hypothesis is far more probable than none; that is asked only where the other needles lie as far
    from their fit as errors alone explain.
    """
    is_near = sds < limit
    if is_near and not (sds > PREDICTED_SD and predicted.describes(sum(problem.density.residual_counts))):
        return None

    def measure(change: Change, sizes: Sequence[float]) -> list[Deviation]:
        changed = [change.apply(left_out, size) for size in sizes]
        blocks = linearize_needles(problem, changed, theta, reaches_tip=change.row.reaches_tip)
        count = blocks.residual_counts[0] / problem.dataset.directions
        return [
            left._replace(log_density=left.log_density + change.row.log_volume(size, count))
            for left, size in zip(measure_deviations(blocks, theta, predicted), sizes, strict=True)
        ]

    left_out = problem.insertions[number]
    others = [other for other in problem.insertions if other is not left_out]
    (as_measured,) = measure_deviations(linearize_needles(problem, [left_out], theta), theta, predicted)
    # it may have happened to any of them
    nothing = as_measured.log_density + math.log(len(problem.insertions))
    changes = list_changes(left_out, others, problem.dataset.directions)
    if is_near:  # the densities of two models differ by errors of the linear ones
        changes = (change for change in changes if not change.row.changes_model)
    found = explain(changes, lambda change: search_sizes(partial(measure, change), change.starts), nothing)
    log_odds = found.log_odds if found else 0.0
    if is_near and log_odds < HAPPENED_LOG_ODDS:
        return None
    within_bounds = np.clip(predicted.theta, problem.lower, problem.upper)
    ((simulated, measured),) = replace(problem, insertions=(left_out,)).points(within_bounds)
    points = np.column_stack(
        [measured[:, 0], left_out.side * measured[:, 1], left_out.side * simulated[:, 1]]
    )
    return DoubtMetadata(
        insertion=left_out.id,
        place=left_out.where.rpartition("/")[2],
        sds=sds,
        log_odds=log_odds,
        points=points.round(3).tolist(),
        **(found.describe() if found and found.is_clear else {}),
    )


# ---- whether the data would show a boundary at another depth, and which modulus leans on it

#: step (mm) of a boundary for derivatives: the spacing of constraint points, between which they jump
STEP_MM = 1.0


def examine_depths(problem: Problem, theta: Floats) -> list[DepthMetadata]:
    """Return a record for each boundary at a stated depth, by the information at the fit `theta` (P,).

    Of a shift that all insertions share: `sd_mm` to which the data know it, with the parameters free;
    `stated_sd_mm`; and the modulus that changes most with it, by `factor_per_mm`. None where depths are
    crossings of surfaces, or no noise is stated.
    """
    if not problem.dataset.noise_is_stated or any(insertion.surfaces for insertion in problem.insertions):
        return []
    stated = max(insertion.boundary_sd for insertion in problem.insertions)
    exact = tuple(replace(insertion, boundary_sd=0.0) for insertion in problem.insertions)
    base = replace(problem, insertions=exact)
    _, slope, chi_square, _ = linearize(base, theta)
    scale = max(1.0, chi_square)
    covariance = np.linalg.pinv(slope.T @ slope / scale + prior_and_noise_information(base), hermitian=True)
    moduli = [k for k, name in enumerate(problem.names) if name.startswith("mu")]
    rows: list[DepthMetadata] = []
    for shift in list_boundary_shifts(base):
        ends = [linearize(change_all(base, shift, step), theta)[0] for step in (STEP_MM, -STEP_MM)]
        by_depth = (ends[0] - ends[1]) / (2 * STEP_MM)
        taken = covariance @ (slope.T @ by_depth) / scale  # what the parameters take up of a mm
        left = by_depth - slope @ taken
        information = float(left @ by_depth) / scale
        if not information > 0 or not moduli:
            continue
        worst = max(moduli, key=lambda n: abs(taken[n]))
        rows.append(
            DepthMetadata(
                boundary=int(shift.where),
                sd_mm=1 / math.sqrt(information),
                stated_sd_mm=stated,
                parameter=problem.names[worst],
                factor_per_mm=math.exp(abs(taken[worst])),
            )
        )
    return rows
