"""Prepare an insertion for the kernel once; each evaluation then adds its parameter sets alone."""

from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.mechanics import native
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import Columns, pack_problem, pack_sets, plan_insertion
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.tissue import Tissue

MAX_TOLERANCE_MM = 1e-9
"""Newton tolerance of shapes that are differentiated, mm; at this, `simulate_steps` gives the same shape."""


class PreparedInsertion:
    """An insertion in the form that the kernel reads; plan, stops and guides are packed once.

    Parameters
    ----------
    lattice : Lattice, optional
        Where constraint points lie; by default so that the last step ends on one.
    columns : Columns, optional
        Of derivatives; the insertion is then solved to `MAX_TOLERANCE_MM` at least.

    Raises
    ------
    ModelError
        If there are no steps, or the needle is too short for one of them.
    """

    def __init__(
        self,
        needle: Needle,
        tissue: Tissue,
        steps: Sequence[Step],
        rules: ModelOptions,
        lattice: Lattice | None = None,
        columns: Columns | None = None,
    ) -> None:
        if columns is not None:
            rules = replace(rules, tolerance=min(rules.tolerance, MAX_TOLERANCE_MM))
        self.needle, self.tissue, self.steps, self.rules, self.columns = needle, tissue, steps, rules, columns
        self.lattice, self._packed = plan_insertion(steps, needle.length, rules, lattice)
        self.points = self._packed.last.cell + 1
        self.depth = self._packed.last.tip
        self.nodes_solved = float(
            self._packed.stops["tip"].sum()
        )  # about: it orders insertions by their cost
        self._problem: native.Problem | None = None

    def pack(self, sets: int, values: Mapping[str, Floats]) -> native.Problem:
        """Return the problem of so many parameter sets; `values` are named as in `batch.Batch`.

        Every call gives values of the same names.
        """
        needle, tissue, steps, rules = self.needle, self.tissue, self.steps, self.rules
        plan, columns = self._packed, self.columns
        if self._problem is None:
            self._problem = pack_problem(
                needle, tissue, steps, self.lattice, rules, plan, sets=sets, values=values, columns=columns
            )
            return self._problem
        _, arrays = pack_sets(needle, tissue, steps, rules, plan, sets=sets, values=values, columns=columns)
        return self._problem.with_sets(sets, arrays)


class Evaluation:
    """Parameter sets of a prepared insertion, and room for their shapes.

    Parameters
    ----------
    values : mapping of arrays
        Of the sets, by the names of `batch.Batch`.
    valid : (B,) array of bool
        Which sets are made of numbers that a tissue or needle may have; others are not computed.
    """

    def __init__(
        self, insertion: PreparedInsertion, sets: int, values: Mapping[str, Floats], valid: Bools
    ) -> None:
        self.insertion, self.valid, self.some = insertion, valid, int(np.argmax(valid))
        if not valid.all():  # what is no parameter is replaced by one; what it gives is discarded
            values = {name: _replace_rows(array, valid, self.some) for name, array in values.items()}
        self.values = values
        self.problem = insertion.pack(sets, values)
        self.shapes = native.make_shapes(self.problem, insertion.points)

    @property
    def sets(self) -> int:
        """B: the number of parameter sets."""
        return len(self.valid)


def run_evaluations(evaluations: Sequence[Evaluation], threads: int) -> None:
    """Let the kernel fill the shapes of all evaluations, the longest insertions first, on so many threads."""
    width = native.count_lanes()
    tasks = [(one, start) for one in evaluations for start in range(0, one.sets, width)]
    # Longest first: a long task that begins last would leave the other threads idle.
    tasks.sort(key=lambda task: -task[0].insertion.nodes_solved)  # stable: blocks of one batch stay in order
    waiting = deque(tasks)
    widths = [(one, 1 if one.sets == 1 else width) for one in evaluations]
    most = max((native.measure_memory(one.problem, lanes) for one, lanes in widths), default=0)

    def run() -> None:
        memory = native.make_memory(most)
        while True:
            try:
                one, start = waiting.popleft()
            except IndexError:
                return
            lanes = 1 if start + 1 == one.sets else width
            native.simulate(one.problem, one.shapes, start, lanes, memory)

    threads = min(threads, len(tasks))
    if threads <= 1:
        run()
        return
    with ThreadPoolExecutor(threads) as pool:  # the kernel runs without the interpreter
        for future in [pool.submit(run) for _ in range(threads)]:
            future.result()


def _replace_rows(array: Floats, valid: Bools, some: int) -> Floats:
    """Return the rows of valid sets, and in place of others that of one of them."""
    replaced = array.copy()
    replaced[~valid] = array[some]
    return replaced
