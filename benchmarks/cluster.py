"""What tasks cost in processes of this machine and on a Dask cluster, and how evenly two workers share them.

    python benchmarks/cluster.py [--tasks 200] [--seconds 16] [--rounds 3] [--json]

Overhead is the time of a task that does nothing, of many that were sent at once. Efficiency is the time of
one worker over twice that of two, for 16 equal tasks of calculation; idle cores are needed. Scheduler and
workers are processes of this machine.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from needlefit.project.cluster import connect_cluster
from needlefit.project.tasks import LocalPool, TaskPool

sys.path.insert(0, str(Path(__file__).parent.parent))
from tests.cluster_processes import start_scheduler, start_worker
from tests.cluster_work import calculate, square

EQUAL_TASKS = 16


def clock(pool: TaskPool, work: Callable[[float], float], items: list[float]) -> float:
    """Return the seconds that a pool takes, after a first task has started its workers."""
    list(pool.run(work, items[:2]))
    begin = time.perf_counter()
    assert len(list(pool.run(work, [item + 1e-9 for item in items]))) == len(items)
    return time.perf_counter() - begin


def measure(pool: TaskPool, tasks: int, seconds: float) -> tuple[float, float]:
    """Return the seconds of a task that does nothing, and of all equal tasks."""
    idle = clock(pool, square, [float(n) for n in range(tasks)]) / tasks
    return idle, clock(pool, calculate, [seconds / EQUAL_TASKS + 1e-6 * n for n in range(EQUAL_TASKS)])


def main() -> None:
    """Print a row for each pool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=16.0, help="of processor time, of all equal tasks")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for _ in range(options.rounds):
        for kind in ("processes", "cluster"):
            found = []
            for size in (1, 2):
                with TemporaryDirectory() as folder, ExitStack() as running:
                    pool: TaskPool = LocalPool(size)
                    if kind == "cluster":
                        address, _ = running.enter_context(start_scheduler(Path(folder)))
                        for _ in range(size):
                            running.enter_context(start_worker(address))
                        pool = running.enter_context(connect_cluster(address))
                        pool.client.wait_for_workers(size)
                    found.append(measure(pool, options.tasks, options.seconds))
            (one, alone), (two, both) = found
            ms = {"ms_per_task_1": round(1e3 * one, 2), "ms_per_task_2": round(1e3 * two, 2)}
            rows.append({"pool": kind, **ms, "efficiency": round(alone / (2 * both), 3)})
    if options.json:
        print(json.dumps(rows))
        return
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))


if __name__ == "__main__":
    main()
