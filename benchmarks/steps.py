"""A step of a session beside the kernel alone, and both beside the package of another checkout.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/steps.py [--rounds N] [--beside FOLDER]

The insertion of `reference_problem`, tolerance 1e-7 mm. The kernel alone is one call of `advance_needle` for
all stops of the insertion. Each round runs all cases in turns, with --beside in two processes. Times are
processor time of the thread, medians of the rounds. Ratios are taken within rounds: a machine that is busy
with other work stretches both.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE

from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.linearize import linearize
from needlefit.mechanics.session import Session
from needlefit.mechanics.simulate import simulate

LEAST = 0.02  # s, of a measurement
FINE = ModelOptions(tolerance=1e-9)
KERNEL = "kernel alone"


def run_kernel() -> Callable[[], object]:
    """Return the insertion in one call of the kernel; a checkout without such a call has none."""
    from needlefit.mechanics import simulate as module
    from needlefit.mechanics.control import Controls
    from needlefit.mechanics.plan import make_lattice, make_moves

    steps, rules = (Step(DEPTH, BEVEL),), ModelOptions()
    lattice = make_lattice(steps, rules)
    size = module.measure_arrays(steps, lattice, rules)
    run = module.begin_run(NEEDLE, TISSUE, lattice, rules, size, rules.tolerance)
    ((_, stops, bevels),) = module.pack_groups(make_moves(steps, NEEDLE.length), lattice)
    stops = stops._replace(turn=np.full(len(bevels), module.compute_turn(BEVEL, rules)))
    module.kernel.set_inputs(run, module.compile_controls(Controls()), stops)
    return lambda: module.kernel.advance_needle(run, len(bevels))


def insert(step: float) -> Callable[[], object]:
    """Return a whole session in steps of so many mm; its beginning counts."""

    def call() -> None:
        session = Session(NEEDLE, TISSUE, BEVEL)
        for _ in range(round(DEPTH / step)):
            session.step(step)

    return call


def move_base() -> Callable[[], object]:
    """Return moves of the base at the whole depth; none comes twice."""
    session = Session(NEEDLE, TISSUE, BEVEL)
    session.step(DEPTH)
    rng = np.random.default_rng(2)

    def call() -> None:
        for y, slope in rng.normal(size=(50, 2)) * (1.0, 0.005):
            session.step(base=(y, slope))

    return call


def list_cases() -> dict[str, tuple[Callable[[], object], float]]:
    """Return the cases, and the steps of each."""
    return {
        "Session, steps of 1 mm": (insert(1.0), DEPTH),
        "Session, steps of 0.1 mm": (insert(0.1), 10 * DEPTH),
        "Session, steps of 5 mm": (insert(5.0), DEPTH / 5),
        "Session, base moved at 55 mm": (move_base(), 50),
        "simulate": (lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH), DEPTH),
        "simulate, one pass a step": (
            lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH, rules=ModelOptions(tolerance=np.inf)), DEPTH,
        ),
        "simulate, 1e-9 mm": (lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH, rules=FINE), DEPTH),
        "linearize, 1e-9 mm": (lambda: linearize(NEEDLE, TISSUE, BEVEL, DEPTH, rules=FINE), DEPTH),
    }  # fmt: skip


def serve() -> None:
    """Print the microseconds per step of each case that is read."""
    cases = list_cases()
    for line in sys.stdin:
        name = line.strip()
        if name == KERNEL:
            cases[name] = cases.get(name) or (run_kernel(), DEPTH)
        call, steps = cases[name]
        call()
        begin, count = time.thread_time(), 0
        while time.thread_time() - begin < LEAST:
            call()
            count += 1
        print((time.thread_time() - begin) / count / steps * 1e6, flush=True)


def measure(folders: dict[str, str], rounds: int) -> dict[tuple[str, str], np.ndarray]:
    """Return the times of all rounds, by folder and case."""
    programs = {
        name: subprocess.Popen([sys.executable, __file__, "--serve"], env=os.environ | {"PYTHONPATH": path},
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for name, path in folders.items()
    }  # fmt: skip
    found: dict[tuple[str, str], list[float]] = {}
    for _ in range(rounds):
        for case in (KERNEL, *list_cases()):
            for name, program in programs.items():
                if (name, case) != ("beside", KERNEL):
                    print(case, file=program.stdin, flush=True)
                    found.setdefault((name, case), []).append(float(program.stdout.readline()))
    for program in programs.values():
        program.stdin.close()
    return {key: np.array(values) for key, values in found.items()}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--beside", metavar="FOLDER")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve()
        return
    folders = {"here": str(Path(__file__).parents[1])} | (
        {"beside": arguments.beside} if arguments.beside else {}
    )
    found = measure(folders, arguments.rounds)
    print(f"load average {os.getloadavg()[0]:.1f}; us per step, and times the kernel alone")
    for (name, case), times in found.items():
        if name == "here":
            over = np.median(times / found["here", KERNEL])
            line = f"{case:30s}{np.median(times):8.2f}{over:8.2f}"
            if ("beside", case) in found:
                there = found["beside", case]
                line += (
                    f"   beside {np.median(there):8.2f}, ratio of the rounds {np.median(there / times):.2f}"
                )
            print(line)


if __name__ == "__main__":
    main()
