"""Turn the steps of an insertion into stops: where the tip halts, which ray cut its path, what holds it.

Which equilibria an insertion needs depends on depths and on changes of the inputs, never on the solution.
They are therefore listed beforehand, by the kernel (`native/plan.hpp`), and all solvers follow the same list.
How deep a needle can go, and for how many elements, is limited here too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.schemas.limits import MAX_ELEMENT_SOLVES, MAX_ELEMENTS


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def count_element_solves(depths: tuple[float, ...], spacing: float, element: float) -> float:
    """Estimate the number of elements an insertion solves for; the true number is not larger.

    On the way in the tip halts once in every cell, else once or twice a step; each halt solves for the
    elements between entry and tip.
    """
    total, here = 0.0, 0.0
    for depth in depths:
        cells = max(depth - here, 0.0) / spacing + 2
        total += cells * (max(depth, here) if depth <= here else 0.5 * (depth + here)) / element + 2 * cells
        here = depth
    return total


def check_size(depths: tuple[float, ...], rules: ModelOptions) -> None:
    """Raise ModelError where an insertion to these depths (mm), in order, would take minutes or gigabytes."""
    deepest = max(depths, default=0.0)
    if deepest > MAX_ELEMENTS * rules.element:
        raise ModelError(
            f"{deepest:g} mm of depth are {deepest / rules.element:.0f} elements of {rules.element:g} mm",
            expected=f"at most {MAX_ELEMENTS} elements",
            fix="insert less deep, or take longer elements",
        )
    solves = count_element_solves(depths, rules.spacing, rules.element)
    if solves > 1.01 * MAX_ELEMENT_SOLVES:  # the deepest insertion is allowed, whatever its first cell
        raise ModelError(
            f"{len(depths)} steps are {solves:.3g} elements to be solved for in all equilibria",
            expected=f"at most {MAX_ELEMENT_SOLVES:.3g}",
            fix="take fewer steps, insert less deep, or take a larger constraint spacing",
        )


def check_reach(length: float, depth: float, controls: Controls) -> None:
    """Raise ModelError unless a needle of `length` reaches `depth` with its base before guides and tissue."""
    guides = controls.guides  # from the base inwards
    before = -guides[0].x if guides and not guides[0].in_tissue else 0.0
    if depth + before < length:
        return
    needle = f"a needle of {length:g} mm"
    through = f" through a guide {before:g} mm before the tissue" if before else ""
    nearer = (
        f", or a guide less than {length - depth:g} mm before the tissue" if before and depth < length else ""
    )
    if before >= length:
        raise ModelError(
            f"{needle} does not even reach the tissue{through}",
            expected=f"a needle longer than {depth + before:g} mm to go {depth:g} mm deep{nearer}",
            fix="give the needle's true length, or move the guide toward the tissue",
        )
    raise ModelError(
        f"{needle} cannot be inserted {depth:g} mm{through}",
        expected=f"a depth below {length - before:g} mm{nearer}",
        fix=f"lessen the depth,{' move the guide,' if nearer else ''} or give the needle's true length",
    )


SAME_DEPTH_MM = 1e-9  #: difference (mm) below which two depths are the same


class Move(NamedTuple):
    """A step as the plan needs it: the depth it leads to (mm), and numbers that identify its inputs."""

    depth: float
    bevel_id: int  # names the bevel
    controls_id: int  # names the controls


class TipStop(NamedTuple):
    """One stop of the tip: one equilibrium of an insertion."""

    tip: float  #: depth of the tip, mm
    #: m, the number of the constraint point under the tip: 0 ... m - 1 lie behind it. 0: the tip stands at
    #: the entry, in no tissue, and there is no ray.
    cell: int
    #: whether that point belongs to the lattice of constraint points, or only goes with the tip
    permanent: bool
    ray: int  #: number of the ray that leads here, counted from the entry; 0 where there is none
    #: whether that ray begins where the tip stood at the stop before, along its tangent there
    starts_ray: bool
    bevel_id: int  #: number of the bevel that cuts, or has cut, the ray
    controls_id: int  #: number of the controls that hold the needle
    #: whether that ray follows one of equal length under the same inputs: an advance by the path angle then
    #: takes on the slope that the tip will have in the middle of the cell
    extrapolates: bool = False


@dataclass(frozen=True)
class Lattice:
    """The depths at which an insertion can have constraint points."""

    first_cell: float  #: x_1, mm; at most `spacing`
    spacing: float  #: C_int, mm

    def __post_init__(self) -> None:
        if not SAME_DEPTH_MM < self.first_cell <= self.spacing + 2 * SAME_DEPTH_MM:
            raise ModelError(
                f"the first cell is {self.first_cell} mm",
                expected=f"above {SAME_DEPTH_MM:g} mm, up to the constraint spacing of {self.spacing:g} mm",
            )

    @classmethod
    def ending_at(cls, depth: float, spacing: float) -> "Lattice":
        """Return the lattice with a constraint point at `depth`, so that the last cell is a whole one."""
        cells = max(1, math.ceil((depth - SAME_DEPTH_MM) / spacing))
        return cls(depth - (cells - 1) * spacing, spacing)

    def depth(self, m: int) -> float:
        """Return the depth x_m of constraint point m, mm."""
        return 0.0 if m == 0 else self.first_cell + (m - 1) * self.spacing

    def is_at(self, m: int, depth: float) -> bool:
        """Whether constraint point m lies at `depth`."""
        return abs(self.depth(m) - depth) <= SAME_DEPTH_MM

    def cell(self, depth: float) -> int:
        """Return the number of the constraint point at `depth`, or of the next one deeper."""
        if depth <= SAME_DEPTH_MM:
            return 0
        return 1 + max(0, math.ceil((depth - self.first_cell - SAME_DEPTH_MM) / self.spacing))


def make_moves(steps: Sequence[Step], length: float, past: int = 0) -> tuple[Move, ...]:
    """Return the steps as moves, after a check that the needle of `length` (mm) is long enough for each.

    Their `bevel_id` and `controls_id` are numbers: of the first step with that bevel, and with those
    controls. Inputs behind the first `past` steps count as changed.

    Raises ModelError if there are no steps, or the needle is too short for one of them.
    """
    if not steps:
        raise ModelError("an insertion without steps", expected="one step at least")
    bevels: dict[Bevel, int] = {}
    controls: dict[Controls, int] = {}
    moves: list[Move] = []
    for n, step in enumerate(steps):
        check_reach(length, step.depth, step.controls)
        if n == past:
            bevels, controls = {}, {}
        numbers = bevels.setdefault(step.bevel, n), controls.setdefault(step.controls, n)
        moves.append(Move(step.depth, *numbers))
    return tuple(moves)


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def make_stops(moves: tuple[Move, ...], lattice: Lattice) -> tuple[TipStop, ...]:
    """Return the stops of all moves, from first contact on."""
    stops = native.divide_moves(lattice.first_cell, lattice.spacing, moves).tolist()
    return tuple(
        TipStop(
            tip, cell, bool(flags & native.PERMANENT), ray, bool(flags & native.STARTS_RAY), bevel, controls,
            bool(flags & native.EXTRAPOLATES),
        )
        for tip, cell, ray, bevel, controls, flags in stops
    )  # fmt: skip


def make_lattice(steps: Sequence[Step], rules: ModelOptions) -> Lattice:
    """Return the constraint points of a whole insertion: by default the tip ends on one of them."""
    if rules.first_cell is not None:
        return Lattice(rules.first_cell, rules.spacing)
    depth = steps[-1].depth if steps else 0.0
    return (
        Lattice.ending_at(depth, rules.spacing)
        if depth > SAME_DEPTH_MM
        else Lattice(rules.spacing, rules.spacing)
    )


def find_input_path(
    rays: Sequence[tuple[float, Bevel, Controls]], changed: bool, last: Step, lattice: Lattice
) -> tuple[Step, ...]:
    """Return the shortest steps that lead from first contact to a state, with the same rays and inputs.

    Movements that were taken back leave nothing behind, and are left out. `rays` are depths where they begin,
    mm, with the bevel that cuts and the controls under which each was begun; `changed` says whether inputs
    have changed since the tip came to its depth; `last` is where it stands, and under which inputs.
    """
    steps: list[Step] = []
    # before the first cell there are no rays
    ends = [start for start, _, _ in rays[1:]] + [last.depth] * bool(rays)
    for (start, bevel, controls), end in zip(rays, ends, strict=True):
        step = Step(end, bevel, controls)
        if not steps or lattice.is_at(lattice.cell(start), start):
            if steps and (steps[-1].bevel, steps[-1].controls) == (step.bevel, step.controls):
                steps.pop()  # at a constraint point a new ray begins of itself
        elif (steps[-1].bevel, steps[-1].controls) == (step.bevel, step.controls):
            steps.append(_flip_bevel(steps[-1]))  # within a cell only changed inputs begin one
        steps.append(step)
    if not steps or (steps[-1].bevel, steps[-1].controls) != (last.bevel, last.controls):
        steps.append(last)
    elif changed:
        steps += [_flip_bevel(last), last]
    return tuple(steps)


def _flip_bevel(step: Step) -> Step:
    """Return a step to the same place that turns the bevel over: so inputs have changed, and nothing else."""
    return replace(step, bevel=replace(step.bevel, side=-step.bevel.side))
