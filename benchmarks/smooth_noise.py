"""Whether errors that are smooth along the needle explain measured shapes better than rough ones.

For each correlation of the noise the model is fitted to all shapes of `stereo_shapes`; printed are the
logarithm of the evidence, its Monte Carlo error, and the parameters at the optimum.

    NEEDLEFIT_REAL_DATA=... python benchmarks/smooth_noise.py [--fit stereo_tangent] [--starts 2]
"""

import argparse
from dataclasses import replace

from needlefit.inference.sampling.importance import LARGER_EFFORT, sample_about_fit
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.study import FitRecord
from needlefit.studies.held_out_predictions import find_fit
from needlefit.studies.job import Settings, prepare


def main() -> None:
    """Print a row per correlation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--fit", default="stereo_tangent")
    parser.add_argument("--starts", type=int, default=2)
    arguments = parser.parse_args()
    name = arguments.fit
    job = prepare(name, load(find_file("fit", name), FitRecord), Settings())
    job = replace(job, recipe=job.recipe.model_copy(update={"starts": arguments.starts}))
    print("correlation | log evidence | Monte Carlo error | Pareto k | at")
    for correlation in ("exponential", "matern32"):
        noise = replace(job.dataset.noise, correlation=correlation)
        problem = replace(job.problem(job.folds[0]), noise=noise)
        fit = find_fit(job, problem, (correlation,), Settings())
        rng = random_stream(job.recipe.seed, name, correlation)
        found = sample_about_fit(problem, fit, rng, efforts=(LARGER_EFFORT,))
        evidence = f"{found.log_evidence:.1f} | {found.log_evidence_se:.1f} | {found.k:.2f}"
        at = ", ".join(f"{key} {fit.values[key]:.3g}" for key in problem.names)
        print(correlation, evidence, at, sep=" | ", flush=True)


if __name__ == "__main__":
    main()
