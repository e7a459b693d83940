"""Simulate many insertions with many parameter sets: vector instructions within one, threads between."""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Bools, Floats, Ints
from needlefit.mechanics.batch import VARYING_FIELDS, Batch, NeedleShapes
from needlefit.mechanics.insertion_limits import check_size
from needlefit.mechanics.kernel.foundation import SERIES_TERMS, make_foundation
from needlefit.mechanics.kernel.grid import GUIDE_ENGAGEMENT_MM, list_constraint_depths
from needlefit.mechanics.kernel.insertion import (
    GUIDE_X,
    BoundaryConditions,
    KernelInsertion,
    TipStops,
    build_stop_grid,
)
from needlefit.mechanics.kernel.lanes import insertion as kernel
from needlefit.mechanics.kernel.lanes.newton import LEFT_LANES, LaneInputs, LaneWorkspace, make_workspace
from needlefit.mechanics.kernel.lanes.tables import LANES, LAYER_ROWS, LaneTables, tabulate
from needlefit.mechanics.kernel.scalar import NON_FINITE, NewtonOptions
from needlefit.mechanics.law_form import compile_law
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.plan import SAME_DEPTH_MM, Lattice, TipStop, make_lattice, make_moves, make_stops
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import (
    begin_insertion,
    compile_controls,
    pack_groups,
    read_shape,
    simulate_steps,
)
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.validity import compute_batch_scales


def simulate_batches(batches: Sequence[Batch], threads: int | None = None) -> tuple[NeedleShapes, ...]:
    """Simulate every parameter set of every batch on all cores, the longest insertions first.

    What a set gives does not depend on the sets beside it, on their order, or on the number of threads. A
    set goes through the scalar kernel, alone, where its tissue is compressed beyond the series of its law, or
    where friction is so strong that the lanes do not converge.

    Parameters
    ----------
    threads : int, optional
        By default as many as there are cores.

    Returns
    -------
    tuple of NeedleShapes
        In the order of `batches`; sets that failed are NaN and say why in `status`. Numbers that are no
        parameters (not finite, mu not above 0, a guide out of the needle's reach) count as "non-finite".

    Raises
    ------
    ModelError
        If a needle is too short for its steps.
    """
    known: _KnownLayers = {}
    jobs = [_prepare_job(batch, known) for batch in batches]
    tasks = [(n, start) for n, job in enumerate(jobs) for start in range(0, len(job.batch), LANES)]
    # Longest first: a long task that begins last would leave the other threads idle.
    tasks.sort(key=lambda task: -jobs[task[0]].cost)  # stable: blocks of one batch stay in order
    threads = min(threads or len(os.sched_getaffinity(0)), len(tasks))

    lane_jobs = [job.lanes for job in jobs if job.lanes is not None]
    nodes = max((job.nodes for job in lane_jobs), default=0)
    points = max((job.points for job in lane_jobs), default=0)
    spare = SimpleQueue[LaneWorkspace]()  # of tasks that have ended

    def run(task: tuple[int, int]) -> _Block:
        try:
            workspace = spare.get_nowait()
        except Empty:
            workspace = make_workspace(nodes, points)
        try:
            return _simulate_block(jobs[task[0]], task[1], workspace)
        finally:
            spare.put(workspace)

    if threads <= 1:
        parts = [run(task) for task in tasks]
    else:
        with ThreadPoolExecutor(threads) as pool:  # the kernel lets go of the interpreter
            parts = list(pool.map(run, tasks))
    found: list[list[_Block]] = [[] for _ in jobs]
    for (n, _), part in zip(tasks, parts, strict=True):
        found[n].append(part)
    return tuple(_join_blocks(job, some) for job, some in zip(jobs, found, strict=True))


_Block = tuple[NeedleShapes, Bools]  # of up to LANES sets, and which of them went through the scalar kernel
_Grids = tuple[KernelInsertion, LaneTables]
_KnownLayers = dict[tuple[object, ...], tuple[Floats, Floats]]


@dataclass(frozen=True)
class _LaneGroup:
    """The stops under the same controls and past the same guides in the tissue, and what their inputs are in
    every set.
    """

    conditions: BoundaryConditions
    stops: TipStops
    grids: int  # number of its main grid in `_LaneJob.grids`
    base: Floats  # (3, S) as `LaneInputs`, of the sets in `_LaneJob.lane`
    turns: Floats  # (bevels, S) of every bevel
    of_stop: Ints  # the bevel of each stop


@dataclass(frozen=True)
class _LaneJob:
    """What the sets of a batch share in the lanes; S of them, whole blocks."""

    grids: tuple[_Grids, ...]  # a main grid for each choice of guides in the tissue that are passed
    lane: Ints  # (S,) the set of each lane; those to spare repeat the last block's
    layers: tuple[Floats, Floats]  # of every block, as `_make_layers` returns them
    has_friction: bool
    rigidity: Floats  # (S,)
    groups: tuple[_LaneGroup, ...]

    @property
    def nodes(self) -> int:
        """Nodes in the tissue, at most."""
        return max(len(grids.main.nodes) for grids, _ in self.grids) + 2

    @property
    def points(self) -> int:
        """Quadrature points, at most; the grid of a stop between constraint points may have a few more."""
        return max(len(grids.main.x) for grids, _ in self.grids) + 8


@dataclass(frozen=True)
class _BatchJob:
    batch: Batch
    lattice: Lattice
    stops: tuple[TipStop, ...]
    valid: Bools  # (B,) which sets are made of numbers that needle and tissue accept
    scales: Floats  # (B, 3) what their validity is measured by, mm
    lanes: _LaneJob | None  # None: every set goes alone

    @cached_property
    def cost(self) -> float:
        """Nodes to be solved for, about."""
        return sum(stop.tip for stop in self.stops)


def _prepare_job(batch: Batch, known: _KnownLayers) -> _BatchJob:
    valid = _find_valid(batch)
    needle, steps, rules = batch.needle, batch.steps, batch.rules
    if valid.any():  # depths and controls are alike in all valid sets: so one of them is used for all
        needle, steps = batch.vary_inputs(int(np.argmax(valid)))
    lattice = make_lattice(steps, rules)
    moves = make_moves(steps, needle.length)
    check_size(tuple(step.depth for step in steps), rules)
    stops = make_stops(moves, lattice)
    lanes = None
    if _fits_lanes(batch, lattice, stops):
        grids = begin_insertion(needle, batch.tissue, steps, lattice, rules)
        lanes = _prepare_lanes(batch, grids, pack_groups(moves, lattice), valid, known)
    scales = _make_scales(batch, valid, stops[-1].tip)
    return _BatchJob(batch, lattice, stops, valid, scales, lanes)


def _prepare_lanes(
    batch: Batch,
    grids: KernelInsertion,
    groups: Sequence[tuple[int, TipStops, Ints]],
    valid: Bools,
    known: _KnownLayers,
) -> _LaneJob:
    """Return what the sets share, and what differs between them in the order of the lanes.

    `known` are the layers of batches before this one, which often has the same sets at other depths.
    """
    starts = range(0, len(batch), LANES)
    lane = np.concatenate([np.resize(np.arange(i, min(i + LANES, len(batch))), LANES) for i in starts])

    def given(name: str, otherwise: float) -> Floats:
        values = getattr(batch, name)
        return np.full(len(lane), otherwise) if values is None else values[lane]

    tissue = batch.tissue
    shape = (len(lane), tissue.layers)
    mu = np.broadcast_to(tissue.mu if batch.mu is None else batch.mu[lane], shape)
    alpha = np.broadcast_to(tissue.alpha if batch.alpha is None else batch.alpha[lane], shape)
    # Lanes of invalid sets compute with harmless numbers; `_simulate_block` replaces their results.
    mu, alpha = (np.where(valid[lane, None], values, 1.0) for values in (mu, alpha))
    key = (tissue.law, *(part.tobytes() for part in (mu, alpha, tissue.thickness, tissue.friction)))
    if key not in known:
        known[key] = _make_layers(tissue, mu, alpha)
    prepared, mains = [], _MainGrids(grids)
    name = "cut_angle" if batch.rules.path_angle else "offset"
    for controls_id, stops, bevel_id in groups:
        conditions = compile_controls(batch.steps[controls_id].controls)
        base = conditions.base
        ids, of_stop = np.unique(bevel_id, return_inverse=True)  # few bevels, many stops
        bevels = [batch.steps[step].bevel for step in ids]
        strengths = [(bevel.side, *batch.rules.bevel_strength(bevel)) for bevel in bevels]
        turns = np.array([side / length * given(name, strength) for side, strength, length in strengths])
        base = np.array([given("base_y", base[0]), given("base_slope", base[1]), np.full(len(lane), base[2])])
        for run, run_stops, passed in _divide_stops(conditions, stops):
            number = mains.find(conditions, passed)
            prepared.append(_LaneGroup(conditions, run_stops, number, base, turns, of_stop[run]))
    return _LaneJob(
        tuple(mains.grids), lane, known[key], bool(tissue.friction.any()),
        given("rigidity", batch.needle.flexural_rigidity), tuple(prepared),
    )  # fmt: skip


def _divide_stops(conditions: BoundaryConditions, stops: TipStops) -> list[tuple[slice, TipStops, int]]:
    """Return the runs of stops past the same number of guides in the tissue, and that number."""
    if not len(conditions.within):
        return [(slice(None), stops, 0)]
    passed = np.searchsorted(conditions.within[:, GUIDE_X], stops.tip - GUIDE_ENGAGEMENT_MM, side="right")
    ends = [0, *(np.flatnonzero(np.diff(passed)) + 1), len(passed)]
    runs = [slice(start, end) for start, end in pairwise(ends)]
    return [(run, TipStops._make(part[run] for part in stops), int(passed[run.start])) for run in runs]


class _MainGrids:
    """The main grids of an insertion with their tables, by the guides in the tissue that have nodes there."""

    def __init__(self, insertion: KernelInsertion) -> None:
        self._numbers: dict[bytes, int] = {b"": 0}
        self.grids: list[_Grids] = [(insertion, tabulate(insertion.main))]

    def find(self, conditions: BoundaryConditions, passed: int) -> int:
        """Return the number of the grid past the first `passed` guides; make it if it is missing."""
        within = np.ascontiguousarray(conditions.within[:passed])
        key = within[:, GUIDE_X].tobytes()
        if key not in self._numbers:
            insertion, _ = self.grids[0]
            tip, cell = float(insertion.main.nodes[-1]), len(insertion.y) - 1
            main = build_stop_grid(insertion, conditions._replace(within=within), tip, cell)
            self._numbers[key] = len(self.grids)
            self.grids.append((insertion._replace(main=main), tabulate(main)))
        return self._numbers[key]


def _find_valid(batch: Batch) -> Bools:
    """Return which sets are made of numbers that a tissue or needle may have, (B,)."""
    good = np.ones(len(batch), dtype=bool)
    deepest = max(step.depth for step in batch.steps)
    for name in VARYING_FIELDS:
        values = getattr(batch, name)
        if values is not None:
            accepted = np.isfinite(values)
            if name in ("mu", "rigidity"):
                accepted &= values > 0
            if name == "alpha":
                low, high = LAWS[batch.tissue.law].alpha_range
                accepted &= (values >= low) & (values <= high)
            if name == "guide_x":  # before the tissue, and where the base does not come to it
                accepted &= (values < 0) & (values > deepest - batch.needle.length)
            good &= accepted.reshape(len(batch), -1).all(axis=1)
    return good


def _fits_lanes(batch: Batch, lattice: Lattice, stops: Sequence[TipStop]) -> bool:
    """Return whether the lanes know how to hold this needle."""
    element, first = batch.rules.element, lattice.first_cell
    least = first - element * (math.ceil((first - SAME_DEPTH_MM) / element) - 1)  # depth of the first node
    # element 0 carries tissue where the entry has no node; its length must then be the same in all lanes
    inputs = [step.controls for step in batch.steps]
    least = min([least, *(guide.x for controls in inputs for guide in controls.within if guide.x > 0)])
    short = least < 0.5 * element or any(0 < stop.tip < 0.5 * element for stop in stops)
    free = any(controls.before and controls.before[-1].slope is None for controls in inputs)
    return not (short and (free or batch.guide_x is not None))


def _make_layers(tissue: Tissue, mu: Floats, alpha: Floats) -> tuple[Floats, Floats]:
    """Return the series and limits of the layers of every block, (blocks, n LAYER_ROWS W), and curvatures
    (blocks, W), of parameters (S, n).
    """
    sets, layers = mu.shape
    terms = compile_law(tissue.law, alpha.ravel())
    common = (np.tile(part, sets) for part in (tissue.thickness, tissue.friction))
    found = make_foundation(mu.ravel(), *terms, *common)
    # each row of LANES numbers must be contiguous
    series = np.empty((sets // LANES, layers, LAYER_ROWS, LANES))
    series[:, :, :SERIES_TERMS] = found.series.reshape(-1, LANES, layers, SERIES_TERMS).transpose(0, 2, 3, 1)
    for row, part in enumerate((found.limit, found.curvature, found.friction), start=SERIES_TERMS):
        series[:, :, row] = part.reshape(-1, LANES, layers).transpose(0, 2, 1)
    return series.reshape(len(series), -1), series[:, :, SERIES_TERMS + 1].max(axis=1)


def _simulate_block(job: _BatchJob, start: int, workspace: LaneWorkspace) -> _Block:
    """Return the shapes of one block of sets; base and guides of those from the lanes are not filled in."""
    sets = slice(start, min(start + LANES, len(job.batch)))
    shapes, alone = None, np.ones(sets.stop - start, dtype=bool)
    if job.lanes is not None:
        shapes, left_lanes = _simulate_lanes(job, job.lanes, sets, workspace)
        alone = left_lanes | ~job.valid[sets]
    if shapes is None or alone.all():  # the lanes may have been given up before their last stop
        return NeedleShapes.from_shapes([_simulate_alone(job, start + i) for i in range(len(alone))]), alone
    for i in np.flatnonzero(alone):
        one = NeedleShapes.from_shapes([_simulate_alone(job, start + int(i))])
        for part, value in zip(_list_fields(shapes), _list_fields(one), strict=True):
            part[i] = value[0]
    return shapes, alone


def _simulate_alone(job: _BatchJob, i: int) -> NeedleShape:
    """Return the shape of one set, from the scalar kernel."""
    batch = job.batch
    if job.valid[i]:
        return simulate_steps(*batch.pick(i), job.lattice)
    last = job.stops[-1]
    untouched = begin_insertion(batch.needle, batch.tissue, batch.steps, job.lattice, batch.rules)
    return read_shape(untouched, batch.tissue, last, batch.steps[last.controls_id].controls, NON_FINITE, 0)


def _simulate_lanes(
    job: _BatchJob, lanes: _LaneJob, sets: slice, workspace: LaneWorkspace
) -> tuple[NeedleShapes, Bools]:
    """Return the shapes of up to LANES sets, and which of them left the lanes."""
    batch, last = job.batch, job.stops[-1]
    at, count = slice(sets.start, sets.start + LANES), sets.stop - sets.start
    grids, number = [_copy_entry_tables(*pair) for pair in lanes.grids], 0
    first, _ = grids[0]
    lane_state = kernel.begin_lanes(len(first.y), lanes.nodes, len(first.rays))
    newton = NewtonOptions(batch.rules.tolerance, batch.rules.max_iterations)
    series, curvatures = (part[sets.start // LANES] for part in lanes.layers)
    for group in lanes.groups:
        if group.grids != number:  # the nodes of another main grid
            number, lane_state.size[kernel.ON_MAIN_GRID] = group.grids, 0
        before = np.repeat(group.conditions.before[:, :, None], LANES, axis=2)  # (F, 3, W)
        if batch.guide_x is not None:
            before[0, 0] = batch.guide_x[lanes.lane[at]]
        turns = group.turns[:, at].take(group.of_stop, axis=0)  # (S, W)
        base = np.ascontiguousarray(group.base[:, at])
        inputs = LaneInputs(lanes.rigidity[at], series, curvatures, base, before, turns, lanes.has_friction)
        kernel.advance_lanes(
            lane_state, *grids[number], group.conditions, inputs, group.stops, newton, workspace
        )
    size, front = int(lane_state.size[kernel.NODES_NOW]), 1 + len(group.conditions.before)
    current = lane_state.states[lane_state.size[kernel.CURRENT_STATE], :size]
    state = current.reshape(size, 2, LANES)[:, :, :count].T  # (B, 2, N)
    shape = np.empty((3, count, front + size))
    shape[0, :, front:], shape[1:, :, front:] = lane_state.nodes[:size], state.transpose(1, 0, 2)
    points = np.empty((count, last.cell + 1, 2))
    points[:, :, 0] = list_constraint_depths(last.tip, last.cell, job.lattice.first_cell, job.lattice.spacing)
    points[:, :, 1] = lane_state.y[: last.cell + 1, :count].T
    track = lane_state.track[: last.cell + 1].reshape(-1, 2, LANES)[:, :, :count]
    shapes = NeedleShapes(
        shape[0], shape[1], shape[2], points, np.ascontiguousarray(track.transpose(2, 0, 1)),
        np.zeros(count, np.int64), lane_state.passes[:count], job.scales[sets],
    )  # fmt: skip
    return shapes, lane_state.lane_status[:count] == LEFT_LANES


def _join_blocks(job: _BatchJob, blocks: Sequence[_Block]) -> NeedleShapes:
    """Return the shapes of a batch, and fill in base and guides of the sets that the lanes have solved."""
    parts, alone = zip(*blocks, strict=True)
    shapes = NeedleShapes(*(np.concatenate(some) for some in zip(*map(_list_fields, parts), strict=True)))
    sets = np.flatnonzero(~np.concatenate(alone))
    if len(sets):
        conditions = compile_controls(job.batch.steps[job.stops[-1].controls_id].controls)
        n = 1 + len(conditions.before)
        state = np.array([shapes.u[sets, n], shapes.slope[sets, n]])
        front = _solve_front(job, conditions, sets, float(shapes.x[sets[0], n]), state)  # (B, F, 3)
        for j, part in enumerate((shapes.x, shapes.u, shapes.slope)):
            part[sets, :n] = front[:, :, j]
    return shapes


def _make_scales(batch: Batch, valid: Bools, depth: float) -> Floats:
    """Return what the validity of every set is measured by, (B, 3) mm."""
    count = len(batch)
    mu = np.broadcast_to(batch.tissue.mu, (count, batch.tissue.layers)) if batch.mu is None else batch.mu
    rigidity = batch.needle.flexural_rigidity if batch.rigidity is None else batch.rigidity
    mu, rigidity = np.where(valid[:, None], mu, np.nan), np.where(valid, rigidity, np.nan)
    return compute_batch_scales(mu, rigidity, batch.tissue, depth, batch.rules.spacing)


def _copy_entry_tables(insertion: KernelInsertion, tables: LaneTables) -> _Grids:
    """Return grid and tables for one block: element 0 changes at every stop if the entry has no node."""
    main = insertion.main
    if main.first[1] == 0:
        return insertion, tables
    own = main._replace(shapes=main.shapes.copy())
    return insertion._replace(main=own), tables._replace(points=tables.points.copy())


def _solve_front(
    job: _BatchJob, conditions: BoundaryConditions, sets: Ints, node: float, state: Floats
) -> Floats:
    """Return depth, deflection and slope (B, F, 3) of base and guides before the tissue.

    The slope of a guide that is passed freely follows from the moments on its two sides being equal;
    `state` (2, B) is deflection and slope of the first node in the tissue, which stands at `node`.
    """
    batch, tip, valid = job.batch, job.stops[-1].tip, job.valid[sets]
    count, guides = len(sets), conditions.before
    front = np.empty((count, 1 + len(guides), 3))
    y = conditions.base[0] if batch.base_y is None else batch.base_y[sets]
    front[:, 0, 0], front[:, 0, 1] = tip - batch.needle.length, y + conditions.base[2] * tip
    front[:, 0, 2] = conditions.base[1] if batch.base_slope is None else batch.base_slope[sets]
    front[:, 1:] = guides
    if batch.guide_x is not None:
        front[:, 1, 0] = np.where(valid, batch.guide_x[sets], guides[0, 0])
    if not np.isnan(front[..., 2]).any():
        return front
    x, y = (np.column_stack((front[..., j], end)) for j, end in ((0, np.full(count, node)), (1, state[0])))
    span, rise = np.diff(x), np.diff(y)
    matrix = np.broadcast_to(np.eye(len(guides) + 2), (count, len(guides) + 2, len(guides) + 2)).copy()
    right = np.column_stack((front[..., 2], state[1]))
    for i, guide in enumerate(guides, start=1):
        if np.isnan(guide[2]):
            a, b = 1 / span[:, i - 1], 1 / span[:, i]
            # As in a cubic spline: curvature, and with it the moment, is continuous at a guide without a
            # slope of its own.
            matrix[:, i, i - 1], matrix[:, i, i], matrix[:, i, i + 1] = a, 2 * (a + b), b
            right[:, i] = 3 * (rise[:, i - 1] * a**2 + rise[:, i] * b**2)
    front[..., 2] = np.linalg.solve(matrix, right[..., None])[:, :-1, 0]
    return front


def _list_fields(shapes: NeedleShapes) -> list[NDArray[Any]]:
    return [getattr(shapes, field.name) for field in fields(shapes)]
