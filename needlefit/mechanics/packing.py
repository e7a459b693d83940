"""Bring insertions into the form that the kernel reads: stops, inputs, layers, and parameter sets.

Prepare an insertion for the kernel once; each evaluation then adds its parameter sets alone.

A tissue law is read as powers of the stretch, or as a table. A law that is no sum of powers is interpolated
at Chebyshev points on short pieces of the compression d = 1 - lambda. Its error is measured between the
points each time: the table ends before the first piece where it exceeds `TABLE_TOLERANCE`, and tissue that
is compressed further is over-compressed.
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from needlefit.arrays import Bools, Floats, Ints
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.laws import LAWS, PowerLaw
from needlefit.mechanics.native import (
    MAX_SERIES_COMPRESSION,
    SERIES_TOLERANCE,
    TABLE_COMPRESSION,
    TABLE_PIECES,
    TABLE_TERMS,
    measure_table_range,
)
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice, Move, TipStop, check_size, make_lattice, make_moves, make_stops
from needlefit.mechanics.shape import compute_scales
from needlefit.mechanics.tissue import Tissue

#: smallest |e| / t at which a table may end: the kernel's series may go so far
MIN_TABLE_COMPRESSION = MAX_SERIES_COMPRESSION
TABLE_TOLERANCE = SERIES_TOLERANCE / 10  #: largest relative error of k in a table

_PIECE = TABLE_COMPRESSION / TABLE_PIECES  #: length of a piece of a table, in |e| / t
# |e| / t by which a table ends before the end of its last good piece, so that no further piece is read
_END = 1e-12
#: Chebyshev points on [-1, 1], and the places between them where the error of the polynomial is largest
_POINTS = np.cos(np.pi * (2 * np.arange(TABLE_TERMS) + 1) / (2 * TABLE_TERMS))
_BETWEEN = np.cos(np.pi * np.array([0, 1, TABLE_TERMS // 2, TABLE_TERMS - 1, TABLE_TERMS]) / TABLE_TERMS)
_TO_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_POINTS, TABLE_TERMS - 1)).T
_TO_BETWEEN = chebyshev.chebvander(_BETWEEN, TABLE_TERMS - 1).T
#: stretches of the points of each piece, then of the places between them, (pieces, points)
_STRETCH = 1 - _PIECE * (np.arange(TABLE_PIECES)[:, None] + 0.5 * (1 + np.concatenate((_POINTS, _BETWEEN))))


def compile_law(name: str, shape: Floats) -> tuple[Floats, Floats]:
    """Return a law at the shape parameters (..., p, n) of n layers: coefficients and exponents, or a table.

    Those are (..., n, P) each. A table is (..., n, 2 + TABLE_PIECES TABLE_TERMS), with exponents (..., n, 0):
    see `native/law.hpp`.

    Raises ConfigError if there is no law of that name; ModelError if the law cannot be interpolated in one of
    the layers.
    """
    law, by_layer = LAWS[name], np.swapaxes(shape, -1, -2)
    if isinstance(law, PowerLaw):
        return law.power_terms(by_layer)
    different, places = _list_different(by_layer)
    tables = _make_tables(name, different.tobytes(), *different.shape)
    short = tables[places, 0] < MIN_TABLE_COMPRESSION - _END  # (..., n)
    if short.any():
        place = tuple(np.argwhere(short)[0])
        stated = [
            f"{parameter.name} = {value:g}"
            for parameter, value in zip(law.parameters, by_layer[place].tolist(), strict=True)
        ]
        raise ModelError(
            f"layer {place[-1] + 1}: the tissue law `{name}` cannot be interpolated at {', '.join(stated)}",
            expected=f"k > 0, smooth and not too steep up to |e| / t = {MIN_TABLE_COMPRESSION:g}",
            fix="choose other values, or narrower bounds for them",
        )
    return tables[places], np.empty((*places.shape, 0))


def differentiate_law(name: str, shape: Floats) -> Floats:
    """Return the derivatives of what `compile_law` returns by the p shape parameters.

    Those of a table are (..., n, p, numbers). Those of coefficients and then exponents, (p, 2 P), are the
    same for all layers.
    """
    law, by_layer = LAWS[name], np.swapaxes(shape, -1, -2)
    if isinstance(law, PowerLaw):
        return np.concatenate(law.term_slopes, axis=1)
    different, places = _list_different(by_layer)
    return _make_slope_tables(name, different.tobytes(), *different.shape)[places]


def _list_different(by_layer: Floats) -> tuple[Floats, Ints]:
    """Return the different rows (R, p) of shape parameters (..., p), and which each layer (...) has."""
    rows = by_layer.reshape(math.prod(by_layer.shape[:-1]), by_layer.shape[-1])
    if rows.shape[1] == 0:
        return rows[:1], np.zeros(by_layer.shape[:-1], dtype=np.int64)
    different, places = np.unique(rows, axis=0, return_inverse=True)
    return different, places.reshape(by_layer.shape[:-1])


@lru_cache(maxsize=8)  # a fit simulates many insertions with the same parameters
def _make_tables(name: str, rows: bytes, count: int, parameters: int) -> Floats:
    """Return the tables of R different layers, see `native/law.hpp`: (R, numbers)."""
    stretch, shape = _repeat(rows, count, parameters, _STRETCH)
    with np.errstate(all="ignore"):
        k = LAWS[name].k(stretch, *shape)  # (R, pieces, points)
        series = k[..., :TABLE_TERMS] @ _TO_COEFFICIENTS
        error = np.abs(series @ _TO_BETWEEN - k[..., TABLE_TERMS:])
        good = np.all(error <= TABLE_TOLERANCE * k[..., TABLE_TERMS:], axis=-1) & np.all(k > 0, axis=-1)
    pieces = np.where(good.all(axis=1), TABLE_PIECES, np.argmin(good, axis=1))
    tables = np.zeros((count, 2 + TABLE_PIECES * TABLE_TERMS))
    tables[:, 0], tables[:, 2:] = _PIECE * pieces - _END, np.nan_to_num(series).reshape(count, -1)
    for row in np.flatnonzero(pieces):
        tables[row, 1] = measure_table_range(tables[row])
    return tables


@lru_cache(maxsize=8)
def _make_slope_tables(name: str, rows: bytes, count: int, parameters: int) -> Floats:
    """Return the derivatives of tables by their shape parameters, (R, p, numbers)."""
    stretch, shape = _repeat(rows, count, parameters, _STRETCH[:, :TABLE_TERMS])
    slopes = np.zeros((count, parameters, 2 + TABLE_PIECES * TABLE_TERMS))
    with np.errstate(all="ignore"):
        for number in range(parameters):
            series = LAWS[name].dk_dshape(number, stretch, *shape) @ _TO_COEFFICIENTS
            slopes[:, number, 2:] = np.nan_to_num(series).reshape(count, -1)
    return slopes


def _repeat(rows: bytes, count: int, parameters: int, stretch: Floats) -> tuple[Floats, list[Floats]]:
    """Return stretches and shape parameters as arrays of one size, (R, pieces, points)."""
    shape = np.frombuffer(rows).reshape(count, parameters)
    size = (count, *stretch.shape)
    columns = [np.broadcast_to(column[:, None, None], size).copy() for column in shape.T]
    return np.broadcast_to(stretch, size).copy(), columns


class Columns(NamedTuple):
    """Columns of derivatives: their names, the first of each kind (-1: none), those of each guide."""

    names: tuple[str, ...]
    first: Ints  # (13,) of `ColumnKind` in `native/derivatives.hpp`
    guides: Mapping[float, Sequence[int]]  # by a guide's x: of its x, y and slope, then of z and its slope
    planes: int  # in which the needle and its derivatives lie

    @property
    def total(self) -> int:
        """Their number."""
        return len(self.names)


class PackedStops(NamedTuple):
    """Stops of the tip, and the numbers of the steps whose bevels and controls they name."""

    stops: np.ndarray  # (S,) of native.STOP
    bevels: tuple[int, ...]
    controls: tuple[int, ...]
    last: TipStop
    rays: int

    def list_inputs(self, steps: Sequence[Step]) -> tuple[tuple[Bevel, ...], tuple[Controls, ...]]:
        """Return the bevels and the controls that the stops name."""
        return tuple(steps[i].bevel for i in self.bevels), tuple(steps[i].controls for i in self.controls)


def pack_insertion(
    steps: Sequence[Step],
    length: float,
    rules: ModelOptions,
    lattice: Lattice | None = None,
    past: int = 0,
) -> tuple[Lattice, PackedStops]:
    """Return the lattice of constraint points, by default the usual one, and the stops of a needle (mm long).

    Those of the first `past` steps are marked.

    Raises ModelError if there are no steps, they are too many or too deep, or the needle is too short for one
    of them.
    """
    moves = make_moves(steps, length, past)
    check_size(tuple(step.depth for step in steps), rules)
    lattice = lattice or make_lattice(steps, rules)
    return lattice, _pack_moves(moves, lattice, past)


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def _pack_moves(moves: tuple[Move, ...], lattice: Lattice, past: int) -> PackedStops:
    return pack_stops(make_stops(moves, lattice), len(make_stops(moves[:past], lattice)) if past else 0)


def pack_stops(stops: Sequence[TipStop], past: int = 0) -> PackedStops:
    """Return stops in the form that the kernel reads; the first `past` are marked."""
    bevels = tuple(dict.fromkeys(stop.bevel_id for stop in stops))
    controls = tuple(dict.fromkeys(stop.controls_id for stop in stops))
    packed = np.empty(len(stops), native.STOP)
    for n, stop in enumerate(stops):
        flags = native.PERMANENT * stop.permanent + native.STARTS_RAY * stop.starts_ray
        flags += native.EXTRAPOLATES * stop.extrapolates + native.PAST * (n < past)
        places = bevels.index(stop.bevel_id), controls.index(stop.controls_id)
        packed[n] = stop.tip, stop.cell, stop.ray, *places, flags
    packed.flags.writeable = False  # kept for the next insertion of the same steps
    return PackedStops(packed, bevels, controls, stops[-1], 1 + max(stop.ray for stop in stops))


#: values of the base that a set of `batch.Batch` may give: its plane, and its place there in `Controls.base`
BASE_VALUES = {"base_y": (0, 0), "base_slope": (0, 1), "base_z": (1, 0), "base_slope_z": (1, 1)}
#: inputs of a set, or of a derivative, that take a needle out of its plane
INPUTS_ALONG_Z = ("roll", "base_z", "base_slope_z", "stage_slope_z")


def count_planes(steps: Sequence[Step], varied: Iterable[str] = ()) -> int:
    """Return the planes in which a needle bends: 1 where all inputs lie in z = 0, else 2.

    `varied` are the names of what differs between sets, and of what is differentiated by.
    """
    along_z = any(name in INPUTS_ALONG_Z for name in varied) or any(step.acts_along_z for step in steps)
    return 1 + along_z


def compute_turn(bevel: Bevel, rules: ModelOptions) -> tuple[float, float]:
    """Return the slopes along y and z that a bevel adds to the cut."""
    strength, length = rules.bevel_strength(bevel)
    y, z = bevel.toward
    return y * strength / length, z * strength / length


def list_guides(guides: Sequence[Guide], planes: int) -> Floats:
    """Return x, y and slope of guides, of two planes z and its slope too, (G, 1 + 2 P); NaN: a free slope."""
    rows = [(guide.x, *_list_held(guide, planes)) for guide in guides]
    return np.array(rows, dtype=np.float64).reshape(-1, 1 + 2 * planes)


def list_tip(controls: Controls, planes: int) -> tuple[float, ...]:
    """Return place and slope of a tracked tip, in each plane; NaN where it is free."""
    return (math.nan,) * (2 * planes) if controls.tip is None else _list_held(controls.tip, planes)


def _list_held(hold: Guide | TrackedTip, planes: int) -> tuple[float, ...]:
    free = hold.slope is None
    numbers = (
        hold.y,
        math.nan if hold.slope is None else hold.slope,
        hold.z,
        math.nan if free else hold.slope_z,
    )
    return numbers[: 2 * planes]


def pack_layers(
    tissue: Tissue, sets: int, values: Mapping[str, Floats]
) -> tuple[dict[str, int], dict[str, Floats]]:
    """Return sizes and arrays of the layers; `values` (sets, n) replace those of the tissue."""

    def repeat(name: str) -> Floats:
        if name in values:
            return values[name]
        of_one = getattr(tissue, name)
        repeated = np.empty((sets, len(of_one)))  # filled in a quarter of the time of `np.tile`
        repeated[:] = of_one
        return repeated

    size = (sets, tissue.layers)
    coefficients, exponents = compile_law(tissue.law, values.get("shape", tissue.shape))
    law = np.concatenate((coefficients, exponents), axis=-1)  # (sets, n, numbers), or of all (n, numbers)
    sizes = {
        "layers": tissue.layers, "shapes": len(tissue.shape), "terms": exponents.shape[-1],
        "numbers": law.shape[-1],
    }  # fmt: skip
    arrays = {name: repeat(name) for name in ("mu", "boundaries", "thickness", "friction")}
    arrays["law"] = np.ascontiguousarray(np.broadcast_to(law, (*size, law.shape[-1])))
    return sizes, arrays


def pack_sets(
    needle: Needle,
    tissue: Tissue,
    inputs: tuple[Sequence[Bevel], Sequence[Controls]],
    rules: ModelOptions,
    planes: int,
    sets: int,
    values: Mapping[str, Floats],
    columns: Columns | None = None,
) -> tuple[dict[str, int], dict[str, Floats]]:
    """Return sizes of the layers, and the arrays of parameter sets, of an insertion under these inputs.

    `values` are what differs between sets, by the names of `batch.Batch`.

    Raises ModelError if a law cannot be interpolated at its shape parameters.
    """
    bevels, controls = inputs
    given = values.get("cut_angle" if rules.path_angle else "offset")
    # the slopes that each bevel adds to the cut, and their derivatives by the bevel's strength
    turn, turn_by = (np.empty((len(bevels), sets, planes)) for _ in range(2))
    for i, bevel in enumerate(bevels):
        toward: tuple[float | Floats, float | Floats] = bevel.toward
        strength, length = rules.bevel_strength(bevel)
        if "roll" in values:
            c, s = np.cos(values["roll"]), np.sin(values["roll"])
            toward = toward[0] * c - toward[1] * s, toward[0] * s + toward[1] * c
        for plane, part in enumerate(toward[:planes]):
            turn_by[i, :, plane] = part / length
            turn[i, :, plane] = part * strength / length if given is None else turn_by[i, :, plane] * given
    base = np.empty((len(controls), sets, planes, 3))
    for i, control in enumerate(controls):
        base[i].reshape(sets, 3 * planes)[:] = control.base[: 3 * planes]
        for name, (plane, place) in BASE_VALUES.items():
            if name in values:
                base[i, :, plane, place] = values[name]
        if "gain" in values:
            base[i] += (values["gain"] - 1)[:, None, None] * (base[i] - base[0])
    of_layers, of_sets = pack_layers(tissue, sets, values)
    rigidity = values.get("rigidity")
    of_sets |= {
        "rigidity": np.full(sets, needle.flexural_rigidity) if rigidity is None else rigidity,
        "turn": turn,
        "base": base,
    }
    if "guide_x" in values:
        of_sets["guide_x"] = values["guide_x"]
    if columns is not None and columns.total:
        of_sets["turn_by"] = turn_by
    if columns is not None and columns.first[native.SHAPE_COLUMN] >= 0:
        by = differentiate_law(tissue.law, values.get("shape", tissue.shape))
        size = sets, tissue.layers, len(tissue.shape), of_layers["numbers"]
        of_sets["law_by"] = np.ascontiguousarray(np.broadcast_to(by, size))
    return of_layers, of_sets


def pack_problem(
    needle: Needle,
    tissue: Tissue,
    steps: Sequence[Step],
    lattice: Lattice,
    rules: ModelOptions,
    packed: PackedStops,
    *,
    planes: int | None = None,
    sets: int = 1,
    values: Mapping[str, Floats] | None = None,
    columns: Columns | None = None,
    **sizes: float,
) -> native.KernelProblem:
    """Return an insertion as the kernel reads it, of which `packed` are the stops on the lattice.

    `steps` have the roll of the tip. `planes` are by default as many as these need. `values` are what differs
    between sets, by the names of `batch.Batch`, `columns` those of the derivatives that are asked for.
    `sizes` are fields of `native.KernelProblem` with other values than the insertion's.

    Raises ModelError if a law cannot be interpolated at its shape parameters.
    """
    values = values or {}
    if planes is None:
        planes = columns.planes if columns else count_planes(steps, values)
    inputs = _, controls = packed.list_inputs(steps)
    of_layers, of_sets = pack_sets(needle, tissue, inputs, rules, planes, sets, values, columns)
    before, within = ([getattr(control, name) for control in controls] for name in ("before", "within"))
    arrays: dict[str, np.ndarray] = {
        "stops": packed.stops,
        "before_first": np.cumsum([0, *map(len, before)]),
        "within_first": np.cumsum([0, *map(len, within)]),
        "before": list_guides([guide for some in before for guide in some], planes),
        "within": list_guides([guide for some in within for guide in some], planes),
        "held_tip": np.array([list_tip(control, planes) for control in controls]).reshape(-1, planes, 2),
    }
    if columns is not None and columns.total:
        rows = [columns.guides[guide.x] for control in controls for guide in control.guides]
        arrays["column_of"] = columns.first
        arrays["guide_columns"] = np.array(rows, dtype=np.int64).reshape(-1, 1 + 2 * planes)
    numbers = {
        "planes": planes,
        "stop_count": len(packed.stops), "rays": packed.rays, "columns": columns.total if columns else 0,
        "bevels": len(packed.bevels), "inputs": len(controls), "sets": sets,
        "guides": max(len(control.guides) for control in controls), "max_iterations": rules.max_iterations,
        "length": needle.length, "first_cell": lattice.first_cell, "spacing": lattice.spacing,
        "element": rules.element, "part": rules.cut_switch, "tangent": rules.tangent,
        "tolerance": rules.tolerance, "deepest": max(step.depth for step in steps),
    }  # fmt: skip
    return native.KernelProblem.make(of_layers | numbers | sizes, arrays | of_sets)


#: largest Newton tolerance (mm) of differentiated shapes; at it, `simulate_steps` gives the same shape
MAX_TOLERANCE_MM = 1e-9


class PreparedInsertion:
    """An insertion in the form that the kernel reads; plan, stops and guides are packed once.

    Its steps have the roll of the tip.
    By default the constraint points of the lattice lie so that the last step ends on one. With columns of
    derivatives it is solved to `MAX_TOLERANCE_MM` at least; those by the inputs are by the inputs behind the
    first `past` steps.

    Raises ModelError if there are no steps, or the needle is too short for one of them.
    """

    def __init__(
        self,
        needle: Needle,
        tissue: Tissue,
        steps: Sequence[Step],
        rules: ModelOptions,
        lattice: Lattice | None = None,
        columns: Columns | None = None,
        past: int = 0,
    ) -> None:
        if columns is not None:
            rules = replace(rules, tolerance=min(rules.tolerance, MAX_TOLERANCE_MM))
        self.needle, self.tissue, self.steps, self.rules, self.columns = needle, tissue, steps, rules, columns
        self.lattice, self._packed = pack_insertion(steps, needle.length, rules, lattice, past)
        self.points, self._inputs = self._packed.last.cell + 1, self._packed.list_inputs(steps)
        self.depth = self._packed.last.tip
        self.scales = compute_scales(tissue, self.depth, self.lattice.spacing)
        # about: it orders insertions by their cost
        self.nodes_solved = float(self._packed.stops["tip"].sum())
        self._problem: native.KernelProblem | None = None

    def pack(self, sets: int, values: Mapping[str, Floats]) -> native.KernelProblem:
        """Return the problem of so many parameter sets; `values` are named as in `batch.Batch`.

        Every call gives values of the same names.
        """
        if self._problem is None:
            # of one set, because it is kept: arrays of hundreds take half a megabyte a needle
            first = {name: array[:1] for name, array in values.items()}
            self._problem = pack_problem(
                self.needle, self.tissue, self.steps, self.lattice, self.rules, self._packed,
                values=first, columns=self.columns,
            )  # fmt: skip
            self._problem.nodes = native.count_nodes(self._problem)
            if sets == 1:
                return self._problem
        given = self.needle, self.tissue, self._inputs, self.rules, self._problem.planes
        return self._problem.with_sets(sets, pack_sets(*given, sets, values, self.columns)[1])


class Evaluation:
    """Parameter sets of a prepared insertion, and room for their shapes.

    `values` are named as in `batch.Batch`. Sets that are not `valid` (B,), made of numbers that a tissue or
    needle may have, are not computed. `tracked`: with the derivatives of the tip at every constraint point.
    """

    def __init__(
        self,
        insertion: PreparedInsertion,
        values: Mapping[str, Floats],
        valid: Bools,
        tracked: bool = True,
    ) -> None:
        self.insertion, self.valid, self.some = insertion, valid, int(valid.argmax())
        self.all_valid = bool(valid.all())
        if not self.all_valid:  # what is no parameter is replaced by one; what it gives is discarded
            rows = np.where(valid, np.arange(len(valid)), self.some)
            values = {name: array[rows] for name, array in values.items()}
        self.values = values
        self.problem = insertion.pack(len(valid), values)
        self.shapes = native.make_shapes(self.problem, insertion.points, tracked)

    @property
    def sets(self) -> int:
        """B: the number of parameter sets."""
        return len(self.valid)


def run_evaluations(evaluations: Sequence[Evaluation], threads: int) -> None:
    """Let the kernel fill the shapes of all evaluations, the longest insertions first, on so many threads."""
    width = native.count_lanes()
    tasks = [(evaluation, start) for evaluation in evaluations for start in range(0, evaluation.sets, width)]
    # Longest first: a long task that begins last would leave the other threads idle.
    tasks.sort(key=lambda task: -task[0].insertion.nodes_solved)  # stable: blocks of one batch stay in order
    waiting = deque(tasks)
    widths = [(evaluation, 1 if evaluation.sets == 1 else width) for evaluation in evaluations]
    most = max((native.measure_memory(evaluation.problem, lanes) for evaluation, lanes in widths), default=0)

    def run() -> None:
        memory = native.make_memory(most)
        while True:
            try:
                evaluation, start = waiting.popleft()
            except IndexError:
                return
            lanes = 1 if start + 1 == evaluation.sets else width
            native.simulate(evaluation.problem, evaluation.shapes, start, lanes, memory)

    threads = min(threads, len(tasks))
    if threads <= 1:
        run()
        return
    with ThreadPoolExecutor(threads) as pool:  # the kernel runs without the interpreter
        for future in [pool.submit(run) for _ in range(threads)]:
            future.result()
