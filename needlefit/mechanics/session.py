"""The model step by step, for a hand on the needle."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from needlefit.mechanics.control import Bevel, Controls, Guide, Rules, Step, TrackedTip
from needlefit.mechanics.kernel import insertion as kernel
from needlefit.mechanics.kernel.scalar import CONVERGED, Newton
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import NEAR, Lattice, Move, Position, advance, check_reach
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import compile_controls, compile_tissue, pack, read
from needlefit.mechanics.tissue import Tissue

_DEFAULT_CONTROLS = Controls()
_DEFAULT_RULES = Rules()
T = TypeVar("T")
_AS_IT_IS: Any = object()  # None already says that a tip is not tracked


class Session:
    """A needle that goes on from where it stands.

    With the same first cell and the same steps it finds the same bits as `simulate.follow`; steps that
    only divide a longer one change nothing at its end.

    Parameters
    ----------
    needle : Needle
    tissue : Tissue
    bevel : Bevel
        As the insertion begins.
    first_cell : float
        Depth of the first constraint point, mm, up to the constraint spacing of `rules`; part of the
        model, to be kept with a recording. `follow` by default takes what lets the last step end on one.
    controls : Controls
        As the insertion begins.
    rules : Rules

    Attributes
    ----------
    last : Step
        Where the needle stands, and under which inputs.
    failures : Counter
        How many steps failed, by reason.
    """

    def __init__(
        self,
        needle: Needle,
        tissue: Tissue,
        bevel: Bevel,
        first_cell: float = 1.0,
        controls: Controls = _DEFAULT_CONTROLS,
        rules: Rules = _DEFAULT_RULES,
    ) -> None:
        self.needle, self.tissue, self.rules = needle, tissue, rules
        self.lattice = Lattice(first_cell, rules.spacing)
        self.last = Step(0.0, bevel, controls)
        self.failures: Counter[str] = Counter()
        self._foundation = compile_tissue(tissue)
        self._newton = Newton(rules.tolerance, rules.max_iterations)
        self._position = Position()
        self._bevels: dict[Bevel, int] = {}  # numbers that the plan knows them by
        self._controls: dict[Controls, int] = {}
        self._guides = self._rays = 0
        self._make_room(guides=4, rays=math.ceil(needle.length / rules.spacing))
        self.go(self.last)

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
        tip: TrackedTip | None = _AS_IT_IS,
    ) -> NeedleShape:
        """Change inputs, then insert or retract; what is not given stays as it is.

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
            If the needle does not reach that far, or would leave the tissue backwards.
        """
        controls, depth = self.last.controls, self.last.depth + insert
        if base is not None:
            controls = replace(controls, base_y=base[0], base_slope=base[1])
        if guides is not None:
            controls = replace(controls, guides=guides)
        if tip is not _AS_IT_IS:
            controls = replace(controls, tip=tip)
        return self.go(Step(0.0 if abs(depth) < NEAR else depth, bevel or self.last.bevel, controls))

    def go(self, step: Step) -> NeedleShape:
        """Bring the tip to the depth of `step` under its inputs; else as `step`."""
        check_reach(self.needle.length, step.depth, step.controls)
        return self._go(step)

    def _go(self, step: Step) -> NeedleShape:
        move = Move(step.depth, _number(self._bevels, step.bevel), _number(self._controls, step.controls))
        position, stops = advance(self._position, move, self.lattice)
        status, iterations = CONVERGED, 0
        if stops:  # there are none where only the bevel was turned
            self._make_room(len(step.controls.guides), stops[-1].ray + 1)
            kept = [part.copy() for part in self._moving()]
            turn = (
                step.bevel.side * step.bevel.offset / self.rules.spacing
            )  # rays that open now are cut by it
            packed = pack(stops)[0]._replace(turn=np.full(len(stops), turn))
            holds = compile_controls(step.controls)
            status, iterations, _ = kernel.advance(
                self._under_way, self._foundation, holds, packed, self._newton
            )
            self._stop = stops[-1]
        shape = read(self._under_way, self._stop, step.controls, status, iterations)
        if status == CONVERGED:
            self._position, self.last = position, step
            _forget(self._bevels, (ray.cut for ray in position.rays), step.bevel)
            _forget(self._controls, (ray.held for ray in position.rays), step.controls)
        else:
            self.failures[shape.status] += 1
            self._stop = self._position.last or self._stop
            for part, before in zip(self._moving(), kept, strict=True):
                part[...] = before
        return shape

    def _moving(self) -> tuple[np.ndarray, ...]:
        """Return the arrays that a step changes."""
        now = self._under_way
        return now.y, now.track, now.rays, now.tip, now.nodes, now.states, now.size

    def _make_room(self, guides: int, rays: int) -> None:
        """Let the kernel's arrays hold so many guides and rays; what they hold already stays."""
        if guides <= self._guides and rays <= self._rays:
            return
        self._guides, self._rays = max(2 * guides, self._guides), max(2 * rays, self._rays)
        before = self._moving() if self._guides and self._position.last else ()
        self._under_way = kernel.begin(
            self.needle.flexural_rigidity, self.needle.length, self.lattice.first_cell,
            self.lattice.spacing, self.rules.element, self.tissue.boundaries,
            self.needle.length, self._guides, self._rays,
        )  # fmt: skip
        for part, old in zip(self._moving(), before, strict=False):
            part[tuple(slice(n) for n in old.shape)] = old


def _forget(numbers: dict[T, int], used: Iterable[int], now: T) -> None:
    """Drop the numbers of inputs under which no ray was cut, lest a long session grow."""
    if len(numbers) > 256:
        kept = set(used)
        for value in [v for v, number in numbers.items() if number not in kept and v != now]:
            del numbers[value]


def _number(numbers: dict[T, int], value: T) -> int:
    """Return the number of an input; equal inputs have equal ones."""
    if value not in numbers:
        numbers[value] = max(numbers.values(), default=-1) + 1
    return numbers[value]
