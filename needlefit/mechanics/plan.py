"""From steps to stops: where the tip halts, which ray cut its way there, which inputs hold the needle.

Which equilibria an insertion asks for depends on depths and on where inputs change, never on the solution.
They are therefore written down beforehand as a straight list of stops, and whatever solves them (the
reference, the compiled kernel, its lanes, the sensitivities, a session) follows the same list.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Controls, Rules, Step
from needlefit.schemas.limits import MAX_ELEMENT_SOLVES, MAX_ELEMENTS

NEAR = 1e-9
"""Two depths nearer than this are the same, mm."""


@dataclass(frozen=True)
class Move:
    """A step, as far as the plan needs it: the depth it leads to (mm), and names for its inputs."""

    depth: float
    cut: int  # names the bevel
    held: int  # names the controls


@dataclass(frozen=True)
class Stop:
    """One equilibrium of an insertion.

    Attributes
    ----------
    tip : float
        Depth of the tip, mm.
    cell : int
        m, the number of the constraint point under the tip: 0 ... m - 1 lie behind it. 0: the tip stands
        at the entry, in no tissue, and there is no ray.
    permanent : bool
        Whether that point belongs to the lattice of constraint points, or only goes with the tip.
    ray : int
        Number of the ray that leads here, counted from the entry.
    opens : bool
        Whether that ray begins where the tip stood at the stop before, along its tangent there.
    cut : int
        Names the bevel that cuts, or cut, the ray.
    held : int
        Names the controls that hold the needle.
    """

    tip: float
    cell: int
    permanent: bool
    ray: int
    opens: bool
    cut: int
    held: int


@dataclass(frozen=True)
class Ray:
    """The way that the tip cuts from `start` (mm) on, and the inputs under which it was begun.

    Rays are linked from the tip back to the entry: a long session adds and drops them at no cost.
    """

    start: float
    cut: int
    held: int
    number: int
    before: "Ray | None" = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class Lattice:
    """The constraint points that an insertion can have.

    Attributes
    ----------
    first_cell : float
        x_1, mm; at most `spacing`.
    spacing : float
        C_int, mm.
    """

    first_cell: float
    spacing: float

    def __post_init__(self) -> None:
        if not NEAR < self.first_cell <= self.spacing + 2 * NEAR:
            raise ModelError(
                f"the first cell is {self.first_cell} mm",
                expected=f"above {NEAR:g} mm, up to the constraint spacing of {self.spacing:g} mm",
            )

    @classmethod
    def ending_at(cls, depth: float, spacing: float) -> "Lattice":
        """Return the lattice with a constraint point at `depth`: the last cell is whole."""
        cells = max(1, math.ceil((depth - NEAR) / spacing))
        return cls(depth - (cells - 1) * spacing, spacing)

    def depth(self, m: int) -> float:
        """Return x_m, mm."""
        return 0.0 if m == 0 else self.first_cell + (m - 1) * self.spacing

    def at(self, m: int, depth: float) -> bool:
        """Whether constraint point m lies at `depth`."""
        return abs(self.depth(m) - depth) <= NEAR

    def cell(self, depth: float) -> int:
        """Return the number of the constraint point at `depth`, or of the next one deeper."""
        if depth <= NEAR:
            return 0
        return 1 + max(0, math.ceil((depth - self.first_cell - NEAR) / self.spacing))


@dataclass(frozen=True)
class Position:
    """Where the tip stands, and the rays that led there.

    Attributes
    ----------
    last : Stop or None
        The stop at which the tip stands; None before first contact.
    ray : Ray or None
        The one that led there, and so all before it; None at the entry.
    move : Move or None
        The move before, whose inputs the next one may change.
    turned : bool
        Whether inputs have changed since the tip came to this depth.
    """

    last: Stop | None = None
    ray: Ray | None = None
    move: Move | None = None
    turned: bool = False


def rays(position: Position) -> list[Ray]:
    """Return the rays that led to a position, from the entry on."""
    found, ray = [], position.ray
    while ray:
        found.append(ray)
        ray = ray.before
    return found[::-1]


def advance(position: Position, move: Move, lattice: Lattice) -> tuple[Position, list[Stop]]:
    """Return where a move leads, and its stops, the last of which stands at its depth under its inputs."""
    ray = position.ray
    stops: list[Stop] = []

    def halt(depth: float, *, opens: bool = False) -> Stop:
        cell = lattice.cell(depth)
        permanent = lattice.at(cell, depth)
        tip = lattice.depth(cell) if permanent else depth
        cut, number = (ray.cut, ray.number) if ray else (move.cut, -1)
        stops.append(Stop(tip, cell, permanent, number, opens, cut, move.held))
        return stops[-1]

    here = position.last or halt(0.0)
    before = position.move or move
    turned = position.turned or (before.cut, before.held) != (move.cut, move.held)
    if move.depth > here.tip + NEAR:
        # a cell goes on along its ray unless something has changed; at a constraint point a new cell begins
        begins = ray is None or here.permanent or turned or (ray.cut, ray.held) != (move.cut, move.held)
        if begins and here.held != move.held:
            halt(here.tip)
        at = here.tip
        while move.depth > at + NEAR:
            if begins:
                ray = Ray(at, move.cut, move.held, ray.number + 1 if ray else 0, ray)
            at = halt(min(lattice.depth(lattice.cell(at + 2 * NEAR)), move.depth), opens=begins).tip
            begins = True
    elif move.depth < here.tip - NEAR:
        while ray and ray.start >= move.depth - NEAR:
            ray = ray.before
        halt(move.depth)
    elif here.held != move.held:
        halt(here.tip)
    moved = abs(move.depth - here.tip) > NEAR
    return Position(stops[-1] if stops else here, ray, move, turned and not moved), stops


def plan(steps: Sequence[Step], lattice: Lattice, length: float) -> tuple[Stop, ...]:
    """Return the stops of all steps of a needle of `length` (mm), from first contact on.

    Their `cut` and `held` are numbers: of the first step with that bevel, and with those controls.

    Raises
    ------
    ModelError
        If there are no steps, or the needle is too short for one of them.
    """
    return stops_of(moves_of(steps, length), lattice)


def moves_of(steps: Sequence[Step], length: float) -> tuple[Move, ...]:
    """Return the steps as moves, once the needle of `length` (mm) is long enough for each of them."""
    if not steps:
        raise ModelError("an insertion without steps", expected="one step at least")
    bevels: dict[Bevel, int] = {}
    controls: dict[Controls, int] = {}
    for n, step in enumerate(steps):
        check_reach(length, step.depth, step.controls)
        bevels.setdefault(step.bevel, n)
        controls.setdefault(step.controls, n)
    return tuple(Move(step.depth, bevels[step.bevel], controls[step.controls]) for step in steps)


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def stops_of(moves: tuple[Move, ...], lattice: Lattice) -> tuple[Stop, ...]:
    """Return the stops of all moves, from first contact on."""
    position, stops = Position(), list[Stop]()
    for move in moves:
        position, more = advance(position, move, lattice)
        stops += more
    return tuple(stops)


def lattice_of(steps: Sequence[Step], rules: Rules) -> Lattice:
    """Return the constraint points of a whole insertion: by default the tip ends on one of them."""
    if rules.first_cell is not None:
        return Lattice(rules.first_cell, rules.spacing)
    depth = steps[-1].depth if steps else 0.0
    return Lattice.ending_at(depth, rules.spacing) if depth > NEAR else Lattice(rules.spacing, rules.spacing)


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def element_solves(depths: tuple[float, ...], spacing: float, element: float) -> float:
    """Return about how many elements an insertion solves for, and at most that many.

    On the way in the tip halts once in every cell, else once or twice a step; each halt solves for the
    elements between entry and tip.
    """
    total, here = 0.0, 0.0
    for depth in depths:
        cells = max(depth - here, 0.0) / spacing + 2
        total += cells * (max(depth, here) if depth <= here else 0.5 * (depth + here)) / element + 2 * cells
        here = depth
    return total


def check_size(depths: tuple[float, ...], rules: Rules) -> None:
    """Raise ModelError where an insertion to these depths (mm), in order, would take minutes or gigabytes."""
    deepest = max(depths, default=0.0)
    if deepest > MAX_ELEMENTS * rules.element:
        raise ModelError(
            f"{deepest:g} mm of depth are {deepest / rules.element:.0f} elements of {rules.element:g} mm",
            expected=f"at most {MAX_ELEMENTS} elements",
            fix="insert less deep, or take a larger constraint spacing and longer elements",
        )
    solves = element_solves(depths, rules.spacing, rules.element)
    if solves > 1.01 * MAX_ELEMENT_SOLVES:  # the deepest insertion is allowed, whatever its first cell
        raise ModelError(
            f"{len(depths)} steps are {solves:.3g} elements to be solved for in all equilibria",
            expected=f"at most {MAX_ELEMENT_SOLVES:.3g}",
            fix="take fewer steps, insert less deep, or take a larger constraint spacing",
        )


def check_reach(length: float, depth: float, controls: Controls) -> None:
    """Raise ModelError unless a needle of `length` reaches `depth` with its base before guides and tissue."""
    before = -controls.before[0].x if controls.before else 0.0
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
