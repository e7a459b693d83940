"""Simulate insertions with many parameter sets, with exact derivatives of the needle's shape if wanted.

Vector instructions serve the sets of one insertion, threads different insertions.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Self, TypeVar

import numpy as np

from needlefit.arrays import Bools, Floats, Ints, pad_axis
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.doubts import warn_of_units
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle, require_type
from needlefit.mechanics.packing import (
    BASE_VALUES,
    INPUTS_ALONG_Z,
    Columns,
    Evaluation,
    PreparedInsertion,
    count_planes,
    run_evaluations,
)
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.shape import (
    NeedleShape,
    Solution,
    Validity,
    compute_scales,
    compute_validity,
    list_planes,
)
from needlefit.mechanics.simulate import STATUS_NAMES, read_shape, require_depth
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import find_roll, turn_tip
from needlefit.project.processes import count_cores
from needlefit.schemas.limits import MAX_NUMBER


def require_roll_of_one_rigidity(tissue: Tissue, steps: Sequence[Step]) -> None:
    """Raise ModelError where the roll of the tip depends on the needle's rigidity."""
    if tissue.torsional_friction and len({find_roll(step.bevel) for step in steps}) > 1:
        raise ModelError(
            "the rigidity of a needle is varied that is turned against torsional friction",
            expected="one rigidity, one roll, or no torsional friction",
        )


@dataclass(frozen=True)
class Batch:
    """One insertion with B parameter sets; what is None has the value of `needle`, `tissue` and `steps` in
    all sets.
    """

    #: needle, tissue, steps, rules: the insertion, as `simulate.simulate_steps` takes it
    needle: Needle
    tissue: Tissue
    steps: tuple[Step, ...]
    rules: ModelOptions = ModelOptions()
    mu: Floats | None = None  #: (B, n) of the n layers of `tissue`, MPa
    shape: Floats | None = None  #: (B, p, n) shape parameters of the law of `tissue`, in its order
    boundaries: Floats | None = None  #: (B, n - 1) depths of the layers' boundaries, mm
    #: offset, cut_angle: (B,) of every bevel, mm and rad; sides stay
    offset: Floats | None = None
    cut_angle: Floats | None = None
    rigidity: Floats | None = None  #: (B,) EI, N mm^2
    #: base_y, base_slope: (B,) of the base in every step, mm and 1
    base_y: Floats | None = None
    base_slope: Floats | None = None
    #: base_z, base_slope_z: (B,) the same along z
    base_z: Floats | None = None
    base_slope_z: Floats | None = None
    roll: Floats | None = None  #: (B,) rad, added to the roll of every bevel
    #: (B,) the share of each move of the base since first contact that the needle follows
    gain: Floats | None = None
    guide_x: Floats | None = None  #: (B,) where the one guide before the tissue stands, mm; there must be one
    given: tuple[str, ...] = field(init=False, repr=False, compare=False)  #: names of what the sets give
    #: the insertion as the kernel reads it, by kinds of derivatives and steps past; filled at first use
    prepared: dict[tuple[tuple[str, ...] | None, int], PreparedInsertion] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        sizes = {}
        for name in VARYING_FIELDS:
            value = getattr(self, name)
            if value is None:
                continue
            of_layers = getattr(self.tissue, name).shape if name in OF_LAYERS else ()
            try:
                array = np.ascontiguousarray(value, dtype=np.float64)
            except (TypeError, ValueError):
                raise ModelError(f"batch {name} is {value!r:.60}", expected="numbers") from None
            if array.ndim != 1 + len(of_layers) or array.shape[1:] != of_layers:
                expected = ", ".join(map(str, ("B", *of_layers)))
                raise ModelError(f"batch {name} has shape {array.shape}", expected=f"({expected})")
            sizes[name] = len(array)
            object.__setattr__(self, name, array)
        if len(set(sizes.values())) != 1 or 0 in sizes.values():
            raise ModelError(
                f"a batch whose sets are {sizes or 'not given'}", expected="one size B for all, at least 1"
            )
        if self.guide_x is not None and any(len(step.controls.before) != 1 for step in self.steps):
            raise ModelError("guide_x is given", expected="exactly one guide before the tissue in every step")
        object.__setattr__(self, "steps", tuple(self.steps))
        object.__setattr__(self, "given", tuple(sizes))
        if self.rigidity is not None:
            require_roll_of_one_rigidity(self.tissue, self.steps)
        warn_of_units(self.needle, self.tissue, self.steps, self.rules)

    def __len__(self) -> int:
        return len(getattr(self, self.given[0]))

    @property
    def nodes(self) -> int:
        """About how many nodes the shapes of all sets have."""
        deepest = max((step.depth for step in self.steps), default=0.0)
        return len(self) * math.ceil(deepest / self.rules.element)

    def with_sets(self, **values: Floats) -> Self:
        """Return the same insertion with other sets of the same parameters; both share what is prepared.

        The arrays are contiguous ones of `np.float64`; the kernel refuses others with a TypeError.

        Raises ModelError if these are not the parameters that this batch varies.
        """
        if values.keys() != set(self.given):
            raise ModelError(f"sets of {', '.join(values)}", expected=f"of {', '.join(sorted(self.given))}")
        other = copy(self)
        other.__dict__.update(values)
        return other

    def take(self, sets: slice) -> Self:
        """Return the same insertion with some of the sets, in their order."""
        if len(range(len(self))[sets]) == len(self):
            return self  # whose arrays other batches share
        return self.with_sets(**{name: getattr(self, name)[sets] for name in self.given})

    def vary_inputs(self, i: int) -> tuple[Needle, tuple[Step, ...]]:
        """Return needle and steps with the parameters of set i, but for the roll and the gain."""

        def choose(name: str, default: float) -> float:
            values = getattr(self, name)
            return default if values is None else float(values[i])

        steps = []
        for step in self.steps:
            base: dict[str, Any] = {name: choose(name, getattr(step.controls, name)) for name in BASE_VALUES}
            controls = replace(step.controls, **base)
            if self.guide_x is not None:
                (guide,) = step.controls.before
                shifted_guide = replace(guide, x=float(self.guide_x[i]))
                controls = replace(controls, guides=(shifted_guide, *step.controls.within))
            offset, angle = choose("offset", step.bevel.offset), choose("cut_angle", step.bevel.cut_angle)
            bevel = replace(step.bevel, offset=offset, cut_angle=angle)
            steps.append(Step(step.depth, bevel, controls))
        needle = replace(self.needle, flexural_rigidity=choose("rigidity", self.needle.flexural_rigidity))
        return needle, tuple(steps)


#: fields with the shape that they have in `tissue`, behind that of the sets
OF_LAYERS = (
    "mu",
    "shape",
    "boundaries",
)  #: what has the shape that it has in `tissue`, behind that of the sets
#: fields of a batch that a set may give
VARYING_FIELDS = tuple(field.name for field in fields(Batch) if field.init)[4:]


@dataclass(frozen=True)
class NeedleShapes(Solution):
    """The shapes of a batch of B sets."""

    status: Ints  #: (B,) into `simulate.STATUS_NAMES`; 0: converged
    iterations: Ints  #: (B,)
    scales: Floats  #: (B, 2)

    def __len__(self) -> int:
        return len(self.u)

    def __getitem__(self, i: int) -> NeedleShape:
        nodes: dict[str, Any] = {field.name: getattr(self, field.name)[i] for field in fields(Solution)}
        status, iterations = STATUS_NAMES[self.status[i]], int(self.iterations[i])
        return NeedleShape(**nodes, status=status, iterations=iterations, scales=self.scales[i])

    def take(self, sets: slice) -> "NeedleShapes":
        """Return some of the sets; their arrays are views."""
        return NeedleShapes(*(getattr(self, field.name)[sets] for field in fields(self)))

    @property
    def converged(self) -> Bools:
        """Whether each set reached the tolerance, (B,)."""
        return np.equal(self.status, 0)

    @cached_property
    def validity(self) -> Validity:
        """Validity of each set's solution, arrays (B,); NaN where the solution failed."""
        return compute_validity(self, self.scales)

    @property
    def valid(self) -> Bools:
        """Whether each set converged and keeps within the model's assumptions, (B,)."""
        return self.converged & self.validity.ok


def compute_batch_positions(shapes: NeedleShapes, s: Floats) -> Floats:
    """Return the points (B, K, 3) in C of every needle at `s` (K,), mm; see `compute_positions`."""
    return native.compute_positions(shapes.x, *list_planes(shapes), s)


#: kinds of parameters that `wrt` accepts, in the order of the Jacobian's columns
DERIVATIVE_KINDS = (
    "mu", "shape", "friction", "boundaries", "rigidity", "offset", "cut_angle", "base_y", "base_slope",
    "stage_slope", "guides",
)  # fmt: skip

_DEFAULT_CONTROLS = Controls()
_DEFAULT_OPTIONS = ModelOptions()
_DEFAULT_WRT = ("mu", "shape", "offset")


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of a `NeedleShape` with respect to P parameters, per MPa, mm, N mm^2, rad or 1.

    Bevel and base are shifted alike in all steps; guides of several steps at the same x are one guide,
    numbered by x. Where a node itself moves along the needle, its deflection is followed along with it.
    All but `x` have a leading axis of two, y and z.
    """

    #: mu1, ..., the law's shape parameters (alpha1, ...), friction1, ..., boundary1, ..., rigidity, offset,
    #: cut_angle, base_y, base_slope, stage_slope, guide1_x, guide1_y, guide1_slope, ..., roll (rad), base_z,
    #: base_slope_z, stage_slope_z; guide1_z and guide1_slope_z where the needle leaves the plane z = 0
    names: tuple[str, ...]
    x: Floats  #: (N, P) of the nodes' beam coordinates: 1 for a guide's node and its own x, else 0
    #: u, slope: (2, N, P) of the nodes' deflections and slopes
    u: Floats
    slope: Floats
    constraints: Floats  #: (2, M + 1, P) of y and z of the constraint points
    tip_track: Floats  #: (2, M + 1, P) of the tip's deflections as it stood at each constraint point


@dataclass(frozen=True)
class Jacobians(Jacobian):
    """Derivatives of `NeedleShapes`, with an axis of B sets behind that of y and z; `x` is that of all sets.

    `tip_track` is empty where it was not asked for.
    """

    converged: Bools  #: (B,) all derivatives of other sets are NaN

    def __getitem__(self, i: int) -> Jacobian:
        parts = (self.u, self.slope, self.constraints, self.tip_track)
        x = self.x if self.converged[i] else np.full_like(self.x, np.nan)
        return Jacobian(self.names, x, *(part[:, i] for part in parts))


def linearize(
    needle: Needle,
    tissue: Tissue,
    bevel: Bevel,
    depth: float,
    controls: Controls = _DEFAULT_CONTROLS,
    rules: ModelOptions = _DEFAULT_OPTIONS,
    *,
    wrt: Sequence[str] = _DEFAULT_WRT,
) -> tuple[NeedleShape, Jacobian]:
    """Insert the needle as `simulate` does; return its shape and the derivatives of that shape.

    Raises ModelError if the needle is too short for the depth or the guides, or there is no such kind of
    parameter.

    Parameters
    ----------
    wrt : sequence of str
        Kinds of parameters, of `DERIVATIVE_KINDS`; the columns stand in the order of `DERIVATIVE_KINDS`.

    Returns
    -------
    NeedleShape
    Jacobian
        NaN where the solution failed.
    """
    require_depth(depth)
    steps = (Step(float(depth), bevel, controls),)
    derivatives = linearize_steps(needle, tissue, steps, rules, None, wrt)
    warn_of_units(needle, tissue, steps, rules)
    return derivatives


def linearize_steps(
    needle: Needle,
    tissue: Tissue,
    steps: Sequence[Step],
    rules: ModelOptions = _DEFAULT_OPTIONS,
    lattice: Lattice | None = None,
    wrt: Sequence[str] = _DEFAULT_WRT,
) -> tuple[NeedleShape, Jacobian]:
    """Insert the needle as `simulate_steps` does; return its last shape and the derivatives of that shape."""
    if "rigidity" in wrt:
        require_roll_of_one_rigidity(tissue, steps)
    steps = turn_tip(needle, tissue, steps)
    columns = find_columns(tuple(wrt), tissue, steps, rules)
    insertion = PreparedInsertion(needle, tissue, steps, rules, lattice, columns)
    evaluation = Evaluation(insertion, {}, np.ones(1, dtype=bool))
    run_evaluations([evaluation], 1)
    shape = read_shape(evaluation.shapes, insertion.scales)
    return shape, read_jacobians(evaluation, np.array([shape.converged]))[0]


def read_jacobians(evaluation: Evaluation, converged: Bools) -> Jacobians:
    """Return the derivatives of all sets of an evaluation with columns that was run."""
    insertion = evaluation.insertion
    assert insertion.columns is not None
    x = evaluation.shapes.arrays["x"][evaluation.some]
    guide_x = evaluation.values.get("guide_x")
    by_x = np.zeros((len(x), insertion.columns.total))
    for number, guide in enumerate(insertion.steps[-1].controls.guides):
        # nodes of guides that hold the needle move with them; the first one may differ between sets
        column = insertion.columns.guides[guide.x][0]
        place = guide.x if guide_x is None or number else guide_x[evaluation.some]
        if column >= 0:
            by_x[:-1][x[:-1] == place, column] = 1.0  # none holds the tip
    if not insertion.columns.total:
        nodes, points = (np.empty((2, evaluation.sets, n, 0)) for n in (len(x), insertion.points))
        return Jacobians((), by_x, nodes, nodes, points, points, converged)
    arrays = [evaluation.shapes.arrays[f"{name}_by"] for name in ("u", "slope", "constraints")]
    arrays.append(evaluation.shapes.arrays.get("track_by", arrays[-1][:, :, :0]))
    if not evaluation.all_valid:
        for array in arrays:
            array[:, ~evaluation.valid] = np.nan
    u, slope, points, track = (pad_axis(array, 2, axis=0) for array in arrays)
    return Jacobians(insertion.columns.names, by_x, u, slope, points, track, converged)


def differentiate_batch_positions(shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
    """Return the derivatives (B, K, 3, P) of `compute_batch_positions(shapes, s)`."""
    u, slope = list_planes(shapes)
    by = jacobians.x, jacobians.u[: len(u)], jacobians.slope[: len(u)]
    return native.compute_position_derivatives(shapes.x, u, slope, s, *by)


def find_columns(
    wrt: tuple[str, ...],
    tissue: Tissue,
    steps: Sequence[Step],
    rules: ModelOptions,
    values: Iterable[str] = (),
) -> Columns:
    """Return the columns of the derivatives of an insertion by kinds of parameters.

    These are of `DERIVATIVE_KINDS` and `INPUTS_ALONG_Z`; `steps` have the roll of the tip, and
    `values` are the names of what differs between sets.

    Raises ModelError if there is no such kind of parameter.
    """
    guide_depths = sorted({guide.x for step in steps for guide in step.controls.guides})  # from the base on
    planes = count_planes(steps, (*wrt, *values))
    return _make_columns(wrt, tissue.law, tissue.layers, tuple(guide_depths), rules.path_angle, planes)


@lru_cache(maxsize=512)  # a fit asks for the same columns over and over
def _make_columns(
    wrt: tuple[str, ...],
    law: str,
    layers: int,
    guide_depths: tuple[float, ...],
    path_angle: bool,
    planes: int,
) -> Columns:
    all_kinds = (*DERIVATIVE_KINDS, *INPUTS_ALONG_Z)
    wrong = [kind for kind in wrt if kind not in all_kinds]
    if wrong:
        raise ModelError(
            f"there is no derivative with respect to `{wrong[0]}`", expected=f"of {', '.join(all_kinds)}"
        )
    names: list[str] = []
    first: dict[str, int] = {}
    for kind in all_kinds:
        first[kind] = len(names) if kind in wrt else -1
        if kind in wrt:
            names += _list_names(kind, law, layers, len(guide_depths), planes)
    start, size = first["guides"], 1 + 2 * planes
    guides = {
        x: (-1,) * size if start < 0 else range(start + size * i, start + size * (i + 1))
        for i, x in enumerate(guide_depths)
    }
    # The bevel's strength has one column in the kernel; that of the rule which is not used stays 0.
    kinds = [kind for kind in all_kinds if kind not in ("guides", "offset" if path_angle else "cut_angle")]
    return Columns(tuple(names), np.array([first[kind] for kind in kinds]), guides, planes)


def _list_names(kind: str, law: str, layers: int, guides: int, planes: int) -> list[str]:
    if kind == "shape":
        return [name for row in LAWS[law].name_shape(range(1, layers + 1)) for name in row]
    if kind in ("mu", "friction"):
        return [f"{kind}{i + 1}" for i in range(layers)]
    if kind == "boundaries":
        return [f"boundary{i + 1}" for i in range(layers - 1)]
    if kind == "guides":
        parts = ("x", "y", "slope", "z", "slope_z")[: 1 + 2 * planes]
        return [f"guide{i + 1}_{part}" for i in range(guides) for part in parts]
    return [kind]


def simulate_batches(batches: Sequence[Batch], threads: int | None = None) -> tuple[NeedleShapes, ...]:
    """Simulate every parameter set of every batch on all cores, the longest insertions first.

    What a set gives does not depend on the sets beside it, on their order, or on the number of threads: not
    by a bit, and by less than 1e-6 mm where sets have boundaries of their own, at all of which the kernel
    divides the quadrature of the sets that it computes side by side.

    Raises ModelError if a needle is too short for its steps.

    Parameters
    ----------
    threads : int, optional
        By default as many as there are cores.

    Returns
    -------
    tuple of NeedleShapes
        In the order of `batches`; sets that failed are NaN and say why in `status`. Numbers that are no
        parameters (not finite, mu not above 0, a guide out of the needle's reach) count as "non-finite".
    """
    return tuple(shapes for _, shapes in _run(batches, None, threads))


def linearize_batches(
    batches: Sequence[Batch],
    wrt: Sequence[str],
    threads: int | None = None,
    *,
    tracked: bool = True,
    past: int = 0,
) -> tuple[tuple[NeedleShapes, Jacobians], ...]:
    """Simulate as `simulate_batches` does, and differentiate every shape.

    Raises ModelError if a needle is too short for its steps, there is no such kind of parameter, or sets of a
    batch have different boundaries, whose quadrature points differ.

    Parameters
    ----------
    wrt : sequence of str
        Kinds of parameters, as `linearize` takes them.
    tracked : bool
        Whether `tip_track` is asked for; without it, derivatives take less time.
    past : int
        How many steps of each insertion are over: derivatives by bevel, base and guides are those by the
        inputs that are stated anew behind them, which begin another cut. With a gain, they are those by what
        arrives at the needle.

    Returns
    -------
    tuple of (NeedleShapes, Jacobians)
        Solved to `MAX_TOLERANCE_MM` at least; what a set gives is what `linearize_steps` gives.
    """
    pairs = _run(batches, tuple(wrt), threads, tracked, past)
    return tuple((shapes, read_jacobians(evaluation, shapes.converged)) for evaluation, shapes in pairs)


Found = TypeVar("Found")  #: the shapes of a batch, or these and their derivatives
#: number of nodes whose shapes are held at once: each takes 60 bytes, with derivatives about 2 kB in a fit of
#: nine parameters
NODES_AT_ONCE = 40_000


def read_batches(
    batches: Sequence[Batch],
    run: Callable[[list[Batch]], Sequence[Found]],
    read: Callable[[int, Found, slice], tuple[np.ndarray, ...]],
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield what is read of the shapes of each batch, arrays (B, ...), in the order of `batches`.

    The shapes of about `NODES_AT_ONCE` nodes are held at once: `run` gives those of some batches, a large one
    is divided. What is read of a set does not depend on that. `read` is given the number of a batch, the
    shapes of some of its sets, and which sets these are.
    """
    read_parts: list[tuple[np.ndarray, ...]] = []  # of the batch that comes next
    for parts in _divide(batches):
        outcomes = run([batches[number].take(sets) for number, sets in parts])
        for (number, sets), outcome in zip(parts, outcomes, strict=True):
            read_parts.append(read(number, outcome, sets))
            if sets.stop == len(batches[number]):
                yield _join(read_parts)
                read_parts = []


def _divide(batches: Sequence[Batch]) -> Iterator[list[tuple[int, slice]]]:
    """Yield numbers of batches, and sets of each, whose shapes are held at once."""
    parts: list[tuple[int, slice]] = []
    held = 0
    for number, batch in enumerate(batches):
        if parts and held + batch.nodes > NODES_AT_ONCE:
            yield parts
            parts, held = [], 0
        size = max(1, NODES_AT_ONCE * len(batch) // max(1, batch.nodes))
        *whole, last = range(0, len(batch), size)
        for start in whole:
            yield [(number, slice(start, start + size))]
        parts.append((number, slice(last, len(batch))))
        held += batch.nodes * (len(batch) - last) // len(batch)
    if parts:
        yield parts


def _join(parts: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    return parts[0] if len(parts) == 1 else tuple(map(np.concatenate, zip(*parts, strict=True)))


def _run(
    batches: Sequence[Batch],
    wrt: tuple[str, ...] | None,
    threads: int | None,
    tracked: bool = False,
    past: int = 0,
) -> list[tuple[Evaluation, NeedleShapes]]:
    require_type("batches", batches, Sequence)
    for batch in batches:
        require_type("a batch", batch, Batch)
    evaluations = [_evaluate(batch, wrt, tracked, past) for batch in batches]
    run_evaluations(evaluations, threads or count_cores())
    return [
        (evaluation, _read_shapes(batch, evaluation))
        for batch, evaluation in zip(batches, evaluations, strict=True)
    ]


def _evaluate(batch: Batch, wrt: tuple[str, ...] | None, tracked: bool, past: int = 0) -> Evaluation:
    """Return the sets of a batch, of an insertion that is prepared once for all batches of `with_sets`."""
    values = {name: getattr(batch, name) for name in batch.given}
    place = max(step.depth for step in batch.steps) - batch.needle.length if "guide_x" in values else 0.0
    valid = _find_valid(batch, values, place)
    if wrt is not None and "boundaries" in values:
        sound = values["boundaries"][valid]
        if (sound != sound[:1]).any():  # the kernel differentiates by the boundaries of the first one
            raise ModelError(
                "sets of a batch that is differentiated have different boundaries",
                expected="the same boundaries in all of them",
                fix="make a batch of each set",
            )
    if (wrt, past) not in batch.prepared:
        # depths and controls are alike in all valid sets: so one of them is used for all
        steps = batch.vary_inputs(int(np.argmax(valid)))[1] if valid.any() else batch.steps
        if wrt is not None and "rigidity" in wrt:
            require_roll_of_one_rigidity(batch.tissue, steps)
        steps = turn_tip(batch.needle, batch.tissue, steps)
        columns = None if wrt is None else find_columns(wrt, batch.tissue, steps, batch.rules, values)
        batch.prepared[wrt, past] = PreparedInsertion(
            batch.needle, batch.tissue, steps, batch.rules, columns=columns, past=past
        )
    insertion = batch.prepared[wrt, past]
    if not valid.any():  # numbers that a needle may have, in place of what is none
        step = batch.steps[0]
        usable = (
            {name: getattr(step.controls, name) for name in BASE_VALUES}
            | {
                "rigidity": batch.needle.flexural_rigidity,
                "offset": step.bevel.offset,
                "cut_angle": step.bevel.cut_angle,
                "roll": 0.0,
                "gain": 1.0,
                "guide_x": step.controls.guides[0].x if "guide_x" in values else 0.0,
            }
            | {name: getattr(batch.tissue, name) for name in OF_LAYERS}
        )
        values = {name: np.full(array.shape, usable[name]) for name, array in values.items()}
    return Evaluation(insertion, values, valid, tracked)


def _find_valid(batch: Batch, values: Mapping[str, Floats], base: float) -> Bools:
    """Return which sets are made of numbers that a tissue or needle may have, (B,); `base` is its x, mm."""
    count = len(batch)
    valid = np.ones(count, dtype=bool)
    for name, value in values.items():
        low, high = _find_limits(name, batch.tissue.law)
        accepted = (value >= low) & (value <= high)  # NaN compares as false
        if name == "boundaries":
            accepted &= np.diff(value, axis=1, prepend=0.0) >= 0
        if name == "guide_x":  # before the tissue, and where the base does not come to it
            accepted &= (value < 0) & (value > base)
        if not accepted.all():
            valid &= accepted.reshape(count, -1).all(axis=1)
    return valid


@lru_cache(maxsize=64)  # the sets of all insertions are compared with the same ones
def _find_limits(name: str, law: str) -> Floats:
    """Return the least and the greatest number that a set may give, (2,), of a law's parameters (2, p, 1)."""
    if name == "shape":
        bounds = [parameter.bounds for parameter in LAWS[law].parameters]
        return np.clip(np.array(bounds).reshape(-1, 2).T[:, :, None], -MAX_NUMBER, MAX_NUMBER)
    return np.array([math.ulp(0.0) if name in ("mu", "rigidity") else -MAX_NUMBER, MAX_NUMBER])


def _read_shapes(batch: Batch, evaluation: Evaluation) -> NeedleShapes:
    a, wrong = evaluation.shapes.arrays, ~evaluation.valid
    if not evaluation.all_valid:
        a["status"][wrong], a["passes"][wrong] = native.NON_FINITE, 0
        a["u"][:, wrong] = a["slope"][:, wrong] = a["track"][wrong] = a["constraints"][wrong, 1:, 1:] = np.nan
    insertion, boundaries = evaluation.insertion, evaluation.values.get("boundaries")
    if boundaries is None:
        scales = np.broadcast_to(insertion.scales, (len(batch), 2))
    else:
        scales = compute_scales(batch.tissue, insertion.depth, batch.rules.spacing, boundaries)
    nodes = native.to_space(*(a[name] for name in ("x", "u", "slope", "constraints", "track")))
    return NeedleShapes(*nodes, a["status"], a["passes"], scales)
