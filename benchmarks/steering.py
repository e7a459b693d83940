"""Processor time of a loop with feedback: measure, plan again, Jacobian; and of a plan from scratch.

    python benchmarks/steering.py [--rounds 9]

A needle of phantom 2 stands 20 mm deep, the target lies at 38 mm. Figures are medians of the rounds, ms,
on one thread.
"""

import argparse
import time
from collections import defaultdict
from dataclasses import replace

import numpy as np

import needlefit
from needlefit.planning.goals import Goal
from needlefit.planning.steering import PlanLimits, StartedInsertion, plan_steering

TARGET = (38.0, 1.0)
PRIORS = (("mu1_pa", 2e5, 1.5), ("mu2_pa", 3.3e7, 1.5), ("bevel_mm", 0.085, 1.3))


def time_call(function, *given, **named):
    """Return the processor time of a call, ms."""
    begin = time.process_time()
    function(*given, **named)
    return 1e3 * (time.process_time() - begin)


def measure(draws, rounds):
    """Print the times with so many draws."""
    medium, found = needlefit.load_medium("phantom2"), defaultdict(list)
    for name, median, factor in PRIORS:
        medium["parameters"][name]["prior"] = {"median": median, "factor": factor}
    for number in range(rounds):
        steering = needlefit.Steering(medium, "phantom2", draws=draws, seed=number)
        steering.advance(replace(steering.now, depth=20.0))
        tip = 20.0, steering.predict().mean[0]
        known = steering.draws[0]
        goal, started = Goal(TARGET, 1.0), (steering.needle, steering.tissue, steering.rules)
        insertion = StartedInsertion(*started, (steering.now,), known)
        found["measure"].append(time_call(steering.measure, tip, sd=0.3))
        found["plan"].append(time_call(steering.plan, TARGET))
        found["jacobian"].append(time_call(steering.jacobian, 38.0))
        limits = PlanLimits(turns=1)
        found["plan from scratch"].append(time_call(plan_steering, insertion, goal, limits, threads=1))
    times = ", ".join(f"{name} {np.median(some):.0f}" for name, some in found.items())
    print(f"{draws:4} draws, ms: {times}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    for draws in (200, 500):
        measure(draws, rounds)


if __name__ == "__main__":
    main()
