"""Compile the kernel ahead of its use, in separate processes, once for all processes that start together.

The compiled code does not depend on the process that compiles it. Separate processes return the memory (400
MB each) when they end, and other processes wait for them instead of compiling the same code. One runs on each
core: numba compiles on one thread at a time. A piece is compiled for the types of its arguments, without
a simulation, which would have to wait for the other pieces.
"""

import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.kernel import beam
from needlefit.mechanics.kernel.cache import compile_for, find_cache_folder, is_complete, mark_complete
from needlefit.mechanics.kernel.foundation import Foundation
from needlefit.mechanics.kernel.grid import list_constraint_depths
from needlefit.mechanics.kernel.insertion import (
    InsertionRunType,
    advance_needle,
    begin_insertion,
    begin_run,
    build_stop_grid,
    get_insertion,
    make_run_type,
    return_needle,
    set_inputs,
)
from needlefit.mechanics.kernel.insertion_derivatives import differentiate_stops
from needlefit.mechanics.kernel.lanes.insertion import advance_lanes, begin_lanes
from needlefit.mechanics.kernel.lanes.newton import LaneInputs, make_workspace
from needlefit.mechanics.kernel.lanes.tables import LaneTables, tabulate
from needlefit.mechanics.kernel.parameter_loads import DerivativeColumns, DerivativeHistory
from needlefit.mechanics.kernel.scalar import NewtonOptions
from needlefit.mechanics.law_form import differentiate_law
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import make_lattice, make_moves
from needlefit.mechanics.simulate import compile_controls, list_layers, pack_groups
from needlefit.mechanics.tissue import Tissue

try:
    import fcntl
except ImportError:  # Windows: processes that begin at the same time all compile
    fcntl = None  # type: ignore[assignment]

KERNEL_PARTS = ("kernel", "lanes", "sensitivity")

PIECES = {
    "kernel": ("needle", "start"),
    "lanes": ("block", "start"),
    "sensitivity": ("derivatives", "needle", "start"),
}
"""What processes compile side by side for each part."""

MAX_WAIT_S, POLL_INTERVAL_S = 300.0, 0.1
"""Longest wait for another process that compiles, and the time between two checks."""

_NEEDLE = Needle.from_tube(50.0, 1.27, 80e3)
_TISSUE = Tissue(mu=np.array([0.2]), alpha=np.array([1.0]))
_BEVEL, _DEPTH = Bevel(0.1), 4.0


def precompile(*parts: str) -> None:
    """Compile those parts of the kernel that are not on disk yet.

    Where no other process can be started they are compiled in this one, when they are called.
    """
    if all(map(is_complete, parts)):
        return
    with _hold_lock(find_cache_folder().path / "lock"):
        missing = [part for part in parts if not is_complete(part)]  # another process may have compiled
        wanted = {piece for part in missing for piece in PIECES[part] if not is_complete(piece)}
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(_compile_apart, sorted(wanted, key=tuple(_COMPILERS).index)))
        for part in missing:
            if all(map(is_complete, PIECES[part])):
                mark_complete(part)


def _compile_apart(piece: str) -> None:
    """Compile a piece in a process of its own, if one can be started."""
    program = f"from needlefit.mechanics.precompile import compile_piece; compile_piece({piece!r})"
    silent = subprocess.DEVNULL
    with (
        suppress(OSError),
        subprocess.Popen([sys.executable, "-c", program], stdin=silent, stdout=silent, stderr=silent),
    ):
        pass  # the end of the block waits for it


@contextmanager
def _hold_lock(lock: Path) -> Iterator[None]:
    """Hold a lock, which ends with this process; after `MAX_WAIT_S`, or without locks, go on."""
    with ExitStack() as stack:
        if fcntl is not None:
            with suppress(OSError):
                _wait_for_lock(stack.enter_context(lock.open("w")).fileno())
        yield


def _wait_for_lock(file: int) -> None:
    until = time.monotonic() + MAX_WAIT_S
    while time.monotonic() < until:
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(POLL_INTERVAL_S)


def compile_piece(piece: str) -> None:
    """Compile a piece of the kernel, in a process that then ends."""
    gc.disable()  # a tenth of the time, for memory that the process returns when it ends
    _COMPILERS[piece]()
    mark_complete(piece)


def _compile_start() -> None:
    """Compile what every insertion begins and ends with."""
    compile_for(begin_run, *_BEGINNING, *list_layers(_TISSUE), _NEWTON)  # and the functions that it calls
    _, conditions, stops = _make_arguments()
    run = _make_run_type()
    compile_for(set_inputs, run, conditions, stops)
    compile_for(get_insertion, run)
    compile_for(return_needle, run, 1)
    compile_for(list_constraint_depths, _DEPTH, 4, 1.0, 1.0)
    compile_for(beam.compute_positions, *[_ROW] * 4)


def _compile_needle() -> None:
    compile_for(advance_needle, _make_run_type(), 1)


def _compile_derivatives() -> None:
    columns = DerivativeColumns(*[1] * len(DerivativeColumns._fields))
    history = DerivativeHistory(_TABLE, _CUBE, _TABLE, _ROW, _CUBE, _ROW)
    law, guides = differentiate_law("ogden", _TISSUE.alpha), np.zeros((0, 3), np.int64)
    compile_for(differentiate_stops, _make_run_type(), law, guides, _ROW, columns, history, True)
    compile_for(beam.compute_position_derivatives, *[_ROW] * 4, *[_TABLE] * 3)


def _compile_block() -> None:
    insertion, conditions, stops = _make_arguments()
    tables = LaneTables(_TABLE, _TABLE, _TABLE, *[np.zeros(1, np.int64)] * 2)
    inputs = LaneInputs(_ROW, _ROW, _ROW, _TABLE, _CUBE, _TABLE, False)
    lanes, workspace = begin_lanes(1, 1, 1), make_workspace(1, 1)
    compile_for(advance_lanes, lanes, insertion, tables, conditions, inputs, stops, _NEWTON, workspace)
    compile_for(tabulate, insertion.main)
    compile_for(build_stop_grid, insertion, conditions, _DEPTH, 4)
    compile_for(beam.compute_batch_positions, *[_TABLE] * 3, _ROW)


_COMPILERS: dict[str, Callable[[], None]] = {  # what takes longest comes first
    "block": _compile_block,
    "derivatives": _compile_derivatives,
    "needle": _compile_needle,
    "start": _compile_start,
}

_ROW, _TABLE, _CUBE = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1))
_FOUNDATION = Foundation(_ROW, _TABLE, _TABLE, _ROW, _ROW, _TABLE, _ROW, False, _ROW)
_NEWTON = NewtonOptions(1e-7, 40)
_BEGINNING = 1.0, 50.0, 1.0, 1.0, 1.0, 0.5, 1.0, np.empty(0), _DEPTH, 0, 6, 0


def _make_run_type() -> InsertionRunType:
    insertion, conditions, stops = _make_arguments()
    return make_run_type(insertion, _FOUNDATION, conditions, stops, _NEWTON)


def _make_arguments() -> tuple[Any, ...]:
    """Return an insertion, conditions and stops of the types that the kernel has to do with."""
    steps, options = (Step(_DEPTH, _BEVEL),), ModelOptions()
    ((_, stops, bevels),) = pack_groups(make_moves(steps, _NEEDLE.length), make_lattice(steps, options))
    # Not compiled: another piece has that.
    insertion = begin_insertion.py_func(*_BEGINNING)
    return insertion, compile_controls(Controls()), stops._replace(turn=np.zeros(len(bevels)))
