"""From a new process to the first result: what is imported, compiled or fetched from the cache.

    python benchmarks/startup.py [--json] [--rounds N]

`cold` gives numba an empty folder, as after a fresh install; `warm` then runs in the same folder (median of
the rounds, in turns). Each way is a process of its own: `scalar` wants one insertion from `simulate`,
`everything` also derivatives, a session and the lanes. Seconds on the wall of each phase; processor time
of the whole process stands beside them, as other programs stretch the wall.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

BEGIN = """
import json, sys, time
times = {}
def note(name, since=[time.perf_counter()]):
    now = time.perf_counter()
    times[name], since[0] = now - since[0], now
import numpy as np
note("import numpy")
from needlefit.mechanics.kernel import insertion
note("import kernel")
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
needle, bevel = Needle.from_tube(150.0, 1.27, 80e3), Bevel(0.085)
mu, alpha = np.array([0.2, 33.0, 0.2, 33.0]), np.array([1.0, -1.0, 1.0, -1.0])
tissue = Tissue(mu, alpha, np.array([20.0, 28.0, 45.0]))
note("import the rest")
simulate(needle, tissue, bevel, 55.0)
note("first simulate")
"""
MORE = """
from needlefit.mechanics.linearize import linearize
linearize(needle, tissue, bevel, 55.0)
note("first linearize")
from needlefit.mechanics.session import Session
session = Session(needle, tissue, bevel)
session.step(10.0), session.step(0.5), session.step(-3.0)
note("first Session")
from needlefit.mechanics.batch import Batch
from needlefit.mechanics.lanes import simulate_batches
simulate_batches([Batch(needle, tissue, (Step(55.0, bevel),), offset=np.linspace(0.05, 0.1, 64))])
note("first lanes")
"""
END = """
times["processor"] = time.process_time()
json.dump(times, sys.stdout)
"""
WAYS = {"scalar": BEGIN + END, "everything": BEGIN + MORE + END}
GOALS = {("scalar", "warm"): 1.0, ("scalar", "cold"): 15.0, ("everything", "cold"): 60.0}  # s


def run(code: str, cache: str) -> dict[str, float]:
    """Run code in a new process; return its phases and how long all of it took, s."""
    begin = time.perf_counter()
    environment = {**os.environ, "NEEDLEFIT_CACHE_DIR": cache}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # else each process compiles every file of Python again
    found = subprocess.run(
        [sys.executable, "-c", code], env=environment, check=True, stdout=subprocess.PIPE
    )  # fmt: skip
    times = json.loads(found.stdout)
    return {**times, "process": time.perf_counter() - begin}


def measure(rounds: int) -> dict[str, dict[str, float]]:
    """Return the phases of each way, cold and warm."""
    figures: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for way, code in WAYS.items():
            figures[f"{way}, cold"] = run(code, f"{folder}/{way}")
        warm: dict[str, list[dict[str, float]]] = {way: [] for way in WAYS}
        for _ in range(rounds):
            for way, code in WAYS.items():
                warm[way].append(run(code, f"{folder}/{way}"))
    for way, found in warm.items():
        figures[f"{way}, warm"] = {key: statistics.median(one[key] for one in found) for key in found[0]}
    return figures


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    figures = measure(arguments.rounds)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    print(f"seconds; load average {os.getloadavg()[0]:.1f}")
    for name, phases in figures.items():
        way, state = name.split(", ")
        goal = GOALS.get((way, state))
        print(f"{name}: {phases['process']:.2f} s" + (f" (aim <= {goal:g} s)" if goal else ""))
        print("   " + ", ".join(f"{key} {value:.2f}" for key, value in phases.items() if key != "process"))


if __name__ == "__main__":
    main()
