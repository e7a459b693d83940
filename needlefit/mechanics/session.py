"""Sessions: simulate a needle step by step, for interactive use."""

import copy
import math
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.doubts import warn_of_units
from needlefit.mechanics.needle import Needle, require_type
from needlefit.mechanics.packing import PackedStops, compute_turn, count_planes, list_tip, pack_problem
from needlefit.mechanics.plan import SAME_DEPTH_MM, Lattice, TipStop, check_reach, check_size, find_input_path
from needlefit.mechanics.shape import NeedleShape, compute_scales
from needlefit.mechanics.simulate import STATUS_NAMES
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import find_roll, follow_hub
from needlefit.schemas.limits import MAX_ELEMENTS, MAX_GUIDES, MAX_STEPS

_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()
T = TypeVar("T")
# value for `as it was`: None stands for a tip that is not tracked
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
    bevel : Bevel
        As the insertion begins.
    first_cell : float
        Depth of the first constraint point, mm, up to the constraint spacing of `rules`; part of the
        model, to be kept with a recording. `simulate_steps` by default takes what lets the last step end on
        one.
    controls : Controls
        As the insertion begins.
    planned : tuple of Step
        Steps that will follow, as far as they are known. Where a step that is not among them leads the
        needle out of the plane z = 0, all steps are simulated again, along its `input_path`.
    """

    # What the kernel reads, and the controls that it holds; `_hold` makes them.
    _problem: native.KernelProblem
    _held: Controls
    _cut: Bevel
    # views of the arrays that a step changes
    _base: Floats
    _tip: Floats
    _turn: Floats
    _memory: native.SessionMemory

    def __init__(
        self,
        needle: Needle,
        tissue: Tissue,
        bevel: Bevel,
        first_cell: float = 1.0,
        controls: Controls = _DEFAULT_CONTROLS,
        rules: ModelOptions = _DEFAULT_OPTIONS,
        *,
        planned: tuple[Step, ...] = (),
    ) -> None:
        require_type("needle", needle, Needle)
        require_type("tissue", tissue, Tissue)
        require_type("rules", rules, ModelOptions)
        self.needle, self.tissue, self.rules = needle, tissue, rules
        self.lattice = Lattice(first_cell, rules.spacing)
        #: where the needle stands, and under which inputs
        self.last = Step(0.0, bevel, controls)
        self.failures: Counter[str] = Counter()  #: how many steps failed, by reason
        self.solved = 0  #: equilibria asked of the solver so far
        self._boundaries = tissue.boundaries.tolist()
        self._scales = [  # of a tip in each layer
            compute_scales(tissue, end, rules.spacing) for end in (*self._boundaries, math.inf)
        ]
        self._bevels, self._controls = _InputIds[Bevel](), _InputIds[Controls]()
        self._deepest = min(needle.length, MAX_ELEMENTS * rules.element)
        self._rays = math.ceil(self._deepest / rules.spacing)
        self._planned = (self.last, *planned)
        self._begin(self.last)
        warn_of_units(needle, tissue, (self.last,), rules, is_open=True)

    def _begin(self, first: Step) -> None:
        """Bring the needle to first contact under the inputs of a step."""
        self.last = first
        # a shaft that twists turns the tip to any side
        self._planes = 2 if self.tissue.torsional_friction else count_planes(self._planned)
        self._roll = find_roll(first.bevel)  # of the tip, degrees
        self._hold(first.controls)
        self._memory = native.SessionMemory(self._problem)
        self._shape = self.go(first)

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

        Raises ModelError if the needle does not reach that far, would leave the tissue backwards, or has cut
        more rays than `MAX_STEPS` and `MAX_ELEMENTS` allow.

        Parameters
        ----------
        insert : float
            How far the tip goes in, mm; out, where it is negative.
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
        """
        depth, controls = self.last.depth + insert, self.last.controls
        if base is not None:
            c = controls  # twice as fast as `replace`
            controls = Controls(
                *base, c.stage_slope, c.guides, c.tip, c.base_z, c.base_slope_z, c.stage_slope_z
            )
        if guides is not None:
            controls = replace(controls, guides=guides)
        if tip is not _UNCHANGED:
            controls = replace(controls, tip=tip)
        return self.go(Step(0.0 if abs(depth) < SAME_DEPTH_MM else depth, bevel or self.last.bevel, controls))

    def go(self, step: Step) -> NeedleShape:
        """Move the tip to the depth of `step` under its inputs; returns and raises as `Session.step`."""
        check_reach(self.needle.length, step.depth, step.controls)
        if step.depth > self._deepest:  # a single step is too large if it is too deep, and only then
            check_size((step.depth,), self.rules)
        if self._planes == 1 and step.acts_along_z:
            path, self._planned = self.input_path(), (*self._planned, step)
            self._begin(Step(0.0, path[0].bevel, path[0].controls))
            for before in path:
                self.go(before)
        hub, turned = step.bevel, step
        if self.tissue.torsional_friction:
            depth = min(self.last.depth, step.depth)
            turned = replace(step, bevel=follow_hub(self.needle, self.tissue, hub, self._roll, depth))
        bevel, controls = self._bevels.of(turned.bevel), self._controls.of(step.controls)
        stops, points = self._advance(turned, bevel, controls)
        self.solved += stops
        if stops == 0:  # only the bevel was turned
            shape = replace(self._shape, iterations=0)
        else:
            nodes, status, passes = self._memory.read(points)
            scales = self._scales[bisect_left(self._boundaries, nodes[0][-1])]
            shape = NeedleShape(*nodes, STATUS_NAMES[status], int(passes), scales)
            if not shape.converged:
                self.failures[shape.status] += 1
                return shape
        self._memory.accept()
        self.last, self._shape = step, shape
        if turned is not step:
            self._roll = find_roll(turned.bevel)
        if self._bevels.full or self._controls.full:
            rays, _ = self._memory.list_rays()
            self._bevels.drop_unused({bevel, *(ray.bevel_id for ray in rays)})
            self._controls.drop_unused({controls, *(ray.controls_id for ray in rays)})
        return shape

    def copy(self) -> Self:
        """Return an independent second needle in the same state."""
        other = copy.copy(self)
        other.failures = self.failures.copy()
        other._bevels, other._controls = self._bevels.copy(), self._controls.copy()
        other._memory = self._memory.copy()
        other._hold(self._held)
        return other

    def input_path(self) -> tuple[Step, ...]:
        """Return the shortest steps that lead from first contact to the present state.

        Raises ModelError with torsional friction: the tip's roll then depends on all turns of the hub.
        """
        if self.tissue.torsional_friction:
            raise ModelError("no shorter steps lead a twisted needle here", expected="no torsional friction")
        rays, changed = self._memory.list_rays()
        bevels, controls = self._bevels.values(), self._controls.values()
        cut = [(ray.start, bevels[ray.bevel_id], controls[ray.controls_id]) for ray in rays]
        return find_input_path(cut, changed, self.last, self.lattice)

    def simulate_again(
        self, tissue: Tissue | None = None, offset: float | None = None, cut_angle: float | None = None
    ) -> "Session":
        """Simulate the same steps in another tissue, or with another strength of the bevel throughout.

        Its `failures` say whether a step of it failed; it then stands where that step began.

        Parameters
        ----------
        offset, cut_angle : float, optional
            b, mm, or theta, rad, of every step.
        """
        given: dict[str, Any] = {} if offset is None else {"offset": offset}
        given |= {} if cut_angle is None else {"cut_angle": cut_angle}
        steps = tuple(replace(s, bevel=replace(s.bevel, **given)) for s in self.input_path())
        bevel, controls = steps[0].bevel, steps[0].controls
        tissue = tissue or self.tissue
        other = Session(
            self.needle, tissue, bevel, self.lattice.first_cell, controls, self.rules, planned=self._planned
        )
        for step in steps:
            if not other.go(step).converged:
                break
        return other

    def _advance(self, step: Step, bevel: int, controls: int) -> tuple[int, int]:
        """Let the kernel make a step; return its numbers of stops and of constraint points."""
        self._write(step)
        try:
            return self._memory.advance(self._problem, step.depth, bevel, controls)
        except native.RayRoomError as error:
            (rays,) = error.args
        if rays > MAX_STEPS + MAX_ELEMENTS:
            raise ModelError(
                f"the needle has changed its direction of cutting {rays} times",
                expected=f"at most {MAX_STEPS + MAX_ELEMENTS} times",
                fix="retract it, or begin anew",
            )
        # Doubled, so that a session that adds rays one by one copies its state only a few times.
        self._rays = max(2 * rays, self._rays)
        self._hold(step.controls)
        self._memory.grow(self._problem)
        return self._advance(step, bevel, controls)

    def _write(self, step: Step) -> None:
        controls = step.controls
        if controls is not self._held:
            if controls.guides != self._held.guides:
                self._hold(controls)
            else:
                self._held, planes = controls, self._planes
                self._base[:] = controls.base[: 3 * planes]
                self._tip[:] = list_tip(controls, planes)
        if step.bevel is not self._cut:
            # rays that open now are cut by this bevel; the kernel does not read the turn of the others
            self._cut = step.bevel
            self._turn[:] = compute_turn(step.bevel, self.rules)[: self._planes]

    def _hold(self, controls: Controls) -> None:
        self._held, self._cut = controls, self.last.bevel
        step = Step(self._deepest, self.last.bevel, controls)
        self._problem = pack_problem(
            self.needle, self.tissue, (step,), self.lattice, self.rules, _NO_STOPS,
            planes=self._planes, rays=self._rays, guides=MAX_GUIDES,
        )  # fmt: skip
        arrays = self._problem.arrays
        self._base, self._tip, self._turn = (
            arrays[name].reshape(-1) for name in ("base", "held_tip", "turn")
        )


#: stops of a session, which the kernel plans
_NO_STOPS = PackedStops(np.zeros(1, native.STOP), (0,), (0,), TipStop(0.0, 0, False, 0, False, 0, 0), 1)


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
