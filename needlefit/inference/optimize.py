"""Search for the best fit: many starts, each by least squares or by gradients, then a check of its end.

nlopt reports success on a NaN, forgets the best point when it is stopped, and breaks or crashes on values
that are not finite. So nothing that it returns is used: every evaluation goes through an
`EvaluationRecorder`, which keeps the best point, counts, and ends the search; nlopt only gets finite numbers.

A search ends by its tolerance on a plateau and in a narrow valley as well as at a minimum. Where the
objective is a sum of squares the exact Jacobian J distinguishes them: the best step s within the bounds of
the linear problem, min |r + J s|, would gain next to nothing at a minimum.

Least squares run with the exact Jacobian, in theta itself. SciPy's trust region method within the bounds
comes near a minimum. It takes J^T J for the second derivatives, which leaves out those of the residuals:
where these matter each step gains the same part of what is left. So the last steps are Newton's, with the
missing part estimated from the changes of J^T r, as in NL2SOL (Dennis, Gay and Welsch,
https://doi.org/10.1145/355958.355965). Where they fail SciPy's method goes on.

Searches begin at many starts spread over the box, side by side, and are resumable; the best end is the fit.
An easier objective is minimised first; starts that end at the same point there continue as one, and those far
behind the best do not. With uncertain depths every needle is simulated many times: depths taken as stated
make a posterior whose modes lie next to those of the whole one, at a fraction of the cost.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import nlopt
import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares, lsq_linear

from needlefit.arrays import Floats
from needlefit.errors import FitError
from needlefit.inference.fit import (
    BEHIND,
    EVALUATION_ERRORS,
    INTERRUPTED,
    Callbacks,
    EvaluationRecorder,
    Fit,
    ObjectiveFunction,
    SearchEnded,
    Start,
    StartPoint,
    half_square,
)
from needlefit.inference.problem import Problem, make_objective
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.project.processes import one_thread
from needlefit.project.progress import Stop, never_stop
from needlefit.project.tasks import TaskStop
from needlefit.schemas.recipe import ObjectiveName, RecipeRecord

FIRST_GRADIENT_STEP = 0.1  #: first step of a search by gradients, as a part of each parameter's range
#: relative gain of a restarted gradient search that counts as none
MIN_RELATIVE_GAIN = 1e-6
#: shown to nlopt for a value that is not finite, until finite ones are known; then 2 * worst + 1 is
PENALTY = 1e3
#: relative change of the value under which a search ends, as a part of the recipe's tolerance
VALUE_TOLERANCE = 0.1


def run_slsqp(recorder: EvaluationRecorder, start: Floats, tolerance: float) -> str:
    """Search by gradients with nlopt's SLSQP from theta `start` (P,); return why it ended.

    It is begun anew where it ended until that gains nothing: some end in a narrow valley.
    """
    if len(start) == 0:
        with suppress(SearchEnded):
            recorder.value(start)
        return recorder.reason or "tolerance"
    reason = _run_once(recorder, tolerance, start)
    while not recorder.reason and recorder.theta is not None:
        before = recorder.objective
        reason = _run_once(recorder, tolerance, recorder.theta)
        if before - recorder.objective <= MIN_RELATIVE_GAIN * abs(before):
            break
    return reason


def _run_once(recorder: EvaluationRecorder, tolerance: float, start: Floats) -> str:
    lower, span = recorder.objective_function.lower, recorder.objective_function.span
    optimizer = nlopt.opt(nlopt.LD_SLSQP, len(start))
    # The first step along the slope is to be `FIRST_GRADIENT_STEP` long. A method that knows no curvature at
    # first takes the slope for the step: a steep one leads into a corner, from which line searches fail.
    try:
        steepness = float(np.linalg.norm(recorder.gradient(start)[1] * span))
    except SearchEnded:
        return recorder.reason
    scale = FIRST_GRADIENT_STEP / steepness if steepness > 0 else 1.0
    optimizer.set_lower_bounds(np.zeros(len(start)))
    optimizer.set_upper_bounds(np.ones(len(start)))
    optimizer.set_xtol_abs(np.full(len(start), tolerance))
    optimizer.set_ftol_rel(tolerance * VALUE_TOLERANCE)
    bugs: list[BaseException] = []

    def function(cube: Floats, slope: Floats) -> float:
        try:
            value = scale * _evaluate(recorder, lower + cube * span, slope, scale * span)
        except SearchEnded:
            value = math.inf
            optimizer.force_stop()
        except BaseException as error:
            value = math.inf
            bugs.append(error)
            optimizer.force_stop()
        # above every finite value seen, so that nlopt moves away; 1 is added for values near 0
        worst = scale * (2 * abs(recorder.worst) + 1) if math.isfinite(recorder.worst) else PENALTY
        return value if math.isfinite(value) else worst

    # Nothing is raised inside: some algorithms call on after an exception, which Python does not survive.
    optimizer.set_min_objective(function)
    reason = _run(optimizer, np.clip((start - lower) / span, 0.0, 1.0))
    if bugs:
        raise bugs[0]
    return recorder.reason or reason


def _evaluate(recorder: EvaluationRecorder, theta: Floats, slope: Floats, span: Floats) -> float:
    """Return the value; with its slope along the cube written into `slope` (P,), if that is asked for."""
    if slope.size == 0:
        return recorder.value(theta)
    slope[:] = 0.0
    value, gradient = recorder.gradient(theta)
    # nlopt reads the gradient from this buffer: it must be filled in place; span is the chain rule of the
    # unit cube
    slope[:] = gradient * span
    return value


FAILED = "nlopt failed"  #: why a search ended in which nlopt gave up


def _run(optimizer: "nlopt.opt", start: Floats) -> str:
    """Return why nlopt ended; its answer is not looked at."""
    try:
        optimizer.optimize(start)
    except nlopt.ForcedStop:
        return "stopped"
    except nlopt.RoundoffLimited:
        return "roundoff"
    except (nlopt.exception, RuntimeError, ValueError, MemoryError):
        return FAILED
    return "tolerance"


#: relative change of the sum of squares, and of theta, under which it ends, unless more is negligible
MIN_TOLERANCE = 1e-15
#: about as large as half the squares are at their least: a part of them is negligible
TYPICAL_HALF_SQUARES = 1e2
NEAR_TOLERANCE = 1e-2  #: relative change of the sum of squares by a step under which a minimum is near
MAX_FAILED_STEPS = 3  #: Newton's steps in a row from which the sum of squares rises: there its method is left
#: cosine between a step and the change of the gradient below which that gives no curvature along the step
MIN_COSINE = 1e-6
VALUE_ROUNDING = 1e-9  #: rise of the sum of squares, as a part of it, that may be rounding of the simulation


def run_least_squares(recorder: EvaluationRecorder, start: Floats) -> str:
    """Search from theta `start` (P,), to rounding; return why it ended."""
    reason = ""
    with suppress(SearchEnded):
        reason = _run_scipy(recorder, start)
    return recorder.reason or reason


def _run_scipy(recorder: EvaluationRecorder, start: Floats) -> str:
    if not recorder.find_constant(start):
        return "failed at its start"
    small = max(MIN_TOLERANCE, recorder.objective_function.absolute_tolerance / TYPICAL_HALF_SQUARES)
    if len(start) == 0:
        return "tolerance"

    lower, upper = recorder.objective_function.lower, recorder.objective_function.upper
    steps = _ScipySteps(recorder, small)
    try:
        found = least_squares(
            steps.residuals,
            np.clip(start, lower, upper),
            jac=steps.slopes,
            bounds=(lower, upper),
            x_scale="jac",
            ftol=small,
            xtol=small,
            gtol=None,  # absolute: it would depend on the units of theta
            max_nfev=recorder.budget,  # the recorder ends it, which counts the Jacobians too
        )
        reason = "tolerance" if found.status > 0 else "budget"
    except _Converged:
        reason = "tolerance"
    # of large squares at the start their constant lost digits; this evaluation is no part of the search
    recorder.budget = max(recorder.budget, recorder.evaluations + 1)
    assert recorder.theta is not None
    recorder.objective = recorder.value(recorder.theta)
    return reason


class _Converged(Exception):  # noqa: N818  (no error: the way out of SciPy's method)
    """Raised to leave SciPy's method where Newton's steps have converged."""


def _run_newton(
    recorder: EvaluationRecorder, theta: Floats, found: tuple[Floats, Floats], small: float
) -> bool:
    """Take Newton's steps from theta (P,), with its residuals and Jacobian; return whether they converged."""
    lower, upper = recorder.objective_function.lower, recorder.objective_function.upper
    curvature = np.zeros((len(theta), len(theta)))  # what J^T J lacks
    failed = 0
    while failed < MAX_FAILED_STEPS:
        residuals, jacobian = found
        value, slope = half_square(residuals), residuals @ jacobian
        step = _find_step(slope, jacobian.T @ jacobian + curvature, lower - theta, upper - theta)
        if step is None:
            return False
        gain = -0.5 * float(slope @ step)
        if gain <= max(recorder.objective_function.absolute_tolerance, small * value):
            return True
        tried = recorder.jacobian(theta + step) if gain <= NEAR_TOLERANCE * value else None
        if tried is None:
            return False
        # a step too far says as much of the curvature as another one
        change = tried[0] @ (tried[1] - jacobian)
        curvature = _update_curvature(curvature, step, change, tried[0] @ tried[1] - slope)
        if half_square(tried[0]) <= (1 + VALUE_ROUNDING) * value:
            theta, found, failed = np.clip(theta + step, lower, upper), tried, 0
        else:
            failed += 1
    return False


def _find_step(slope: Floats, curvature: Floats, low: Floats, high: Floats) -> Floats | None:
    """Return the step (P,) to the minimum of a quadratic function between two bounds; None if it has none."""
    try:
        factor = cholesky(curvature, lower=True)
    except np.linalg.LinAlgError:
        return None
    target = -solve_triangular(factor, slope, lower=True)
    step: Floats = solve_triangular(factor.T, target, lower=False)
    if np.all((step >= low) & (step <= high)):
        return step
    return lsq_linear(factor.T, target, (np.minimum(low, 0), np.maximum(high, 0)), method="bvls").x


def _update_curvature(curvature: Floats, step: Floats, change: Floats, whole: Floats) -> Floats:
    """Return the estimate (P, P) of what J^T J lacks, after a step that changed J^T r by `whole` (P,).

    `change` (P,) is what of this the residuals' second derivatives do. The estimate is first made smaller
    where it predicted more.
    """
    along, predicted = float(whole @ step), float(step @ curvature @ step)
    if along <= MIN_COSINE * float(np.linalg.norm(whole) * np.linalg.norm(step)):
        return curvature
    if predicted:
        curvature = curvature * min(1.0, abs(float(change @ step) / predicted))
    missing = change - curvature @ step
    both = np.outer(missing, whole) + np.outer(whole, missing)
    return curvature + both / along - float(missing @ step) / along**2 * np.outer(whole, whole)


class _ScipySteps:
    """Residuals and Jacobian for SciPy's method, which asks for both at almost every point; near a minimum
    Newton's steps are tried between its own.
    """

    def __init__(self, recorder: EvaluationRecorder, small: float) -> None:
        self._recorder, self._small = recorder, small
        self._theta: Floats | None = None
        self._found: tuple[Floats, Floats] | None = None
        self._value, self._near = np.inf, NEAR_TOLERANCE

    def residuals(self, theta: Floats) -> Floats:
        """Return (R,); a single infinite one where they failed."""
        best, found = self._recorder.theta, self._recorder.linearized
        if best is None or found is None or not np.array_equal(theta, best):
            found = self._recorder.jacobian(theta)
        self._theta, self._found = theta.copy(), found
        # one infinite residual is enough: SciPy rejects the step and shortens it
        return np.array([np.inf]) if found is None else found[0]

    def slopes(self, theta: Floats) -> Floats:
        """Return the Jacobian (R, P) at a point that SciPy accepted.

        Where it cannot be computed the search ends with its best point.
        """
        if self._theta is None or not np.array_equal(theta, self._theta):
            self.residuals(theta)
        if self._found is None:
            self._recorder.reason = "no Jacobian"
            raise SearchEnded
        value, before = half_square(self._found[0]), self._value
        self._value = value
        if before - value <= self._near * value:
            if _run_newton(self._recorder, theta, self._found, self._small):
                raise _Converged
            self._near *= NEAR_TOLERANCE  # SciPy's method must come nearer before the next attempt
        return self._found[1]


#: largest gain of the value that a further step may promise; in units of the mean square where that is above
#: 1, because rounding grows with it, or where nothing says what is negligible
MAX_REMAINING_GAIN = 1e-6
#: a further step that changes no parameter by more than this part of it promises nothing
NEGLIGIBLE_STEP = 1e-8
#: a parameter whose whole scale moves the residuals by less than this part of them has no effect; neither has
#: a combination of parameters whose effects cancel to this part of each
FLAT_FRACTION = 1e-8


def certify_minimum(recorder: EvaluationRecorder, reason: str) -> str:
    """Check the best point of a search, and return why the search ended: "tolerance" only at a minimum.

    "stalled" is no minimum, "flat" one in which some parameter or combination has no effect, "bound" one only
    because the box ends there. A function that is no sum of squares keeps the reason that the algorithm gave.
    """
    settled = reason in ("tolerance", "roundoff", FAILED)
    squares, theta = recorder.objective_function.jacobian is not None, recorder.theta
    if not settled or not squares or theta is None or not len(theta):
        return reason
    found, recorder.reason = recorder.linearized, ""
    recorder.budget = recorder.evaluations + 1  # this evaluation is no part of the search
    with suppress(SearchEnded):
        found = found or recorder.jacobian(theta)
    return recorder.reason or reason if found is None else _classify_minimum(recorder, *found)


def _classify_minimum(recorder: EvaluationRecorder, residuals: Floats, jacobian: Floats) -> str:
    assert recorder.theta is not None
    objective_function, theta = recorder.objective_function, recorder.theta
    spans = objective_function.span
    # columns per whole range compare parameters of different units; without a range the value itself is the
    # scale
    scales = np.where(np.isfinite(spans), spans, np.maximum(np.abs(theta), 1e-300))
    columns = jacobian * scales  # (R, P) per whole scale of each parameter
    # the norms also scale the columns to length 1 below, so that the singular values measure directions alone
    lengths = np.linalg.norm(columns, axis=0)
    # parameters that are not held by a bound that the value falls towards
    slope, near = residuals @ jacobian, NEGLIGIBLE_STEP * np.maximum(1, np.abs(theta))
    held = (theta - objective_function.lower <= near) & (slope > 0)
    free = ~(held | ((objective_function.upper - theta <= near) & (slope < 0)))
    if not np.any(free):
        return "bound"
    if np.any(lengths[free] <= FLAT_FRACTION * np.linalg.norm(residuals)):
        return "flat"
    directions = columns[:, free] / lengths[free]
    if np.linalg.svd(directions, compute_uv=False)[-1] <= FLAT_FRACTION:
        return "flat"
    unit = scales[free] / lengths[free]
    low = (objective_function.lower - theta)[free] / unit
    high = (objective_function.upper - theta)[free] / unit
    best = lsq_linear(directions, -residuals, (np.minimum(low, 0), np.maximum(high, 0)))
    gain = 0.5 * float(residuals @ residuals) - best.cost
    small = np.all(np.abs(best.x * unit) <= NEGLIGIBLE_STEP * np.abs(theta[free]))
    mean = float(residuals @ residuals) / max(1, len(residuals) - len(theta))
    unit_gain = max(1.0, mean) if objective_function.absolute_tolerance else mean
    if not small and gain > MAX_REMAINING_GAIN * unit_gain:
        return "stalled"
    return "tolerance" if np.all(free) else "bound"


def search(
    objective_function: ObjectiveFunction,
    recipe: RecipeRecord,
    start_point: StartPoint,
    stop: Callable[[], bool] = never_stop,
) -> Start:
    """Search from one start with a recipe's tolerance and budget: by least squares, or else by gradients.

    The start has the best point, and why the search ended: "tolerance" if at a minimum, as far as known.
    """
    recorder = EvaluationRecorder(objective_function, recipe.evaluations, stop)
    start = np.array(start_point.theta, dtype=np.float64)
    if objective_function.jacobian is None:
        reason = run_slsqp(recorder, start, recipe.tolerance)
    else:
        reason = run_least_squares(recorder, start)
    if reason != INTERRUPTED:
        reason = certify_minimum(recorder, reason)
    if recorder.theta is None and reason != INTERRUPTED:
        reason = "no finite value"
    return Start(
        index=start_point.index,
        theta0=start_point.theta,
        theta=start_point.theta if recorder.theta is None else tuple(recorder.theta.tolist()),
        objective=recorder.objective,
        evaluations=recorder.evaluations,
        gradients=recorder.gradients,
        failures=recorder.failures,
        stopped=reason,
    )


#: most evaluations of an approach by least squares: one that needs more is left where it is
APPROACH_EVALUATIONS = 60
#: largest misfit (sum of squares) of an end of the approach that is continued, in units of the best one: far
#: from all needles a start crawls for hundreds of evaluations, and ends there
MAX_MISFIT_RATIO = 5.0
#: differences of the easier goal, and of every parameter of theta, up to which two ends are one
SAME_OBJECTIVE, SAME_THETA = 1e-3, 1e-2


def group_approaches(ends: Sequence[Start]) -> dict[int, int]:
    """Map each start to the start that continues for it: itself, or a better one that ended at the same
    point.

    An end without a finite value has met nobody.
    """
    chosen: dict[int, int] = {}
    first: list[Start] = []
    for end in sorted(ends, key=lambda s: (s.objective, s.index)):
        leader = end
        for other in first if math.isfinite(end.objective) else ():
            apart = np.abs(np.subtract(end.theta, other.theta))
            if abs(end.objective - other.objective) < SAME_OBJECTIVE and np.all(apart < SAME_THETA):
                leader = other
                break
        chosen[end.index] = leader.index
        if leader is end:
            first.append(end)
    return chosen


@one_thread
def minimize(
    problem: Problem, recipe: RecipeRecord, rng: np.random.Generator, callbacks: Callbacks | None = None
) -> Fit:
    """Minimise the recipe's objective from every start, and return the best point of all.

    The result depends on the problem, the recipe and `rng` alone: not on the number of threads, and not
    on whether some starts were computed by an earlier, interrupted run.

    Raises FitError if no evaluation succeeded, or finished starts belong to another fit.
    """
    callbacks = Callbacks() if callbacks is None else callbacks
    whole = _SearchTask(problem, recipe)
    design = starting_points(problem.lower, problem.upper, recipe.starts, rng)  # (n, P)
    done = {index: start for index, start in callbacks.finished.items() if index < len(design)}
    for index, start in done.items():
        if start.theta0 != tuple(design[index].tolist()):
            raise FitError(
                f"start {index} of the checkpoint began elsewhere than this fit's",
                fix="run again without --resume; seed, bounds or recipe have changed",
            )
    start_points = [StartPoint(k, tuple(theta0.tolist())) for k, theta0 in enumerate(design)]
    easier = whole.objective_function.approach
    if easier is None or len(done) == len(start_points):
        for start in whole.run_each([p for p in start_points if p.index not in done], callbacks):
            _add_start(start, done, callbacks)
    else:
        _search_by_approach(whole, easier, start_points, done, callbacks)
    return _select_fit(problem, recipe.minimize, tuple(done[index] for index in sorted(done)), design)


@dataclass(frozen=True)
class _SearchTask:
    """A search, of which every start is a task: by a recipe, of a problem or of the easier one before it."""

    problem: Problem
    recipe: RecipeRecord
    of_approach: bool = False

    @cached_property
    def objective_function(self) -> ObjectiveFunction:
        """What is minimised."""
        found = make_objective(self.problem, self.recipe.minimize)
        if not self.of_approach:
            return found
        assert found.approach is not None
        return found.approach

    def run(self, stop: Stop, start_point: StartPoint) -> Start:
        """Return what came of one start."""
        return search(self.objective_function, self.recipe, start_point, stop)

    def run_each(self, start_points: list[StartPoint], callbacks: Callbacks) -> Iterator[Start]:
        """Yield the search from each place as it ends, in the calling thread."""
        stop = TaskStop(callbacks.stop)
        for _, start in run_side_by_side(partial(self.run, stop), start_points, callbacks.jobs, stop):
            yield start


def _search_by_approach(
    whole: _SearchTask,
    easier: ObjectiveFunction,
    start_points: list[StartPoint],
    done: dict[int, Start],
    callbacks: Callbacks,
) -> None:
    """Add to `done` what came of all starts: down the easier goal, then one for all that have met there.

    Approaches are not stored: a resumed search repeats them, and so finds the same groups.
    """
    half = whole.recipe.model_copy(update={"evaluations": max(1, whole.recipe.evaluations // 2)})
    few = half.model_copy(update={"evaluations": min(half.evaluations, APPROACH_EVALUATIONS)})
    approach = _SearchTask(whole.problem, few, of_approach=True)
    ends: dict[int, Start] = {}
    for end in approach.run_each(start_points, callbacks):
        ends[end.index] = end
        callbacks.step(len(ends), len(start_points))
    if callbacks.stop():
        # what is interrupted still leaves its best point
        best = min(ends.values(), key=lambda s: (s.objective, s.index), default=None)
        if best is None or not math.isfinite(best.objective) or best.index in done:
            return
        with suppress(*EVALUATION_ERRORS):
            value = whole.objective_function.value(np.array(best.theta))
            done[best.index] = replace(
                best,
                objective=value if math.isfinite(value) else math.inf,
                evaluations=best.evaluations + 1,
                stopped=INTERRUPTED,
            )
        return
    leader = group_approaches([ends[start_point.index] for start_point in start_points])
    continuing = select_leaders(easier, [ends[k] for k in sorted(set(leader.values()))])
    one = half.model_copy(update={"evaluations": 1})
    for recipe, chosen in ((half, True), (one, False)):
        begin = [
            replace(p, theta=ends[p.index].theta)
            for p in start_points
            # a group whose members are all stored needs no continuation
            if leader[p.index] == p.index
            and (p.index in continuing) == chosen
            and any(k not in done for k in leader if leader[k] == p.index)
        ]
        for found in _SearchTask(whole.problem, recipe).run_each(begin, callbacks):
            ended = chosen or found.stopped == INTERRUPTED
            continued = found if ended else replace(found, stopped=BEHIND)
            for index in (k for k in leader if leader[k] == continued.index and k not in done):
                counts = {
                    name: getattr(ends[index], name) for name in ("evaluations", "gradients", "failures")
                }
                if index == continued.index:
                    counts = {name: count + getattr(continued, name) for name, count in counts.items()}
                joined = None if index == continued.index else continued.index
                about = {"index": index, "theta0": ends[index].theta0, "joined": joined, **counts}
                _add_start(replace(continued, **about), done, callbacks)


def select_leaders(easier: ObjectiveFunction, ends: Sequence[Start]) -> set[int]:
    """Return the indices of the ends of the approach that are continued: of a misfit near the best one's."""
    best, *others = sorted(ends, key=lambda end: (end.objective, end.index))
    limit = math.inf
    if easier.misfits is not None and math.isfinite(best.objective):
        misfits = easier.misfits(np.array(best.theta))
        limit = best.objective + (MAX_MISFIT_RATIO - 1) * max(0.5 * len(misfits), half_square(misfits))
    return {best.index, *(end.index for end in others if end.objective <= limit)}


def _add_start(start: Start, done: dict[int, Start], callbacks: Callbacks) -> None:
    if start.stopped != INTERRUPTED:
        callbacks.report(start)
    if start.evaluations:
        done[start.index] = start


def starting_points(lower: Floats, upper: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` starts (n, P) spread over the box by a scrambled Halton sequence.

    More starts extend fewer ones. Where nothing is free there is one start, without coordinates.
    """
    if len(lower) == 0:
        return np.empty((1, 0))
    cube, rng = np.zeros((count, len(lower))), rng.spawn(1)[0]
    numbers = range(2, 8 * len(lower) + 2)  # among which there are as many primes
    primes = [n for n in numbers if all(n % k for k in range(2, math.isqrt(n) + 1))]
    # as SciPy's, whose module takes 0.4 s to load
    for column, base in zip(cube.T, primes[: len(lower)], strict=True):
        left, place = np.arange(count), 1.0 / base
        digits = np.repeat(np.arange(base)[None], math.ceil(54 / math.log2(base)) - 1, axis=0)
        for row in digits:
            rng.shuffle(row)  # Owen's scrambling: a permutation of each digit
        for row in digits:
            column += row[left % base] * place
            left, place = left // base, place / base
    return lower + cube * (upper - lower)


def _select_fit(problem: Problem, minimized: ObjectiveName, starts: tuple[Start, ...], design: Floats) -> Fit:
    interrupted = len(starts) < len(design) or any(s.stopped == INTERRUPTED for s in starts)
    evaluations = sum(s.evaluations for s in starts)
    best = min(starts, key=lambda s: (s.objective, s.index), default=None)
    if not interrupted and (best is None or not math.isfinite(best.objective)):
        raise FitError(
            f"none of {evaluations} evaluations from {len(starts)} starts could be solved",
            fix="narrow the bounds of the medium, or check depths and layers of the insertions",
        )
    theta = tuple(design[0].tolist()) if best is None else best.theta
    return Fit(
        theta=theta,
        values=problem.values(np.array(theta)),
        minimized=minimized,
        objective=math.inf if best is None else best.objective,
        starts=starts,
        evaluations=evaluations,
        gradients=sum(s.gradients for s in starts),
        failures=sum(s.failures for s in starts),
        interrupted=interrupted,
    )
