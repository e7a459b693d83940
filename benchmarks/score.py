"""Whether the score of the likelihood, its derivative at the true parameters, has mean 0.

For the right likelihood it has, and its variance is the Fisher information (Bartlett's identities). So it
tests the likelihood alone, without a search and without draws, in a hundredth of the time of a replicate of
`needlefit calibrate STUDY`. True parameters and data are those of its replicates. Printed, over replicates,
are mean, standard error and SD of the score along the combination of parameters that the design determines
best, divided by the root of J^T J along it, and its shares within the central 50 and 95 % of a normal
distribution. A mean of +0.1 is an estimate that is too high by 0.1 standard deviations.

    python benchmarks/score.py study1 [--replicates 300]
"""

import argparse
import time

import numpy as np

from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.study import StudyRecord
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.calibration import prepare_experiment, simulate_experiment

CENTRAL = {50: 0.674, 95: 1.960}
"""Half widths of central intervals of the normal distribution, by percent."""


def compute_score(job: Job, number: int, direction: np.ndarray) -> float:
    """Return the score of one replicate along a direction (P,), in standard deviations."""
    rng = random_stream(job.recipe.seed, job.name, "calibrate", number, "data")
    simulated = simulate_experiment(job, rng)
    problem = simulated.problem
    # the likelihood's own residuals come first: behind them stand those of the prior and of its spread
    prior = problem.parameters.prior.slopes(problem.names)
    own = -len(prior) - len(problem.parameters.half_normal) or None
    residuals, slopes = (part[:own] for part in problem.jacobian(simulated.theta))
    along = slopes @ direction
    return float(-(residuals @ along) / np.sqrt(along @ along))


def main() -> None:
    """Print one row per study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("studies", nargs="+")
    parser.add_argument("--replicates", type=int, default=300)
    arguments = parser.parse_args()
    print("study | mean | standard error | SD | in 50 % | in 95 % | s each")
    for name in arguments.studies:
        job = prepare(name, load(find_file("study", name), StudyRecord), Settings())
        direction = np.array(list(prepare_experiment(job).stiff.values()))
        began = time.process_time()
        scores = np.array([compute_score(job, n, direction) for n in range(arguments.replicates)])
        spent = (time.process_time() - began) / len(scores)
        inside = [f"{np.mean(np.abs(scores) < half):.0%}" for half in CENTRAL.values()]
        cells = [
            f"{one:.2f}" for one in (scores.mean(), scores.std() / np.sqrt(len(scores)), scores.std(), spent)
        ]
        print(name, *cells[:3], *inside, cells[3], sep=" | ")


if __name__ == "__main__":
    main()
