"""How long a posterior takes by the rule of convergence, by which moves, and where the time goes.

    python benchmarks/sampling.py [--json] [--targets study1 study2] [--moves stretch ...] [--jobs 2]

Each target is fitted first, which is not counted. Seconds are those of `sample`: in the density (likelihood
and kernel), in the rule (R-hat, autocorrelation), and in the moves and all else.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from needlefit.inference import sample as sampler
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.starts import Watch
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.recipe import SampleRecord
from needlefit.project.records.study import StudyRecord
from needlefit.project.streams import stream
from needlefit.validation.job import Job, Settings, prepare

DEFAULT = SampleRecord().moves


@dataclass
class Clock:
    """Seconds spent in what it is wrapped around."""

    seconds: dict[str, float] = field(default_factory=dict)

    def around(self, name: str, function: Callable) -> Callable:
        """Return the function, timed under this name."""

        def timed(*arguments, **named):
            begin = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

        return timed


@dataclass(frozen=True)
class Timed:
    """A problem whose densities are timed."""

    problem: Problem
    log_posteriors: Callable

    def __getattr__(self, name: str):
        return getattr(self.problem, name)


def measure(job: Job, fit: tuple[float, ...], moves: str, jobs: int) -> dict[str, object]:
    """Return one row: a target sampled by these moves."""
    clock, settings = Clock(), job.recipe.sample.model_copy(update={"moves": moves})
    (fold,) = job.folds
    problem = job.problem(fold)
    timed = Timed(problem, clock.around("density", problem.log_posteriors))
    rng = stream(job.recipe.seed, job.name, fold.name, "posterior")
    asked, sampler.convergence = sampler.convergence, clock.around("rule", sampler.convergence)
    begin = time.perf_counter()
    got = sampler.sample(timed, fit, settings, rng, Watch(jobs=jobs))
    total = time.perf_counter() - begin
    sampler.convergence = asked
    return {
        "target": job.name,
        "insertions": len(fold.tune),
        "moves": moves,
        "seconds": round(total, 1),
        **{name: round(seconds, 1) for name, seconds in sorted(clock.seconds.items())},
        "moves_and_else": round(total - sum(clock.seconds.values()), 1),
        "steps": got.burn_in + got.steps,
        "longest_tau": round(float(got.convergence.tau.max()), 1),
        "acceptance": round(float(np.mean(got.acceptance)), 2),
        "converged": got.converged,
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--targets", nargs="+", default=["study1", "study2"])
    parser.add_argument("--moves", nargs="+", default=[DEFAULT, "de+snooker", "stretch"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    for target in options.targets:
        record = load(find("study", target), StudyRecord).tuning()
        job = prepare(f"{target}-tune", record, Settings())
        (fold,) = job.folds
        search = stream(job.recipe.seed, job.name, fold.name, "fitted", "starts")
        fit = minimize(job.problem(fold), job.recipe, search, Watch(jobs=options.jobs))
        for moves in options.moves:
            row = measure(job, fit.theta, moves, options.jobs)
            print(
                json.dumps(row) if options.json else "  ".join(f"{k} {v}" for k, v in row.items()), flush=True
            )


if __name__ == "__main__":
    main()
