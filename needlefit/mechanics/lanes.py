"""Simulate many insertions with many parameter sets: vector instructions within one, threads between."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.mechanics import native
from needlefit.mechanics.batch import VARYING_FIELDS, Batch, NeedleShapes
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.packing import pack_problem, plan_insertion
from needlefit.mechanics.simulate import list_depths
from needlefit.mechanics.validity import compute_batch_scales


def simulate_batches(batches: Sequence[Batch], threads: int | None = None) -> tuple[NeedleShapes, ...]:
    """Simulate every parameter set of every batch on all cores, the longest insertions first.

    What a set gives does not depend on the sets beside it, on their order, or on the number of threads.

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
    jobs = [_Job(batch) for batch in batches]
    tasks = [(job, start) for job in jobs for start in range(0, len(job.batch), job.lanes)]
    # Longest first: a long task that begins last would leave the other threads idle.
    tasks.sort(key=lambda task: -task[0].cost)  # stable: blocks of one batch stay in order
    threads = min(threads or len(os.sched_getaffinity(0)), len(tasks))
    most = max((job.memory for job in jobs), default=0)
    spare = SimpleQueue[Floats]()  # of tasks that have ended

    def run(task: tuple["_Job", int]) -> None:
        job, start = task
        try:
            memory = spare.get_nowait()
        except Empty:
            memory = native.make_memory(most)
        native.simulate(job.problem, job.shapes, start, job.lanes, memory)
        spare.put(memory)

    if threads <= 1:
        for task in tasks:
            run(task)
    else:
        with ThreadPoolExecutor(threads) as pool:  # the kernel runs without the interpreter
            for _ in pool.map(run, tasks):
                pass
    return tuple(job.read() for job in jobs)


class _Job:
    """A batch in the form that the kernel reads."""

    def __init__(self, batch: Batch) -> None:
        self.batch, self.valid = batch, _find_valid(batch)
        needle, steps, rules = batch.needle, batch.steps, batch.rules
        some = int(np.argmax(self.valid))
        if (
            self.valid.any()
        ):  # depths and controls are alike in all valid sets: so one of them is used for all
            needle, steps = batch.vary_inputs(some)
        lattice, packed = plan_insertion(steps, needle.length, rules)
        # What is no parameter is replaced by one; `read` discards the result.
        values = {name: getattr(batch, name) for name in VARYING_FIELDS if getattr(batch, name) is not None}
        if self.valid.any() and not self.valid.all():
            values = {name: _replace_rows(array, ~self.valid, some) for name, array in values.items()}
        elif not self.valid.any():
            values = {}
        self.problem = pack_problem(
            needle, batch.tissue, steps, lattice, rules, packed, sets=len(batch), values=values
        )
        self.shapes = native.make_shapes(self.problem, packed.last.cell + 1)
        self.depths = list_depths(packed.last, lattice)
        self.lanes = 1 if len(batch) == 1 else native.count_lanes()
        self.memory = native.measure_memory(self.problem, self.lanes)
        self.cost = float(packed.stops["tip"].sum())  # nodes to be solved for, about

    def read(self) -> NeedleShapes:
        """Return the shapes of all sets."""
        a, count = self.shapes.arrays, int(self.shapes.arrays["nodes"][0])
        points = np.empty((*a["constraints"].shape, 2))
        points[:, :, 0], points[:, :, 1] = self.depths, a["constraints"]
        scales = _make_scales(self.batch, self.valid, float(self.depths[-1]))
        x, u, slope = (np.ascontiguousarray(a[name][:, :count]) for name in ("x", "u", "slope"))
        if not self.valid.all():
            wrong = ~self.valid
            a["status"][wrong], a["passes"][wrong] = native.NON_FINITE, 0
            u[wrong] = slope[wrong] = a["track"][wrong] = points[wrong, 1:, 1] = np.nan
        return NeedleShapes(x, u, slope, points, a["track"], a["status"], a["passes"], scales)


def _replace_rows(array: Floats, wrong: Bools, some: int) -> Floats:
    replaced = array.copy()
    replaced[wrong] = array[some]
    return replaced


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
            if name == "shape":
                bounds = [one.bounds for one in LAWS[batch.tissue.law].parameters]
                low, high = np.array(bounds).reshape(-1, 2).T[:, :, None]  # (p, 1) each
                accepted &= (values >= low) & (values <= high)
            if name == "guide_x":  # before the tissue, and where the base does not come to it
                accepted &= (values < 0) & (values > deepest - batch.needle.length)
            good &= accepted.reshape(len(batch), -1).all(axis=1)
    return good


def _make_scales(batch: Batch, valid: Bools, depth: float) -> Floats:
    """Return what the validity of every set is measured by, (B, 3) mm."""
    count = len(batch)
    mu = np.broadcast_to(batch.tissue.mu, (count, batch.tissue.layers)) if batch.mu is None else batch.mu
    rigidity = batch.needle.flexural_rigidity if batch.rigidity is None else batch.rigidity
    mu, rigidity = np.where(valid[:, None], mu, np.nan), np.where(valid, rigidity, np.nan)
    return compute_batch_scales(mu, rigidity, batch.tissue, depth, batch.rules.spacing)
