"""Do three holes of the measured gel determine what the other three contradict? All 20 ways to split six.

    python benchmarks/split_holes.py

A parameter counts as determined if its standard deviation in a further hole is at most that of the rule
(docs/fitting.md). It is contradicted if the means over both halves differ by more than their posteriors allow
(p < 0.05, two-sided).
"""

from itertools import combinations

import numpy as np

from needlefit.inference.identifiability.directions import MAX_LOG_SD
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.study import FitRecord
from needlefit.studies.held_out_predictions import PREDICTION_DRAWS, Specimens
from needlefit.studies.job import Fold, Settings, prepare

job = prepare("stereo", load(find_file("fit", "stereo_tangent"), FitRecord), Settings())
(whole,) = job.folds
names = tuple(dict.fromkeys(one.specimen for one in whole.tune))
empty, known = np.empty((PREDICTION_DRAWS, len(job.parameters.free))), {}


def find(holes: tuple[str, ...]) -> Specimens:
    """Return what some holes determine; the posterior of each is computed once."""
    tuned = tuple(one for one in whole.tune if one.specimen in holes)
    return Specimens(job, Fold(" ".join(holes), tuned, ()), empty, posteriors=known)


shuffle = np.random.default_rng(1).permutation(PREDICTION_DRAWS)
counts = {name: np.zeros(4, dtype=int) for name in ("mu1_pa", "bevel_mm")}
for holes in combinations(names, 3):
    ours, others = (find(some).population for some in (holes, tuple(n for n in names if n not in holes)))
    for name, count in counts.items():
        k = job.parameters.free.index(name)
        above = np.mean(ours.mean[:, k] > others.mean[shuffle, k])
        contradicted = 2 * min(above, 1 - above) < 0.05
        by_mean, in_further = (np.std(one[:, k]) <= MAX_LOG_SD for one in (ours.mean, ours.new))
        count += [by_mean, by_mean and contradicted, in_further, in_further and contradicted]
for name, (mean, wrong_mean, further, wrong) in counts.items():
    print(
        f"{name}: SD of the mean at most {MAX_LOG_SD} in {mean} of 20, contradicted {wrong_mean}; "
        f"in a further hole in {further}, contradicted {wrong}"
    )
