"""What one evaluation of the log posterior and its derivatives costs, by what is made of uncertain depths.

    python benchmarks/density.py [--json] [--insertions 9] [--rounds 10]

The deep insertions of the twin into phantom 2, of four layers, with depths that err by 0.1 mm beside the
stated errors of their boundaries. Milliseconds of one core: medians of the process's own time.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from needlefit.datasets.read import read
from needlefit.inference.problem import make_problem
from needlefit.project.locate import find_file
from needlefit.project.processes import one_thread
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, WeightsRecord

VALUES = {"mu1_pa": 3.5e5, "mu2_pa": 2.85e7, "mu3_pa": 3.5e5, "mu4_pa": 2.85e7, "bevel_mm": 0.109}
SETS, LANES = 64, 8


def milliseconds(work: Callable[[], object], rounds: int) -> float:
    """Return the median time of one call."""
    work()
    times = []
    for _ in range(rounds):
        begin = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - begin))
    return float(np.median(times))


@one_thread
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--insertions", type=int, default=9)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    dataset = read(find_file("dataset", "twin"))
    chosen = [i for i in dataset.insertions if i.medium == "phantom2"][: options.insertions]
    insertions = [replace(i, depth_sd=0.1) for i in chosen]
    medium = load(find_file("medium", "phantom2"), MediumRecord)
    rows = []
    for depths in ("fixed", "linear", "quadrature"):
        task = make_problem(dataset, insertions, medium, WeightsRecord(), LikelihoodRecord(depths=depths))
        theta = task.parameters.theta(VALUES)
        many = theta + 0.01 * np.random.default_rng(1).normal(size=(SETS, len(theta)))
        alone = milliseconds(lambda: task.log_posterior(theta), options.rounds)  # noqa: B023
        slope = milliseconds(lambda: task.gradient(theta), options.rounds)  # noqa: B023
        together = milliseconds(lambda: task.log_posteriors(many), options.rounds) / SETS  # noqa: B023
        jacobian = milliseconds(lambda: task.jacobian(theta), options.rounds)  # noqa: B023
        few = [task.values(one) for one in many[:LANES]]
        lanes = milliseconds(lambda: task.density.jacobians(few), options.rounds) / LANES  # noqa: B023
        row = {"depths": depths, "log_posterior": alone, "gradient": slope, f"one_of_{SETS}": together}
        rows.append(row | {"jacobian": jacobian, f"jacobian_of_{LANES}": lanes})
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        print("   ".join(f"{k} {v}" if isinstance(v, str) else f"{k} {v:.2f} ms" for k, v in row.items()))


if __name__ == "__main__":
    main()
