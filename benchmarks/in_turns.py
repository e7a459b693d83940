"""Cases measured in turns, by this source tree and, with `--beside-python`, by another installation.

A benchmark names its cases; each is a function that returns one number. Every round asks both processes for
every case. Ratios are taken within rounds, as a machine that is busy with other work stretches both.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TREE = Path(__file__).resolve().parents[1]
HERE, BESIDE = "here", "beside"
LEAST_SECONDS = 0.05  # of a measurement

Program = tuple[str, dict[str, str]]
"""An interpreter and the environment in which it finds its needlefit."""


def make_parser(about: str, rounds: int) -> argparse.ArgumentParser:
    """Return a parser with the options of a benchmark whose cases are measured in turns."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--rounds", type=int, default=rounds)
    add_beside_python(parser)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    return parser


def add_beside_python(parser: argparse.ArgumentParser) -> None:
    """Add the option that names another interpreter."""
    parser.add_argument("--beside-python", metavar="PYTHON", help="an interpreter with another needlefit")


def list_programs(beside_python: str | None) -> dict[str, Program]:
    """Return this source tree's interpreter, and the other one where it is asked for."""
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    programs = {HERE: (sys.executable, elsewhere | {"PYTHONPATH": str(TREE)})}
    return programs | ({BESIDE: (beside_python, elsewhere)} if beside_python else {})


def time_call(call: Callable[[], object], clock: Callable[[], float] = time.thread_time) -> float:
    """Return the seconds of a call, repeated for a while after a first one that is not counted."""
    call()
    begin, count = clock(), 0
    while clock() - begin < LEAST_SECONDS:
        call()
        count += 1
    return (clock() - begin) / count


def measure(
    list_cases: Callable[[], Mapping[str, Callable[[], float]]], options: argparse.Namespace
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return the numbers of all rounds by case and program; where this process serves, do so and exit."""
    cases = list_cases()
    if options.serve:
        for line in sys.stdin:
            print(cases[line.strip()](), flush=True)
        sys.exit()
    programs = {
        name: subprocess.Popen([python, *sys.argv, "--serve"], env=environment, text=True,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for name, (python, environment) in list_programs(options.beside_python).items()
    }  # fmt: skip
    found: dict[str, dict[str, list[float]]] = {case: {name: [] for name in programs} for case in cases}
    for _ in range(options.rounds):
        for case in cases:
            for name, program in programs.items():
                print(case, file=program.stdin, flush=True)
                found[case][name].append(float(program.stdout.readline()))
    for program in programs.values():
        program.stdin.close()
    return {case: {name: np.array(of) for name, of in both.items()} for case, both in found.items()}


def print_table(found: Mapping[str, Mapping[str, NDArray[np.float64]]], unit: str) -> None:
    """Print the medians of all cases, and the ratio of this tree to the other installation."""
    print(f"{unit}, medians of the rounds; load average {os.getloadavg()[0]:.1f}")
    for case, by in found.items():
        line = f"{case:45s}{np.median(by[HERE]):10.3f}"
        if BESIDE in by:
            ratio = by[HERE] / by[BESIDE]
            low, high = np.quantile(ratio, [0.25, 0.75])
            line += f"   beside {np.median(by[BESIDE]):10.3f}, ratio {np.median(ratio):.2f} "
            line += f"(quartiles {low:.2f} to {high:.2f})"
        print(line)
