"""Predict the tip of a planned needle for every draw, and find the plan with the smallest expected miss.

A plan is where the needle enters, at what angle, how deep, and to which side its bevel faces. Draws of the
parameters each have a bevel of this insertion and errors of their own: the entry is shifted across and
turned, the needle stops short or goes too far, the layers' boundaries lie elsewhere, all as the dataset
states them of one insertion.

What is minimised is the mean square of the miss over draws, always the same ones (common random numbers),
with the wish to pass by obstacles as a penalty. Meanwhile the layers are those that the needle of the middle
draw meets; what is reported of a plan comes of other draws, each with the layers on its own path.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, split_boundary_sd
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.nodes import enforce_order
from needlefit.inference.planned_layers import MAX_DRAWN_LAYERS, with_planned_layers
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.planning.goals import PATH_POINTS, Goal, compute_residuals, minimize_miss
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.planning import EntryPlaneRecord

Values = dict[str, float]

DIFFERENCE_STEPS = np.array([0.05, 0.05, 0.05])
"""Of the differences: offset (mm), angle (degrees), depth (mm). Where a boundary passes a constraint point,
tips move steeply; their mean over draws does so less."""

MISSING_PATH = np.full((PATH_POINTS, 2), np.nan)  #: the path of a needle without a solution


@dataclass(frozen=True)
class Aim:
    """One plan: offset (mm), angle (degrees), depth (mm), and the bevel side, +1 or -1."""

    offset: float
    angle: float
    depth: float
    side: int
    rms: float | None = None  #: root mean square miss, mm, over the draws on which it was optimised


@dataclass(frozen=True)
class ExecutionDraw:
    """One draw: parameter values (Pa, mm), and the errors of the plan's execution; by default none."""

    values: Values
    across: float = 0.0  #: shift of the entry, mm
    turn: float = 0.0  #: rad
    deep: float = 0.0  #: error of the depth, mm
    wrong: Floats = field(default_factory=lambda: np.zeros(MAX_DRAWN_LAYERS))  #: of boundaries, in SDs


def draw_execution(values: Values, like: Insertion, rng: np.random.Generator) -> ExecutionDraw:
    """Return a draw with the execution errors that `like` states."""
    errors = rng.standard_normal(3) * (like.pose_shift_sd, like.pose_angle_sd, like.depth_sd)
    across, turn, deep = errors.tolist()
    return ExecutionDraw(values, across, turn, deep, rng.standard_normal(MAX_DRAWN_LAYERS))


@dataclass(frozen=True)
class TargetSite:
    """The target, the plane of the plan, and the tissue."""

    medium: MediumRecord
    needle: Needle
    like: Insertion  #: its errors, and its medium's surfaces, or depths where it has none
    entry_plane: EntryPlaneRecord
    goal: Goal

    @property
    def plane(self) -> Frame:
        """The plane of the plan: its x, y and normal in the world."""
        plane = self.entry_plane
        return make_entry_frame(plane.position_mm, normalize(plane.direction), plane.across)

    def find_paths(self, aim: Aim, trials: Sequence[ExecutionDraw], middle: Values) -> list[Floats | None]:
        """Return the needle of every trial, all through the layers that `middle` values meet."""
        met = self._with_layers(self._insert(aim), middle)
        if met is None:
            return [None] * len(trials)
        frames = (self._insert(aim, trial.across, trial.turn).frame for trial in trials)
        return [self._simulate(replace(met, frame=at), one) for at, one in zip(frames, trials, strict=True)]

    def execute(self, aim: Aim, trial: ExecutionDraw) -> Floats | None:
        """Return the needle (PATH_POINTS, 2) of a trial through the layers on its own path."""
        met = self._with_layers(self._insert(aim, trial.across, trial.turn), trial.values)
        return None if met is None else self._simulate(met, trial)

    def _insert(self, aim: Aim, across: float = 0.0, turn: float = 0.0) -> Insertion:
        """Return an aim as an insertion with execution errors, still without layers."""
        plane, angle = self.plane, math.radians(aim.angle) + turn
        x, y = plane.rotation[:, 0], plane.rotation[:, 1]
        ahead, left = math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x
        frame = make_entry_frame(plane.origin + aim.offset * y + across * left, ahead, left)
        return replace(self.like, frame=frame, depth=aim.depth, side=aim.side)

    def _with_layers(self, insertion: Insertion, values: Values) -> Insertion | None:
        return with_planned_layers(insertion, values, self.medium, self.needle)

    def _simulate(self, insertion: Insertion, trial: ExecutionDraw) -> Floats | None:
        """Return the needle of a trial in the plane, through given layers; None without a solution."""
        wrong = np.hypot(*split_boundary_sd(self.like)) * trial.wrong[: len(insertion.boundaries)]
        boundaries = enforce_order(insertion.boundaries + wrong)
        executed = replace(insertion, depth=insertion.depth + trial.deep, boundaries=boundaries)
        shape = predict(trial.values, self.medium, self.needle, executed)
        if not shape.converged:
            return None
        points = compute_positions(shape, np.linspace(0.0, shape.depth, PATH_POINTS))
        world = insertion.frame.to_world(np.column_stack([points, np.zeros(PATH_POINTS)]))
        return self.plane.to_local(world)[:, :2]


def aim_straight(plane: EntryPlaneRecord, target: tuple[float, float], angle: float, side: int) -> Aim:
    """Return the plan that would hit if the needle went straight, limited to the allowed ranges."""
    slope = math.tan(math.radians(angle))
    offset = np.clip(target[1] - target[0] * slope, *plane.offset_mm)
    depth = np.clip(math.hypot(target[0], target[1] - offset), *plane.depth_mm)
    return Aim(float(offset), angle, float(depth), side)


def optimize_aim(site: TargetSite, trials: Sequence[ExecutionDraw], middle: Values) -> Aim:
    """Return the plan with the smallest miss over some draws; several starts and both bevel sides are tried.

    Of plans that are equally good, to a micrometre, it is the one begun first: at the middle angle, bevel
    toward +y.
    """
    bounds = np.array(list(site.entry_plane.ranges.values())).T
    low, high = site.entry_plane.angle_deg
    angles = [0.5 * (low + high), low + 0.2 * (high - low), high - 0.2 * (high - low)]

    def make_aim(at: Floats, side: int, rms: float | None = None) -> Aim:
        offset, angle, depth = at.tolist()
        return Aim(offset, angle, depth, side, rms)

    def search(angle: float, side: int) -> tuple[float, Aim]:
        def residuals(choices: Sequence[Floats]) -> list[Floats]:
            paths = (site.find_paths(make_aim(at, side), trials, middle) for at in choices)
            needles = (np.array([MISSING_PATH if one is None else one for one in some]) for some in paths)
            return [compute_residuals(some, site.goal) for some in needles]

        start = aim_straight(site.entry_plane, site.goal.target, angle, side)
        begin = np.array([start.offset, start.angle, start.depth])
        found, rms = minimize_miss(residuals, begin, (bounds[0], bounds[1]), DIFFERENCE_STEPS)
        return rms, make_aim(found, side, rms)

    found = [search(angle, side) for angle in angles for side in (1, -1)]
    return min(found, key=lambda one: round(one[0], 3))[1]
