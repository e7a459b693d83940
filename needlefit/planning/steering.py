"""Plan how to steer a needle from where it stands to a target: entry, path of the base, turns of the bevel.

In the plane z = 0 the bevel faces either side. To a goal in space it takes on any roll at first; on the way
it turns over as in the plane, and the base moves along y.

The plan is the one of least risk: the share of posterior draws whose tip misses the target by more than its
radius, or whose needle touches an obstacle. Turns of the bevel are chosen from a grid of constraint points;
for each choice one Gauss-Newton step brings the expected tip to the target, the best few are then optimised
and their risk lowered. What is reported comes of draws that no plan was sought with.

Depths are arc lengths, as the needle is inserted; target and obstacles are in the constraint frame C.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.errors import ModelError
from needlefit.inference.forward_model import ParameterDraws
from needlefit.inference.proportion import wilson_interval
from needlefit.mechanics.batch import Batch, NeedleShapes, read_batches, simulate_batches
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import SAME_DEPTH_MM, make_lattice
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import find_roll
from needlefit.planning.goals import (
    PATH_POINTS,
    Goal,
    PlaneGoal,
    compute_clearances,
    compute_misses,
    compute_residuals,
    cut_plane,
    find_hits,
)

SEARCH_DRAWS = 32  #: number of draws on which a plan is searched; the others test it
SEARCH_TOLERANCE = 1e-4  #: relative change at which a search ends
MAX_EVALUATIONS = 25  #: largest number of evaluations of one search, with a gradient
QUICK_ROUNDS = 2  #: number of Gauss-Newton steps of a plan that is made again on the way
QUICK_RAMP = 0.15  #: fraction of the remaining way on which the base moves: later moves hardly bend a needle
BASE_STEP_MM = 5.0  #: inserted depth (mm) of one step of the base
DEPTH_RANGE_MM = 5.0  #: largest distance (mm) of a plan's end from the target's own depth
NEAREST_TARGET_MM = 0.5  #: smallest distance in depth (mm) of a target beyond the tip
#: number of places along the way at which turns are tried, by the number of turns of the bevel
TURN_PLACES = {0: 0, 1: 5, 2: 4}
#: expected miss (mm) that counts as much as a move of base or entry over the whole range, or a turn of the
#: bevel
EFFORT_MM = 0.05

TURN_RISK = 0.005  #: risk that counts as much as a further turn
EFFORT_RISK = 0.01  #: risk that counts as much as moves of base and entry over their whole ranges


@dataclass(frozen=True)
class _RiskRules:
    """How the risk is smoothed and lowered.

    `sloped`: the distance outside the target and in obstacles is added, since far from them the smoothed step
    has no slope.
    """

    width: float  #: smoothing of the risk, as a part of the target's radius
    miss_risk: float  #: of a tip at the rim of the target beside one in its middle: a miss counts there, too
    refined: int  #: choices of turns optimised after the first step; the risk of all but the last is lowered
    evaluations: int  #: choices that are tried to lower the risk of one
    sure_risk: float  #: a plan of at most this risk leaves little to narrower ranges, which are not searched
    sloped: bool
    density: int = 1  #: how many times as many places of turns are tried


SAMPLED = _RiskRules(width=0.15, miss_risk=0.02, refined=2, evaluations=40, sure_risk=0.05, sloped=False)
"""Rules of the risk of many draws."""

EXACT = _RiskRules(
    width=0.02, miss_risk=0.3, refined=3, evaluations=120, sure_risk=0.01, sloped=True, density=3
)
"""Rules of the risk of exact parameters, one needle, which costs little: an obstacle that is just passed is
no risk, so that only the miss is left to lower."""

NESTED_RANGES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75)
"""Parts of the base's range that are searched too: a wider range then finds no less than these."""

#: distance of a choice from the end of its range, as a fraction of it, within which it is at its limit
LIMIT_PART = 1e-3
CERTAIN_RISK = 0.99  #: smallest risk of a choice that counts as one that misses the target in all draws

ENTRY, DEPTH, BASE_Y, BASE_SLOPE, ROLL = range(5)
"""Places in the inputs of a choice: entry, depth, base (mm), slope of the base; in space roll (degrees)."""
MOVED = [ENTRY, BASE_Y, BASE_SLOPE]  #: places of the inputs that `PlanLimits` limits
#: steps of difference quotients by the inputs, in their order
DIFFERENCE_STEPS = np.array([0.05, 0.05, 0.05, 1e-3, 0.5])

MAX_ROLL_DEG = 360.0  #: largest difference (degrees) of a roll from that toward y: it may go once around

LIMITED = ("entry", "base", "base angle")  #: names of `MOVED`, as `SteeringPlan.at_limit` has them


@dataclass(frozen=True)
class PlanLimits:
    """How far a plan may go: entry (mm) and base (mm, degrees) to either side, turns of the bevel."""

    entry_mm: float = 0.0
    base_mm: float = 10.0
    base_angle_deg: float = 5.0
    turns: int = 2

    @property
    def base_slope(self) -> float:
        """Greatest slope of the base."""
        return math.tan(math.radians(self.base_angle_deg))


@dataclass(frozen=True)
class StartedInsertion:
    """An insertion that a plan continues: needle, tissue and rules as `simulate_steps` takes them."""

    needle: Needle
    tissue: Tissue
    rules: ModelOptions  #: `first_cell` is given
    path: tuple[Step, ...]  #: so far; the last one is where the needle stands, at first contact at depth 0
    draws: ParameterDraws | None = None  #: None: the parameters of `tissue` and of the bevel are exact

    @property
    def now(self) -> Step:
        """Where the needle stands, and under which inputs; its tip is free."""
        last = self.path[-1]
        return replace(last, controls=replace(last.controls, tip=None))

    @property
    def exact(self) -> ParameterDraws:
        """The parameters of the tissue and the bevel themselves."""
        return ParameterDraws.exact(self.tissue, self.now.bevel, self.rules)

    @property
    def reach(self) -> float:
        """Greatest depth, mm, at which the base is still before guides and tissue."""
        before = self.now.controls.before
        return self.needle.length + (before[0].x if before else 0.0) - 1.0

    def widen(self, goal: Goal) -> Goal:
        """Return a goal whose obstacles this needle touches with its flank, where its diameter is known."""
        return replace(goal, needle_radius=(self.needle.outer_diameter or 0.0) / 2)

    @cached_property
    def samples(self) -> tuple[ParameterDraws, ParameterDraws]:
        """The draws on which plans are sought, and those on which they are tested."""
        draws = self.draws or self.exact
        if len(draws) < 2 * SEARCH_DRAWS:
            return draws, draws
        sought = np.linspace(0, len(draws) - 1, SEARCH_DRAWS).astype(np.intp)
        return draws.only(sought), draws.only(np.setdiff1d(np.arange(len(draws)), sought))

    def make_batches(self, draws: ParameterDraws, ways: Sequence[tuple[Step, ...]]) -> list[Batch]:
        """Return the needles of all draws, to be simulated: after the steps so far, those of each way."""
        done = self.path if self.path[-1].depth > SAME_DEPTH_MM else ()
        return [draws.make_batch(self.needle, self.tissue, (*done, *way), self.rules) for way in ways]


@dataclass(frozen=True)
class SteeringPlan:
    """A plan, and what becomes of its needles.

    `needles` (B, K, 2), in space (B, K, 3), mm, are those of the draws that test it, NaN where one has no
    solution within the model's validity; `nominal` (K, 2) or (K, 3) is that of the exact parameters.
    """

    entry_mm: float  #: shift of the entry along y
    steps: tuple[Step, ...]  #: from where the needle stands
    #: depths where the bevel turns over, mm; at the present one before anything else
    turns: tuple[float, ...]
    goal: Goal
    needles: Floats
    nominal: Floats
    hits: int  #: draws within the radius and past all obstacles
    low: float  #: Wilson's 95 % interval of their share
    high: float
    touched: dict[str, float]  #: share of draws that touch each obstacle
    at_limit: tuple[str, ...] = ()  #: which of `LIMITED` are at the end of their range

    @property
    def solved(self) -> Bools:
        """Which draws (B,) have a needle."""
        return np.isfinite(self.needles[:, -1, 0])

    @property
    def probability(self) -> float:
        """Share of draws that reach the target and touch no obstacle."""
        return self.hits / len(self.needles)

    @property
    def misses(self) -> Floats:
        """Distance of the tips from the target, mm, of the draws that have a needle."""
        return compute_misses(self.needles[self.solved], self.goal)

    @property
    def nominal_miss(self) -> float:
        """Distance from the target of the tip with the exact parameters, mm."""
        return float(compute_misses(self.nominal[None], self.goal)[0])

    def cut_at(self, depth: float) -> tuple[Step, ...]:
        """Return the steps up to a depth (mm), or to the end if that is nearer."""
        before = tuple(step for step in self.steps if step.depth < depth)
        return (*before, *(replace(step, depth=depth) for step in self.steps[len(before) :][:1]))

    def describe_steps(self) -> list[dict[str, Any]]:
        """Return the steps, mm and 1: the bevel by its roll, degrees, in a plane by its side."""
        rows = []
        for step in self.steps:
            roll, side = {"bevel_roll_deg": find_roll(step.bevel)}, {"bevel_side": step.bevel.side}
            base = {"base_y_mm": step.controls.base_y, "base_slope": step.controls.base_slope}
            rows.append({"depth_mm": step.depth, **(roll if self.goal.directions > 1 else side), **base})
        return rows

    def describe_misses(self) -> dict[str, Any]:
        """Return misses in mm (None without a needle), what needles touch, and what is at its limit."""
        misses, nominal = self.misses, self.nominal_miss
        median, most = np.quantile(misses, [0.5, 0.95]).tolist() if len(misses) else (None, None)
        tips = self.needles[self.solved, -1]
        spread = (
            {"tip_sd_mm": tips.std(axis=0)[1:].tolist()} if self.goal.directions > 1 and len(tips) else {}
        )
        return spread | {
            "nominal_miss_mm": nominal if math.isfinite(nominal) else None,
            "median_mm": median,
            "miss_95_mm": most,
            "touched": self.touched,
            "at_limit": list(self.at_limit),
        }


def plan_steering(
    insertion: StartedInsertion,
    goal: Goal,
    limits: PlanLimits | None = None,
    threads: int | None = None,
    sought: ParameterDraws | None = None,
) -> SteeringPlan:
    """Return the plan of least risk from where the needle stands.

    The radius of `goal` is finite; the entry is shifted within its limits only from first contact on.
    `threads` are by default as many as there are cores. Given the draws `sought`, it is in a hundredth of a
    second the plan of their least expected squared miss: each choice of turns is brought to the target by
    `QUICK_ROUNDS` Gauss-Newton steps, the risk is not lowered, narrower ranges are not searched.

    Raises ModelError if the target is not ahead of the tip, out of the needle's reach, or no needle is found
    on the way.
    """
    goal = insertion.widen(goal)
    goal = goal.to_space() if any(step.acts_along_z for step in insertion.path) else goal
    search = _Search(insertion, goal, limits or PlanLimits(), threads, sought or insertion.samples[0])
    x, nearest = goal.target[0], insertion.now.depth + NEAREST_TARGET_MM
    if x <= nearest or search.end > insertion.reach:
        raise ModelError(
            f"the target lies at a depth of {x:.1f} mm",
            expected=(
                f"deeper than {nearest:.1f} mm (tip + {NEAREST_TARGET_MM} mm), up to {insertion.reach:.1f} mm"
            ),
            fix="retract the needle, or take another target",
        )
    if sought is None:
        return search.describe(search.best())
    search = replace(search, ramp=QUICK_RAMP)
    return search.describe(search.best_quickly())


def plan_to_target(
    insertion: StartedInsertion, goal: Goal, limits: PlanLimits, threads: int | None
) -> tuple[PlaneGoal, SteeringPlan]:
    """Return the plan of least risk to a goal in space, and the plane in which its target lies.

    To a target outside of the plane z = 0 the bevel is rolled as the insertion begins, while the base moves
    along y; where that does not reach it, bevel and base are rolled together.
    """
    goal = insertion.widen(goal)
    plane = cut_plane(goal)
    if not goal.target[2]:
        return plane, plan_steering(insertion, plane.goal, limits, threads)
    planned = plan_steering(insertion, goal, limits, threads)
    if not planned.hits:
        rolled = plan_steering(insertion, plane.goal, limits, threads)
        planned = rolled if rolled.hits else planned
    return (replace(plane, roll_deg=0.0, beside=()) if planned.goal.directions > 1 else plane), planned


@dataclass(frozen=True)
class _Choice:
    """A side of the bevel, depths at which it turns over (mm), and inputs (4,), in space (5,).

    In space the roll of the bevel, the last input, stands in place of its side.
    """

    side: int
    turns: tuple[float, ...]
    inputs: Floats

    def face(self, bevel: Bevel, turned: int) -> Bevel:
        """Return a bevel as it faces after so many turns."""
        if len(self.inputs) == ROLL:
            return replace(bevel, side=self.side * (-1) ** turned)
        roll_deg = math.remainder(float(self.inputs[ROLL]) + 180.0 * turned, 360.0)
        return Bevel.turn(roll_deg, bevel.offset, bevel.cut_angle)


@dataclass(frozen=True)
class _Search:
    insertion: StartedInsertion
    goal: Goal
    limits: PlanLimits
    threads: int | None
    search_draws: ParameterDraws  #: on which choices are compared
    ramp: float = 1.0  #: part of the remaining way on which the base moves

    @cached_property
    def end(self) -> float:
        """Depth of the target: the length of the straight way to it from where the needle stands."""
        x, y, *z = self.goal.target
        return math.hypot(x, y * (self.limits.entry_mm == 0), *z)

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and greatest entry, depth, base y and base slope, in space roll."""
        now, limits = self.insertion.now, self.limits
        entry = limits.entry_mm if now.depth <= SAME_DEPTH_MM else 0.0
        nearest = max(self.end - DEPTH_RANGE_MM, now.depth + 0.1)
        deepest = min(self.end + DEPTH_RANGE_MM, self.insertion.reach)
        low = [-entry, nearest, -limits.base_mm, -limits.base_slope, -MAX_ROLL_DEG][: len(self.still)]
        high = [entry, deepest, limits.base_mm, limits.base_slope, MAX_ROLL_DEG][: len(self.still)]
        margin = 1e-5  # of what is fixed: least_squares wants bounds that differ
        return np.minimum(low, self.still) - margin, np.maximum(high, self.still) + margin

    @cached_property
    def stations(self) -> tuple[float, ...]:
        """Constraint points between where the needle stands and the least depth of a plan, mm.

        Inputs change there alone: within a cell each change begins another cut, and the tip would jump.
        """
        now, last = self.insertion.now.depth, self.bounds[0][1] - 0.5
        lattice = make_lattice((), self.insertion.rules)
        points = (lattice.depth(m) for m in range(1, lattice.cell(max(last, 0.0)) + 1))
        return tuple(depth for depth in points if now + 0.5 < depth < last)

    @cached_property
    def base_stations(self) -> tuple[float, ...]:
        count = int((self.end - self.insertion.now.depth) / BASE_STEP_MM)
        return _spread(self.stations, count)

    def way(self, choice: _Choice) -> tuple[Step, ...]:
        """Return the steps of a choice; the base goes in equal steps to its end, none before contact."""
        now = self.insertion.now
        _, depth, base_y, base_slope, *_ = choice.inputs.tolist()
        turned, steps = 0, list[Step]()
        controls = now.controls
        for end in (*sorted({*self.base_stations, *choice.turns}), depth):
            # before contact a moved base would move the entry too
            if (steps or now.depth > SAME_DEPTH_MM) and (end in self.base_stations or end == depth):
                ramp = self.ramp * (self.end - now.depth)
                part = min((end - now.depth) / ramp, 1.0) if end != depth else 1.0
                begin = now.controls
                y = begin.base_y + part * (base_y - begin.base_y)
                slope = begin.base_slope + part * (base_slope - begin.base_slope)
                controls = replace(begin, base_y=y, base_slope=slope)
            step = Step(end, choice.face(now.bevel, turned), controls)
            if steps and (steps[-1].bevel, steps[-1].controls) == (step.bevel, step.controls):
                steps.pop()
            steps.append(step)
            turned += end in choice.turns
        return tuple(steps)

    def needles(self, draws: ParameterDraws, choices: Sequence[_Choice]) -> list[Floats]:
        """Return the needles (B, K, D) of all draws under each choice, NaN where none is within validity."""

        def place(number: int, shapes: NeedleShapes, rows: slice) -> tuple[Floats]:
            entry, depth, *_ = choices[number].inputs
            drawn = draws.only(np.arange(len(draws))[rows])
            points = drawn.find_points(shapes, np.linspace(0.0, depth, PATH_POINTS), batches[number].steps)
            points = np.where(shapes.valid[:, None, None], points + np.array([0.0, entry, 0.0]), np.nan)
            return (points[..., : len(self.goal.target)],)

        batches = self.insertion.make_batches(draws, [self.way(choice) for choice in choices])
        placed = read_batches(batches, lambda some: simulate_batches(some, self.threads), place)
        return [needles for (needles,) in placed]

    @cached_property
    def still(self) -> Floats:
        """Straight on: entry, depth, base y and base slope, in space roll."""
        bevel, controls = self.insertion.now.bevel, self.insertion.now.controls
        roll = [math.remainder(find_roll(bevel), 360.0)] if self.goal.directions > 1 else []
        return np.array([0.0, self.end, controls.base_y, controls.base_slope, *roll])

    def effort(self, choice: _Choice) -> Floats:
        """Return how far a choice moves entry, base and its slope, as parts of their ranges."""
        low, high = self.bounds
        return ((choice.inputs - self.still) / (high - low))[MOVED]

    def residuals(self, choices: Sequence[_Choice]) -> list[Floats]:
        """Return the misses of each choice over the draws of the search, and how far it moves the base."""
        needles = self.needles(self.search_draws, choices)
        return [
            np.concatenate([compute_residuals(some, self.goal), EFFORT_MM * self.effort(choice)])
            for some, choice in zip(needles, choices, strict=True)
        ]

    @property
    def rules(self) -> _RiskRules:
        """The rules of the risk: those of one needle where parameters are taken as exact."""
        return EXACT if len(self.insertion.samples[0]) == 1 else SAMPLED

    def risks(self, choices: Sequence[_Choice]) -> list[float]:
        """Return the smoothed risk of each choice over the draws of the search, and what its effort costs."""
        needles = self.needles(self.search_draws, choices)
        return [
            _smooth_risk(some, self.goal, self.rules)
            + TURN_RISK * len(choice.turns)
            + EFFORT_RISK * float(np.sum(self.effort(choice) ** 2))
            for some, choice in zip(needles, choices, strict=True)
        ]

    def list_choices(self) -> list[_Choice]:
        """Return the sides and turns of the bevel that are tried, with the base as it stands."""
        now, bevel = self.insertion.now, self.insertion.now.bevel
        begin = self.still.copy()
        if now.depth <= SAME_DEPTH_MM and self.limits.entry_mm:
            begin[ENTRY] = np.clip(self.goal.target[1], self.bounds[0][ENTRY], self.bounds[1][ENTRY])
        bends = self.insertion.rules.bevel_strength(bevel)[0] != 0 or self.insertion.draws is not None
        places = {count: self.rules.density * tried for count, tried in TURN_PLACES.items()}
        turns = [
            turned
            for count in range(1 + self.limits.turns * bends)
            for turned in combinations(_spread(self.stations, places[count]), count)
        ]
        sides = (bevel.side, -bevel.side) if bends else (bevel.side,)
        if self.goal.directions > 1:  # toward the target, or away from it
            y, z = self.goal.target[1], self.goal.target[-1]
            begin[ROLL] = math.degrees(math.atan2(z, y - begin[ENTRY])) if bends else begin[ROLL]
            away = begin.copy()
            away[ROLL] -= math.copysign(180.0, begin[ROLL])
            starts = (begin, away) if bends else (begin,)
            return [_Choice(1, turned, start) for turned, start in product(turns, starts)]
        return [_Choice(side, turned, begin) for turned, side in product(turns, sides)]

    def best(self) -> _Choice:
        """Return the choice of least risk, of this range and of narrower ones.

        Where all miss the target, it is the one of the least expected miss.
        """
        choices = [self._find()]
        if self.risks(choices)[0] - TURN_RISK * len(choices[0].turns) > self.rules.sure_risk:
            limits = self.limits  # with parts of the range of the base, then with half of all ranges
            parts = NESTED_RANGES if limits.base_mm else ()
            ranges = [replace(limits, base_mm=part * limits.base_mm) for part in parts]
            entry, base, angle = limits.entry_mm / 2, limits.base_mm / 2, limits.base_angle_deg / 2
            ranges.append(replace(limits, entry_mm=entry, base_mm=base, base_angle_deg=angle))
            narrower = [replace(self, limits=range_)._find() for range_ in ranges]
            choices += [*narrower, self._lower_risk(self._rank(narrower)[0])]
        return self._rank(choices)[0]

    def best_quickly(self) -> _Choice:
        """Return the choice of the least expected squared miss after a few Gauss-Newton steps."""
        choices = self.list_choices()
        for number in range(QUICK_ROUNDS):
            choices = self._step_once(choices, alike=number == 0 and self.goal.directions == 1)
            choices = self._rank_by_miss(choices)[: self.rules.refined]
        return self._rank_by_miss(choices)[0]

    def describe(self, chosen: _Choice) -> SteeringPlan:
        """Return the plan of a choice, and what becomes of the needles of the draws that test it."""
        way, now, goal = self.way(chosen), self.insertion.now, self.goal
        (needles,), (nominal,) = (
            self.needles(draws, [chosen]) for draws in (self.insertion.samples[1], self.insertion.exact)
        )
        hits = int(np.sum(find_hits(needles, goal)))
        low, high = wilson_interval(hits / len(needles), len(needles))
        touched = {
            obstacle.name: float(np.mean(compute_clearances(needles, obstacle, goal) < 0))
            for obstacle in goal.obstacles
        }
        turns = (now.depth,) * (way[0].bevel != now.bevel) + chosen.turns
        least, most = self.bounds
        near = LIMIT_PART * (most - least)
        is_at_end = (np.abs(chosen.inputs - self.still) > near) & (
            (chosen.inputs <= least + near) | (chosen.inputs >= most - near)
        )
        at_limit = tuple(name for name, met in zip(LIMITED, is_at_end[MOVED], strict=True) if met)
        entry = float(chosen.inputs[ENTRY])
        return SteeringPlan(
            entry, way, turns, goal, needles, nominal[0], hits, low, high, touched, at_limit=at_limit
        )

    def _find(self) -> _Choice:
        """Return the best choice of this range alone."""
        tried = self._step_once(self.list_choices())
        count = self.rules.refined
        shifted = map(self._shift_turns, self._rank(tried)[:count])
        minima = [self._minimize(choice) for choice in shifted]
        minima = self._rank(minima)
        return self._rank([*map(self._lower_risk, minima[: count - 1]), minima[0]])[0]

    def _shift_turns(self, choice: _Choice) -> _Choice:
        """Return a choice whose turns are moved, a constraint point at a time, to the least expected miss."""
        for _ in self.stations:
            moved = [choice]
            for n, turn in enumerate(choice.turns):
                before, after, place = choice.turns[:n], choice.turns[n + 1 :], self.stations.index(turn)
                near = {*self.stations[max(place - 1, 0) : place + 2]} - {*choice.turns}
                moved += [replace(choice, turns=(*before, depth, *after)) for depth in sorted(near)]
            best = self._rank_by_miss([choice, *self._step_once(moved)])[0]
            if best.turns == choice.turns:
                return best
            choice = best
        return choice

    def _minimize(self, choice: _Choice) -> _Choice:
        """Return the choice of the least expected squared miss nearby."""
        (low, high), steps = self.bounds, DIFFERENCE_STEPS[: len(choice.inputs)]

        def residuals(inputs: Floats, *moved: Floats) -> Floats:
            return np.squeeze(self.residuals([replace(choice, inputs=place) for place in (inputs, *moved)]))

        def slopes(inputs: Floats) -> Floats:
            moves = np.diag(np.where(inputs + steps > high, -steps, steps))
            still, *moved = residuals(inputs, *(inputs + moves))  # all at once
            return np.transpose((np.array(moved) - still) / moves.sum(axis=1)[:, None])

        from scipy.optimize import least_squares  # late: it takes 0.3 s to load

        solution = least_squares(
            residuals,
            np.clip(choice.inputs, low + 1e-6, high - 1e-6),
            slopes,
            bounds=(low, high),
            xtol=SEARCH_TOLERANCE,
            ftol=SEARCH_TOLERANCE,
            max_nfev=MAX_EVALUATIONS,
        )
        return replace(choice, inputs=solution.x)

    def _rank(self, choices: Sequence[_Choice]) -> list[_Choice]:
        """Return choices, that of least risk first."""
        values = self.risks(choices)
        if not self.rules.sloped and min(values) >= CERTAIN_RISK:
            return self._rank_by_miss(choices)
        return [choices[n] for n in np.argsort(values, kind="stable")]

    def _rank_by_miss(self, choices: Sequence[_Choice]) -> list[_Choice]:
        """Return choices, that of the least expected squared miss first."""
        values = [
            float(np.sum(misses**2)) + EFFORT_MM**2 * len(choice.turns)
            for choice, misses in zip(choices, self.residuals(choices), strict=True)
        ]
        return [choices[n] for n in np.argsort(values, kind="stable")]

    def _step_once(self, choices: Sequence[_Choice], *, alike: bool = False) -> list[_Choice]:
        """Return choices after one Gauss-Newton step each, all their needles simulated together.

        `alike`: all have the slopes of the first, which is nearly so while turns of the bevel alone differ.
        """
        low, high = self.bounds
        weights = high - low  # of equal size within the bounds
        free = np.flatnonzero(weights > 1e-3)  # what is fixed has a margin
        moves, differed = np.diag(DIFFERENCE_STEPS[: len(weights)])[free], choices[:1] if alike else choices
        shifted = [replace(choice, inputs=choice.inputs + move) for choice in differed for move in moves]
        values, stepped = self.residuals([*choices, *shifted]), []
        for n, (choice, here) in enumerate(zip(choices, values[: len(choices)], strict=True)):
            if n < len(differed):
                moved = values[len(choices) + len(moves) * n :][: len(moves)]
                slopes = (np.array(moved) - here).T / DIFFERENCE_STEPS[free]
            step = np.zeros(len(weights))
            step[free] = np.linalg.lstsq(slopes * weights[free], -here, rcond=1e-6)[0] * weights[free]
            stepped.append(replace(choice, inputs=np.clip(choice.inputs + step, low, high)))
        return stepped

    def _lower_risk(self, choice: _Choice) -> _Choice:
        """Return a choice of lower risk nearby: the least expected miss is not always it.

        Where the risk is certain it has no slope, and the choice stays.
        """
        if not self.rules.sloped and self.risks([choice])[0] >= CERTAIN_RISK:
            return choice
        low, high = self.bounds
        size = 0.05 * (high - low)

        def risk(inputs: Floats) -> float:
            return self.risks([replace(choice, inputs=np.clip(inputs, low, high))])[0]

        start = choice.inputs
        simplex = np.vstack([start, start + np.diag(np.where(start + size > high, -size, size))])
        from scipy.optimize import minimize  # late: it takes 0.3 s to load

        solution = minimize(
            risk,
            start,
            method="Nelder-Mead",
            options={"maxfev": self.rules.evaluations, "initial_simplex": simplex},
        )
        inputs = np.clip(solution.x, low, high)
        return replace(choice, inputs=inputs) if solution.fun < risk(start) - 1e-3 else choice


def _spread(stations: Sequence[float], count: int) -> tuple[float, ...]:
    """Return so many of the stations, evenly spread, none at the ends; all if there are fewer."""
    if len(stations) <= count:
        return tuple(stations)
    places = np.linspace(0, len(stations) - 1, count + 2)[1:-1]
    return tuple(dict.fromkeys(stations[round(place)] for place in places))


def _smooth_risk(needles: Floats, goal: Goal, rules: _RiskRules) -> float:
    """Return the mean over draws of a smooth step from 1, far outside the target or in an obstacle, to 0."""
    misses = compute_misses(needles, goal)
    margins = np.array(
        [goal.radius - misses, *(compute_clearances(needles, obstacle, goal) for obstacle in goal.obstacles)]
    )
    margins = np.nan_to_num(margins, nan=-1e3)
    off = np.minimum(np.nan_to_num(misses, nan=np.inf) / goal.radius, 1.0)
    with np.errstate(over="ignore"):
        risk = 1 / (1 + np.exp(margins.min(axis=0) / (rules.width * goal.radius))) + rules.miss_risk * off**2
    if rules.sloped:
        risk = risk + np.maximum(-margins, 0.0).sum(axis=0) / goal.radius
    return float(np.mean(risk))
