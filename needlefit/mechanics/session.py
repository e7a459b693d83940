"""Sessions: simulate a needle step by step, for interactive use."""

import copy
import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Generic, Self, TypeVar

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.insertion_limits import check_reach, check_size
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import (
    PackedStops,
    compute_turn,
    find_flags,
    list_tip,
    pack_plan,
    pack_problem,
)
from needlefit.mechanics.plan import (
    SAME_DEPTH_MM,
    Lattice,
    Move,
    Position,
    TipStop,
    find_input_path,
    list_rays,
    plan_move,
    plan_moves,
)
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import list_depths, read_shape
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import compute_scales
from needlefit.schemas.limits import MAX_ELEMENTS, MAX_GUIDES, MAX_STEPS

_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()
T = TypeVar("T")
# None stands for a tip that is not tracked, so a further value is needed for `as it was`.
_UNCHANGED: Any = object()


@dataclass(frozen=True)
class NeedleState:
    """The state of a needle: its shape in C, its depth and inputs, and its tissue."""

    shape: NeedleShape
    step: Step
    tissue: Tissue


class Session:
    """A needle that is inserted step by step, each step from its present state.

    With the same first cell and the same steps it finds the same bits as `simulate.simulate_steps`; steps
    that only divide a longer one change nothing at its end.

    Parameters
    ----------
    needle : Needle
    tissue : Tissue
    bevel : Bevel
        As the insertion begins.
    first_cell : float
        Depth of the first constraint point, mm, up to the constraint spacing of `rules`; part of the
        model, to be kept with a recording. `simulate_steps` by default takes what lets the last step end on
        one.
    controls : Controls
        As the insertion begins.
    rules : ModelOptions

    Attributes
    ----------
    last : Step
        Where the needle stands, and under which inputs.
    failures : Counter
        How many steps failed, by reason.
    solved : int
        Equilibria asked of the solver so far.
    """

    # What the kernel reads, and the controls that it holds; `_hold` makes them.
    _problem: native.Problem
    _held: Controls
    _memory: native.SessionMemory

    def __init__(
        self,
        needle: Needle,
        tissue: Tissue,
        bevel: Bevel,
        first_cell: float = 1.0,
        controls: Controls = _DEFAULT_CONTROLS,
        rules: ModelOptions = _DEFAULT_OPTIONS,
    ) -> None:
        self.needle, self.tissue, self.rules = needle, tissue, rules
        self.lattice = Lattice(first_cell, rules.spacing)
        self.last = Step(0.0, bevel, controls)
        self.failures: Counter[str] = Counter()
        self.solved = 0
        self._boundaries = tissue.boundaries.tolist()
        self._scales = [  # of a tip in each layer
            compute_scales(tissue, needle.flexural_rigidity, end, rules.spacing)
            for end in (*self._boundaries, math.inf)
        ]
        self._position = Position()
        self._bevels, self._controls = _InputIds[Bevel](), _InputIds[Controls]()
        self._deepest = min(needle.length, MAX_ELEMENTS * rules.element)
        self._guides, self._rays = MAX_GUIDES, math.ceil(self._deepest / rules.spacing)
        self._hold(controls)
        self._memory = native.SessionMemory(self._problem)
        self._shape = self.go(self.last)

    @property
    def now(self) -> NeedleState:
        """The present state of the needle."""
        return NeedleState(self._shape, self.last, self.tissue)

    @property
    def depth(self) -> float:
        """Inserted arc length, mm."""
        return self.last.depth

    def step(
        self,
        insert: float = 0.0,
        *,
        bevel: Bevel | None = None,
        base: tuple[float, float] | None = None,
        guides: tuple[Guide, ...] | None = None,
        tip: TrackedTip | None = _UNCHANGED,
    ) -> NeedleShape:
        """Change some inputs, then insert or retract; inputs that are not given stay as they are.

        Parameters
        ----------
        insert : float
            How far the tip goes in, mm; out, where it is negative.
        bevel : Bevel
        base : (y, slope)
            Of the base in C, mm and 1.
        guides : tuple of Guide
            All guides there are from now on.
        tip : TrackedTip or None
            Where a tracker sees the tip; None: it is not tracked any more.

        Returns
        -------
        NeedleShape
            Where `converged` is False the needle has stayed as it was before.

        Raises
        ------
        ModelError
            If the needle does not reach that far, would leave the tissue backwards, or has cut more rays than
            `MAX_STEPS` and `MAX_ELEMENTS` allow.
        """
        depth, controls = self.last.depth + insert, self.last.controls
        if base is not None:
            controls = replace(controls, base_y=base[0], base_slope=base[1])
        if guides is not None:
            controls = replace(controls, guides=guides)
        if tip is not _UNCHANGED:
            controls = replace(controls, tip=tip)
        return self.go(Step(0.0 if abs(depth) < SAME_DEPTH_MM else depth, bevel or self.last.bevel, controls))

    def go(self, step: Step, *, valid_only: bool = False) -> NeedleShape:
        """Move the tip to the depth of `step` under its inputs; returns and raises as `Session.step`.

        Parameters
        ----------
        valid_only : bool
            Whether a needle within the model's validity stays as it was where the step leads outside.
        """
        check_reach(self.needle.length, step.depth, step.controls)
        if step.depth > self._deepest:  # a single step is too large if it is too deep, and only then
            check_size((step.depth,), self.rules)
        return self._go(step, valid_only)

    def copy(self) -> Self:
        """Return an independent second needle in the same state."""
        other = copy.copy(self)
        other.failures = self.failures.copy()
        other._bevels, other._controls = self._bevels.copy(), self._controls.copy()
        other._memory = self._memory.copy()
        other._hold(self._held)
        return other

    def input_path(self) -> tuple[Step, ...]:
        """Return the shortest steps that lead from first contact to the present state."""
        bevels, controls = self._bevels.values(), self._controls.values()
        return find_input_path(
            self._position,
            self.last,
            self.lattice,
            lambda ray: (bevels[ray.bevel_id], controls[ray.controls_id]),
        )

    def simulate_again(
        self, tissue: Tissue | None = None, offset: float | None = None, cut_angle: float | None = None
    ) -> "Session":
        """Simulate the same steps in another tissue, or with another strength of the bevel throughout.

        Its `failures` say whether a step of it failed; it then stands where that step began.

        Parameters
        ----------
        tissue : Tissue, optional
        offset, cut_angle : float, optional
            b, mm, or theta, rad, of every step.
        """
        given: dict[str, Any] = {} if offset is None else {"offset": offset}
        given |= {} if cut_angle is None else {"cut_angle": cut_angle}
        steps = tuple(replace(s, bevel=replace(s.bevel, **given)) for s in self.input_path())
        bevel, controls = steps[0].bevel, steps[0].controls
        tissue = tissue or self.tissue
        other = Session(self.needle, tissue, bevel, self.lattice.first_cell, controls, self.rules)
        if not other._go_through(steps):
            # The state is lost: step by step the needle stands where the failed step began.
            other = Session(self.needle, tissue, bevel, self.lattice.first_cell, controls, self.rules)
            for step in steps:
                if not other.go(step).converged:
                    break
        return other

    def _go_through(self, steps: tuple[Step, ...]) -> bool:
        """Go through an input path from first contact at once; returns whether all of it converged.

        If not, the session must not be used any more. Shapes on the way are not read, and the plan of a path
        is kept: a hand on a slider simulates the same one again and again.
        """
        moves = tuple(Move(s.depth, self._bevels.of(s.bevel), self._controls.of(s.controls)) for s in steps)
        position, packed = _plan_path(moves, self.lattice)
        self._make_room(packed.rays)
        bevels, controls = self._bevels.values(), self._controls.values()
        # the numbers of inputs in the plan are those of this session, and not of steps
        deepest = Step(self._deepest, self.last.bevel, self.last.controls)
        inputs = [Step(0.0, bevels[i], self.last.controls) for i in packed.bevels]
        inputs += [Step(0.0, self.last.bevel, controls[i]) for i in packed.controls]
        own = packed._replace(
            bevels=tuple(range(len(packed.bevels))), controls=tuple(range(len(packed.bevels), len(inputs)))
        )
        problem = self._pack((*inputs, deepest), own)
        memory = native.SessionMemory(problem)  # the plan begins with the stop at the entry
        shapes = native.make_shapes(problem, packed.last.cell + 1)
        self.solved = len(packed.stops)
        memory.advance(problem, shapes)
        if shapes.arrays["status"][0] != native.CONVERGED:
            return False
        memory.accept()
        self._memory, self._position, self.last = memory, position, steps[-1]
        self._hold(self.last.controls)
        self._shape = self._read(shapes, packed.last)
        return True

    def _go(self, step: Step, valid_only: bool = False) -> NeedleShape:
        move = Move(step.depth, self._bevels.of(step.bevel), self._controls.of(step.controls))
        position, stops = plan_move(self._position, move, self.lattice)
        self.solved += len(stops)
        if not stops:  # only the bevel was turned
            shape = replace(self._shape, iterations=0)
        else:
            shapes = self._prepare(stops, step)
            self._memory.advance(self._problem, shapes)
            shape = self._read(shapes, stops[-1])
            if not shape.converged:
                self.failures[shape.status] += 1
                return shape
            if valid_only and self._shape.valid and not shape.valid:
                return shape
            self._memory.accept()
        self._position, self.last, self._shape = position, step, shape
        if self._bevels.full or self._controls.full:
            rays = list_rays(position)
            self._bevels.drop_unused({move.bevel_id, *(ray.bevel_id for ray in rays)})
            self._controls.drop_unused({move.controls_id, *(ray.controls_id for ray in rays)})
        return shape

    def _find_scales(self, depth: float) -> Floats:
        return self._scales[bisect_left(self._boundaries, depth)]

    def _read(self, shapes: native.Shapes, stop: TipStop) -> NeedleShape:
        return read_shape(shapes, list_depths(stop, self.lattice), self._find_scales(stop.tip))

    def _prepare(self, stops: Sequence[TipStop], step: Step) -> native.Shapes:
        """Write the stops and inputs of a step into the arrays that the kernel reads; return room for shapes."""
        controls, rays = step.controls, stops[-1].ray + 1
        _check_rays(rays)
        self._make_room(rays)
        arrays = self._problem.arrays
        if controls.guides != self._held.guides or len(stops) > len(arrays["stops"]):
            self._hold(controls, len(stops))
            arrays = self._problem.arrays
        elif controls is not self._held:
            self._held = controls
            arrays["base"][0, 0] = controls.base_y, controls.base_slope, controls.stage_slope
            arrays["held_tip"][0] = list_tip(controls)
        # rays that open now are cut by this bevel; the kernel does not read the turn of the others
        arrays["turn"][0, 0] = compute_turn(step.bevel, self.rules)
        for n, stop in enumerate(stops):
            arrays["stops"][n] = stop.tip, stop.cell, max(stop.ray, 0), 0, 0, find_flags(stop)
        self._problem.stop_count = len(stops)
        return native.make_shapes(self._problem, stops[-1].cell + 1)

    def _make_room(self, rays: int) -> None:
        """Make room in the kernel's state for so many rays."""
        if rays > self._rays:
            # Doubled, so that a session that adds rays one by one copies its state only a few times.
            self._rays = max(2 * rays, self._rays)
            self._problem.rays = self._rays
            self._memory.grow(self._problem)

    def _hold(self, controls: Controls, stops: int = 8) -> None:
        """Hold the needle by these controls, with room for so many stops."""
        self._held = controls
        packed = PackedStops(
            np.zeros(stops, native.STOP), (0,), (0,), TipStop(0.0, 0, False, 0, False, 0, 0), 1
        )
        self._problem = self._pack((Step(self._deepest, self.last.bevel, controls),), packed)

    def _pack(self, steps: tuple[Step, ...], packed: PackedStops) -> native.Problem:
        return pack_problem(
            self.needle, self.tissue, steps, self.lattice, self.rules, packed,
            rays=self._rays, guides=self._guides,
        )  # fmt: skip


@lru_cache(maxsize=4)  # the last paths alone: of a long one the plan takes megabytes
def _plan_path(moves: tuple[Move, ...], lattice: Lattice) -> tuple[Position, PackedStops]:
    """Return the position after a path, and its stops in the form that the kernel reads."""
    position, stops = plan_moves(moves, lattice)
    return position, pack_plan(stops)


def _check_rays(count: int) -> None:
    """Raise ModelError where a needle would have cut too many rays: each is kept, and may be cut again."""
    if count > MAX_STEPS + MAX_ELEMENTS:
        raise ModelError(
            f"the needle has changed its direction of cutting {count} times",
            expected=f"at most {MAX_STEPS + MAX_ELEMENTS} times",
            fix="retract it, or begin anew",
        )


class _InputIds(Generic[T]):
    """Numbers that identify inputs in the plan: equal inputs have equal numbers."""

    def __init__(self) -> None:
        self._numbers: dict[T, int] = {}
        self._next, self._max_kept = 0, 256
        self._last: tuple[T | None, int] = None, -1

    def copy(self) -> "_InputIds[T]":
        """Return the same numbers for the same inputs."""
        other = copy.copy(self)
        other._numbers = self._numbers.copy()
        return other

    def values(self) -> dict[int, T]:
        """Return the inputs by their numbers."""
        return {number: value for value, number in self._numbers.items()}

    def of(self, value: T) -> int:
        """Return the number of an input."""
        if value is not self._last[0]:  # mostly it is, and need not be hashed
            if value not in self._numbers:
                self._numbers[value] = self._next
                self._next += 1
            self._last = value, self._numbers[value]
        return self._last[1]

    @property
    def full(self) -> bool:
        """Whether unused inputs should be dropped, so that the memory of a long session stays bounded."""
        return len(self._numbers) > self._max_kept

    def drop_unused(self, used: set[int]) -> None:
        """Drop all inputs but those of some numbers."""
        self._numbers = {value: number for value, number in self._numbers.items() if number in used}
        self._max_kept = 256 + 2 * len(self._numbers)
