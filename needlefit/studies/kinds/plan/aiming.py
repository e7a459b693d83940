"""Predict the tip of a planned needle for every draw, and find the plan with the smallest expected miss.

A plan is where the needle enters, at what angle, how deep, and to which side its bevel faces. Draws of the
parameters each have a bevel of this insertion and errors of their own: the entry is shifted across and
turned, the needle stops short or goes too far, the layers' boundaries lie elsewhere, all as the dataset
states them of one insertion. In a specimen that was not tuned on the parameters differ (`new_specimens`).

What is minimised is the mean square of the miss over draws, always the same ones (common random numbers),
with the wish to pass by obstacles as a penalty. Meanwhile the layers are those that the needle of the middle
draw meets; what is reported of a plan comes of other draws, each with the layers on its own path.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, split_boundary_sd
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.nodes import enforce_order
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.studies.job import Job
from needlefit.studies.kinds.plan.schema import EntryPlaneRecord, ObstacleRecord, PlanRecord
from needlefit.studies.kinds.plan.search import (
    PATH_POINTS,
    Goal,
    compute_clearances,
    compute_residuals,
    minimize_miss,
)
from needlefit.studies.planned_draws import MAX_LAYERS
from needlefit.studies.planned_insertions import planned_layers

Values = dict[str, float]

DIFFERENCE_STEPS = np.array([0.05, 0.05, 0.05])
"""Of the differences: offset (mm), angle (degrees), depth (mm). Where a boundary passes a constraint point,
tips move steeply; their mean over draws does so less."""

MISSING_PATH = np.full((PATH_POINTS, 2), np.nan)
"""The path of a needle without a solution."""


@dataclass(frozen=True)
class Aim:
    """One plan: offset (mm), angle (degrees), depth (mm), and the bevel side, +1 or -1."""

    offset: float
    angle: float
    depth: float
    side: int


@dataclass(frozen=True)
class ExecutionDraw:
    """One draw: parameter values (Pa, mm), and the errors with which the plan is executed."""

    values: Values
    across: float
    turn: float
    deep: float
    wrong: Floats


@dataclass(frozen=True)
class TargetSite:
    """The target, its plane, the obstacles and the tissue.

    Attributes
    ----------
    job : Job
    like : Insertion
        Its errors and its medium's surfaces, or depths where it has none.
    record : PlanRecord
    """

    job: Job
    like: Insertion
    record: PlanRecord

    @property
    def plane(self) -> Frame:
        """The plane of the plan: its x, y and normal in the world."""
        entry_plane = self.record.entry_plane
        return make_entry_frame(entry_plane.position_mm, normalize(entry_plane.direction), entry_plane.across)

    def insertion(self, aim: Aim, across: float = 0.0, turn: float = 0.0) -> Insertion:
        """Return an aim as an insertion with execution errors, still without layers."""
        plane, angle = self.plane, math.radians(aim.angle) + turn
        x, y = plane.rotation[:, 0], plane.rotation[:, 1]
        ahead, left = math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x
        frame = make_entry_frame(plane.origin + aim.offset * y + across * left, ahead, left)
        return replace(self.like, frame=frame, depth=aim.depth, side=aim.side)

    def layered(self, insertion: Insertion, values: Values) -> Insertion | None:
        """Return an insertion with the layers on its path; None if the iteration does not converge."""
        if not insertion.surfaces:
            return insertion

        def shape(boundaries: Floats, sequence: tuple[int, ...]) -> NeedleShape:
            return self.shape(replace(insertion, boundaries=boundaries, sequence=sequence), values)

        found = planned_layers(insertion, shape)
        if found is None or max(found[1]) > self.job.medium.layers:
            return None
        return replace(insertion, boundaries=found[0], sequence=found[1])

    def shape(self, insertion: Insertion, values: Values) -> NeedleShape:
        """Return the simulated needle for `values`."""
        return predict(values, self.job.medium, self.job.dataset.needle, insertion)

    def path(self, insertion: Insertion, trial: ExecutionDraw) -> Floats | None:
        """Return the needle (STATIONS, 2) of a trial in the plane, through given layers; None without one."""
        count = len(insertion.boundaries)
        wrong = np.hypot(*split_boundary_sd(self.like)) * trial.wrong[:count]
        boundaries = enforce_order(insertion.boundaries + wrong)
        executed = replace(insertion, depth=insertion.depth + trial.deep, boundaries=boundaries)
        shape = self.shape(executed, trial.values)
        if not shape.converged:
            return None
        points = compute_positions(shape, np.linspace(0.0, shape.depth, PATH_POINTS))
        world = insertion.frame.to_world(np.column_stack([points, np.zeros(PATH_POINTS)]))
        flat: Floats = self.plane.to_local(world)[:, :2]
        return flat

    def paths(self, aim: Aim, trials: Sequence[ExecutionDraw], middle: Values) -> list[Floats | None]:
        """Return the needle of every trial, all through the layers that `middle` values meet."""
        met = self.layered(self.insertion(aim), middle)
        if met is None:
            return [None] * len(trials)
        erring = (self.insertion(aim, trial.across, trial.turn).frame for trial in trials)
        return [
            self.path(replace(met, frame=frame), trial) for frame, trial in zip(erring, trials, strict=True)
        ]

    def executed(self, aim: Aim, trial: ExecutionDraw) -> Floats | None:
        """Return the needle (STATIONS, 2) of a trial through the layers on its own path."""
        met = self.layered(self.insertion(aim, trial.across, trial.turn), trial.values)
        return None if met is None else self.path(met, trial)


def draw_execution(values: Values, like: Insertion, rng: np.random.Generator) -> ExecutionDraw:
    """Return a draw with the execution errors that `like` states."""
    across, turn, deep = rng.standard_normal(3) * (like.pose_shift_sd, like.pose_angle_sd, like.depth_sd)
    return ExecutionDraw(values, float(across), float(turn), float(deep), rng.standard_normal(MAX_LAYERS))


def execute_exactly(values: Values) -> ExecutionDraw:
    """Return a draw without execution errors."""
    return ExecutionDraw(values, 0.0, 0.0, 0.0, np.zeros(MAX_LAYERS))


def clearance(path: Floats, obstacle: ObstacleRecord) -> float:
    """Return the distance, mm, of a needle (K, 2) from the rim of an obstacle; negative inside it."""
    return float(compute_clearances(path[None], obstacle)[0])


def aim_straight(entry_plane: EntryPlaneRecord, target: tuple[float, float], angle: float, side: int) -> Aim:
    """Return the plan that would hit if the needle went straight, limited to the allowed ranges."""
    slope = math.tan(math.radians(angle))
    offset = np.clip(target[1] - target[0] * slope, *entry_plane.offset_mm)
    depth = np.clip(math.hypot(target[0], target[1] - offset), *entry_plane.depth_mm)
    return Aim(float(offset), angle, float(depth), side)


@dataclass(frozen=True)
class OptimizedAim:
    """An optimised plan, and the root mean square of its miss (mm) over the draws it was optimised on."""

    aim: Aim
    rms: float


def optimize_aim(site: TargetSite, trials: Sequence[ExecutionDraw], middle: Values) -> OptimizedAim:
    """Return the plan with the smallest miss over some draws; several starts and both bevel sides are tried.

    Of plans that are equally good, to a micrometre, it is the one begun first: at the middle angle, bevel
    toward +y.
    """
    low, high = site.record.entry_plane.angle_deg
    angles = [0.5 * (low + high), low + 0.2 * (high - low), high - 0.2 * (high - low)]
    entry_plane, target = site.record.entry_plane, site.record.target_mm
    starts = [aim_straight(entry_plane, target, angle, side) for angle in angles for side in (1, -1)]
    return min(
        (_search_from(site, trials, middle, start) for start in starts), key=lambda one: round(one.rms, 3)
    )


def _search_from(
    site: TargetSite, trials: Sequence[ExecutionDraw], middle: Values, start: Aim
) -> OptimizedAim:
    entry_plane, goal = site.record.entry_plane, Goal(site.record.target_mm, obstacles=site.record.obstacles)
    low, high = np.array([entry_plane.offset_mm, entry_plane.angle_deg, entry_plane.depth_mm]).T

    def residuals(at: Floats) -> Floats:
        paths = site.paths(_make_aim(at, start.side), trials, middle)
        return compute_residuals(np.array([MISSING_PATH if path is None else path for path in paths]), goal)

    def many(choices: Sequence[Floats]) -> list[Floats]:
        return [residuals(at) for at in choices]

    begin = np.array([start.offset, start.angle, start.depth])
    found, rms = minimize_miss(residuals, many, begin, (low, high), DIFFERENCE_STEPS)
    return OptimizedAim(_make_aim(found, start.side), rms)


def _make_aim(at: Floats, side: int) -> Aim:
    offset, angle, depth = at.tolist()
    return Aim(offset, angle, depth, side)
