"""Simulate many insertions with many parameter sets: vector instructions within one, threads between."""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Bools, Floats, Ints
from needlefit.mechanics.batch import VARYING_FIELDS, Batch, NeedleShapes
from needlefit.mechanics.insertion_limits import check_size
from needlefit.mechanics.kernel.foundation import make_foundation
from needlefit.mechanics.kernel.grid import list_constraint_depths
from needlefit.mechanics.kernel.insertion import BoundaryConditions, KernelInsertion, TipStops
from needlefit.mechanics.kernel.lanes import insertion as kernel
from needlefit.mechanics.kernel.lanes.newton import LEFT_LANES, LaneInputs
from needlefit.mechanics.kernel.lanes.tables import LANES, LaneTables, tabulate
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
from needlefit.mechanics.validity import compute_batch_scales


def simulate_batches(batches: Sequence[Batch], threads: int | None = None) -> tuple[NeedleShapes, ...]:
    """Simulate every parameter set of every batch on all cores, the longest insertions first.

    What a set gives does not depend on the sets beside it, on their order, or on the number of threads. A
    set whose tissue is compressed beyond the series of its law, and every set of an insertion with
    friction, a tracked tip or guides in the tissue, goes through the scalar kernel, alone.

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
    jobs = [_prepare_job(batch) for batch in batches]
    tasks = [(n, start) for n, job in enumerate(jobs) for start in range(0, len(job.batch), LANES)]
    # Longest first: a long task that begins last would leave the other threads idle.
    tasks.sort(key=lambda task: -jobs[task[0]].cost)  # stable: blocks of one batch stay in order
    threads = min(threads or len(os.sched_getaffinity(0)), len(tasks))

    def run(task: tuple[int, int]) -> NeedleShapes:
        return _simulate_block(jobs[task[0]], task[1])

    if threads <= 1:
        parts = [run(task) for task in tasks]
    else:
        with ThreadPoolExecutor(threads) as pool:  # the kernel lets go of the interpreter
            parts = list(pool.map(run, tasks))
    found: list[list[NeedleShapes]] = [[] for _ in jobs]
    for (n, _), part in zip(tasks, parts, strict=True):
        found[n].append(part)
    return tuple(_concatenate(some) for some in found)


@dataclass(frozen=True)
class _SharedTables:
    """What the sets of a batch share in the lanes."""

    grids: KernelInsertion
    tables: LaneTables


@dataclass(frozen=True)
class _BatchJob:
    batch: Batch
    lattice: Lattice
    groups: tuple[tuple[int, TipStops, Ints], ...]  # as `simulate.pack_groups` returns them
    stops: tuple[TipStop, ...]
    valid: Bools  # (B,) which sets are made of numbers that needle and tissue accept
    shared: _SharedTables | None  # None: every set goes alone

    @cached_property
    def cost(self) -> float:
        """Nodes to be solved for, about."""
        return sum(stop.tip for stop in self.stops)


def _prepare_job(batch: Batch) -> _BatchJob:
    valid = _find_valid(batch)
    needle, steps, rules = batch.needle, batch.steps, batch.rules
    if valid.any():  # depths and controls are alike in all valid sets: so one of them is used for all
        needle, steps = batch.vary_inputs(int(np.argmax(valid)))
    lattice = make_lattice(steps, rules)
    moves = make_moves(steps, needle.length)
    check_size(tuple(step.depth for step in steps), rules)
    stops = make_stops(moves, lattice)
    shared = None
    if _fits_lanes(batch, lattice, stops):
        grids = begin_insertion(needle, batch.tissue, steps, lattice, rules)
        shared = _SharedTables(grids, tabulate(grids.main))
    return _BatchJob(batch, lattice, pack_groups(moves, lattice), stops, valid, shared)


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
    short = least < 0.5 * element or any(0 < stop.tip < 0.5 * element for stop in stops)
    inputs = [step.controls for step in batch.steps]
    free = any(controls.before and controls.before[-1].slope is None for controls in inputs)
    return not (
        np.any(batch.tissue.friction > 0)
        or any(controls.tip is not None or controls.within for controls in inputs)
        or (short and (free or batch.guide_x is not None))
    )


def _make_layers(job: _BatchJob, lane: Ints) -> tuple[Floats, Floats]:
    """Return the series and limits of every lane's layers (n LAYER_ROWS W,), and curvatures (W,)."""
    tissue, shape = job.batch.tissue, (len(lane), job.batch.tissue.layers)
    mu = np.broadcast_to(tissue.mu if job.batch.mu is None else job.batch.mu[lane], shape)
    alpha = np.broadcast_to(tissue.alpha if job.batch.alpha is None else job.batch.alpha[lane], shape)
    valid = job.valid[lane, None]
    # Lanes of invalid sets compute with harmless numbers; `_simulate_block` replaces their results.
    mu, alpha = np.where(valid, mu, 1.0), np.where(valid, alpha, 1.0)
    law = compile_law(tissue.law, alpha.ravel())
    thickness, friction = (np.resize(part, mu.size) for part in (tissue.thickness, tissue.friction))
    found = make_foundation(mu.ravel(), *law, thickness, friction)
    series = np.concatenate((found.series, found.limit[:, None]), axis=1)
    # From (lane, layer, row) to (layer, row, lane): each row of LANES numbers must be contiguous.
    return series.reshape(*shape, -1).transpose(1, 2, 0).ravel(), found.curvature.reshape(shape).max(axis=1)


def _simulate_block(job: _BatchJob, start: int) -> NeedleShapes:
    """Return the shapes of one block of sets."""
    sets = np.arange(start, min(start + LANES, len(job.batch)))
    if job.shared is None:
        return NeedleShapes.from_shapes([_simulate_alone(job, int(i)) for i in sets])
    shapes, left_lanes = _simulate_lanes(job, job.shared, sets)
    if left_lanes.all():  # the lanes were given up before their last stop
        return NeedleShapes.from_shapes([_simulate_alone(job, int(i)) for i in sets])
    for i in np.flatnonzero(left_lanes | ~job.valid[sets]):
        alone = _simulate_alone(job, int(sets[i]))
        for part, value in zip(
            _list_fields(shapes), _list_fields(NeedleShapes.from_shapes([alone])), strict=True
        ):
            part[i] = value[0]
    return shapes


def _simulate_alone(job: _BatchJob, i: int) -> NeedleShape:
    """Return the shape of one set, from the scalar kernel."""
    batch = job.batch
    if job.valid[i]:
        return simulate_steps(*batch.pick(i), job.lattice)
    last = job.stops[-1]
    untouched = begin_insertion(batch.needle, batch.tissue, batch.steps, job.lattice, batch.rules)
    return read_shape(untouched, batch.tissue, last, batch.steps[last.controls_id].controls, NON_FINITE, 0)


def _simulate_lanes(job: _BatchJob, shared: _SharedTables, sets: Ints) -> tuple[NeedleShapes, Bools]:
    """Return the shapes of up to LANES sets, and which of them left the lanes."""
    batch, last = job.batch, job.stops[-1]
    lane = np.resize(sets, LANES)  # lanes to spare repeat what the others do
    nodes = len(shared.grids.main.nodes) + 2
    grids, tables = _copy_entry_tables(shared)
    lane_state = kernel.begin_lanes(len(shared.grids.y), nodes, len(shared.grids.rays))
    newton = NewtonOptions(batch.rules.tolerance, batch.rules.max_iterations)
    tissue = _make_layers(job, lane)
    for controls_id, stops, bevel_id in job.groups:
        conditions = compile_controls(batch.steps[controls_id].controls)
        inputs = _make_inputs(batch, tissue, conditions, bevel_id, lane)
        kernel.advance_lanes(lane_state, grids, tables, conditions, inputs, stops, newton)
    count, size = len(sets), int(lane_state.size[kernel.NODES_NOW])
    current = lane_state.states[lane_state.size[kernel.CURRENT_STATE], :size]
    state = current.reshape(size, 2, LANES)[:, :, :count]  # (N, 2, B)
    front = _solve_front(job, conditions, sets, float(lane_state.nodes[0]), state[0])  # (B, F, 3)
    points = np.empty((count, last.cell + 1, 2))
    points[:, :, 0] = list_constraint_depths(last.tip, last.cell, job.lattice.first_cell, job.lattice.spacing)
    points[:, :, 1] = lane_state.y[: last.cell + 1, :count].T
    track = lane_state.track[: last.cell + 1].reshape(-1, 2, LANES)[:, :, :count]
    inner = np.broadcast_to(lane_state.nodes[:size], (count, size))
    shapes = NeedleShapes(
        np.concatenate((front[:, :, 0], inner), axis=1),
        np.concatenate((front[:, :, 1], state[:, 0].T), axis=1),
        np.concatenate((front[:, :, 2], state[:, 1].T), axis=1),
        points, np.ascontiguousarray(track.transpose(2, 0, 1)),
        np.zeros(count, np.int64), lane_state.passes[:count].copy(), _make_scales(job, sets),
    )  # fmt: skip
    return shapes, lane_state.lane_status[:count] == LEFT_LANES


def _make_scales(job: _BatchJob, sets: Ints) -> Floats:
    """Return what the validity of some sets is measured by, (B, 3) mm."""
    batch, valid = job.batch, job.valid[sets]
    mu = batch.tissue.mu if batch.mu is None else batch.mu[sets]
    rigidity = batch.needle.flexural_rigidity if batch.rigidity is None else batch.rigidity[sets]
    mu, rigidity = np.where(valid[:, None], mu, np.nan), np.where(valid, rigidity, np.nan)
    return compute_batch_scales(mu, rigidity, batch.tissue, job.stops[-1].tip, batch.rules.spacing)


def _copy_entry_tables(shared: _SharedTables) -> tuple[KernelInsertion, LaneTables]:
    """Return grid and tables for one block: element 0 changes at every stop if the entry has no node."""
    main, tables = shared.grids.main, shared.tables
    if main.first[1] == 0:
        return shared.grids, tables
    own = main._replace(shapes=main.shapes.copy())
    return shared.grids._replace(main=own), tables._replace(points=tables.points.copy())


def _make_inputs(
    batch: Batch, tissue: tuple[Floats, Floats], conditions: BoundaryConditions, bevel_id: Ints, lane: Ints
) -> LaneInputs:
    """Return the inputs that differ between lanes in one step; `lane` (W,): the set of each lane."""

    def given(name: str, otherwise: float) -> Floats:
        values = getattr(batch, name)
        return np.full(len(lane), otherwise) if values is None else values[lane]

    ids, of_stop = np.unique(bevel_id, return_inverse=True)  # few bevels, many stops
    bevels = [batch.steps[step].bevel for step in ids]
    strengths = [(bevel.side, *batch.rules.bevel_strength(bevel)) for bevel in bevels]
    name = "cut_angle" if batch.rules.path_angle else "offset"
    turns = np.array([side / length * given(name, strength) for side, strength, length in strengths])
    before = np.repeat(conditions.before[:, :, None], len(lane), axis=2)  # (F, 3, W)
    if batch.guide_x is not None:
        before[0, 0] = batch.guide_x[lane]
    base = conditions.base
    return LaneInputs(
        given("rigidity", batch.needle.flexural_rigidity),
        *tissue,
        np.array([given("base_y", base[0]), given("base_slope", base[1]), np.full(len(lane), base[2])]),
        before,
        turns[of_stop],  # (S, W)
    )


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


def _concatenate(parts: Sequence[NeedleShapes]) -> NeedleShapes:
    return NeedleShapes(*(np.concatenate(some) for some in zip(*map(_list_fields, parts), strict=True)))
