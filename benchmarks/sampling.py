"""How long a posterior takes by the rule of convergence, by which moves, and where the time goes.

    OPENBLAS_NUM_THREADS=1 python benchmarks/sampling.py [--json] [--targets study1 study2] [--moves stretch]
        [--seeds 1 2] [--depths fixed] [--jobs 2] [--pool]

Each target, a study or a fit, is fitted first, which is not counted. Seconds are those of `sample`, and its
shares those of the processor time of all threads: of the kernel, of the likelihood around it, of the rule
(R-hat, autocorrelation), and of emcee with the moves and all else. `--depths fixed` takes depths of layers as
given, which costs a ninth for four layers: for comparing moves.

`--pool` says besides what the same evaluations of the likelihood would cost in a pool of two processes, with
the needle simulated by NumPy and `solveh_banded` (`full_needle`): extrapolated from one evaluation in each
process, to whole millimetres of depth, and without what follows the simulation.
"""

import argparse
import json
import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from full_needle import FullNeedle

from needlefit.errors import ConfigError
from needlefit.inference.fit import Callbacks
from needlefit.inference.forward_model import make_batch
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling import sample as sampler
from needlefit.mechanics import native
from needlefit.mechanics.batch import Batch
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.recipe import SampleRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.job import Job, Settings, prepare

DEFAULT = SampleRecord().moves
POOL = 2  # processes


@dataclass
class Clock:
    """Processor seconds spent in what it is wrapped around, and how often that was called."""

    seconds: dict[str, float] = field(default_factory=dict)
    sets: int = 0

    @contextmanager
    def around(self, place: object, function: str, name: str, now: Callable[[], float]) -> Iterator[None]:
        """Time one function of a module."""
        original = getattr(place, function)

        def timed(*arguments, **named):
            begin = now()
            try:
                return original(*arguments, **named)
            finally:
                self.seconds[name] = self.seconds.get(name, 0.0) + now() - begin

        setattr(place, function, timed)
        try:
            yield
        finally:
            setattr(place, function, original)


@dataclass(frozen=True)
class Timed:
    """A problem whose densities are timed and counted."""

    problem: Problem
    clock: Clock

    def log_posteriors(self, thetas, jobs):
        begin = time.process_time()
        found = self.problem.log_posteriors(thetas, jobs)
        self.clock.seconds["density"] = self.clock.seconds.get("density", 0.0) + time.process_time() - begin
        self.clock.sets += len(thetas)
        return found

    def __getattr__(self, name: str):
        return getattr(self.problem, name)


def measure(
    job: Job, problem: Problem, ends, settings: SampleRecord, seed: int, jobs: int
) -> dict[str, object]:
    """Return one row: a target sampled by these moves."""
    clock = Clock()
    rng = random_stream(seed, job.name, "posterior")
    begin, begin_processor = time.perf_counter(), time.process_time()
    with (
        clock.around(native, "simulate", "kernel", time.thread_time),
        clock.around(sampler, "convergence", "rule", time.process_time),
        clock.around(sampler, "autocorrelation_times", "rule", time.process_time),
    ):
        got = sampler.sample(Timed(problem, clock), ends, settings, rng, Callbacks(jobs=jobs))
    seconds, processor = time.perf_counter() - begin, time.process_time() - begin_processor
    shares = dict(clock.seconds)
    shares["likelihood"] = shares.pop("density") - shares["kernel"]
    shares["emcee_and_else"] = processor - sum(shares.values())
    return {
        "target": job.name,
        "insertions": len(problem.insertions),
        "moves": settings.moves,
        "seed": seed,
        "steps": got.burn_in + got.steps,
        "burn_in": got.burn_in,
        "longest_tau": round(float(got.convergence.tau.max()), 1),
        "acceptance": round(float(np.mean(got.acceptance)), 2),
        "fewest_draws": round(float(min(got.convergence.ess_bulk.min(), got.convergence.ess_tail.min()))),
        "converged": got.converged,
        "seconds": round(seconds, 1),
        "processor_seconds": round(processor, 1),
        **{name: f"{100 * part / processor:.1f} %" for name, part in sorted(shares.items())},
        "evaluations": clock.sets,
    }


def measure_pool(problem: Problem, theta, evaluations: int) -> dict[str, object]:
    """Return what these evaluations would take in processes that simulate with `solveh_banded`, hours."""
    values = [problem.values(theta)]
    medium, needle = problem.medium, problem.dataset.needle
    batches = [
        make_batch(values, medium, needle, replace(insertion, depth=float(round(insertion.depth))))
        for known in problem.density.observations
        for insertion in known.nodes.insertions
    ]
    with ProcessPoolExecutor(POOL, mp_context=multiprocessing.get_context("spawn")) as workers:
        spent = list(workers.map(_simulate, [batches] * POOL))
    each = float(np.mean(spent))
    return {
        "evaluation_s": round(each, 2),
        "processes": POOL,
        "hours": round(each * evaluations / POOL / 3600, 1),
    }


def _simulate(batches: list[Batch]) -> float:
    """Return the processor time of one evaluation; runs in another process."""
    begin = time.process_time()
    for batch in batches:
        needle, tissue, (step,), rules = batch.pick(0)
        full = FullNeedle(needle, tissue, step, rules.tolerance)
        full.insertion(lambda *a, full=full: full.banded(*a))
    return time.process_time() - begin


def _job(target: str) -> Job:
    try:
        record = load(find_file("study", target), StudyRecord).tuning()
    except ConfigError:
        record = load(find_file("fit", target), FitRecord)
    return prepare(target, record, Settings())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--targets", nargs="+", default=["study1", "study2"])
    parser.add_argument("--moves", nargs="+", default=[DEFAULT, "0.8*de + 0.2*stretch"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--depths", choices=["fixed", "linear", "quadrature"], default="linear")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--pool", action="store_true")
    options = parser.parse_args()

    def show(row: dict[str, object]) -> None:
        print(json.dumps(row) if options.json else "  ".join(f"{k} {v}" for k, v in row.items()), flush=True)

    for target in options.targets:
        job = _job(target)
        (fold,) = job.folds
        problem = job.problem(fold)
        problem = replace(
            problem, likelihood=problem.likelihood.model_copy(update={"depths": options.depths})
        )
        fit = minimize(problem, job.recipe, random_stream(1, target, "starts"), Callbacks(jobs=options.jobs))
        for moves in options.moves:
            for seed in options.seeds:
                settings = job.recipe.sample.model_copy(update={"moves": moves})
                row = measure(job, problem, fit.theta, settings, seed, options.jobs)
                show(row)
        if options.pool:
            show(
                {"target": target, "method": "solveh_banded"}
                | measure_pool(problem, fit.theta, row["evaluations"])
            )


if __name__ == "__main__":
    main()
