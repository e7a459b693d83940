"""Predict held-out tips of synthetic truths whose specimens differ less or more than the dataset `twin`'s.

    python benchmarks/specimen_spread.py 0.5 study1 study2 study3 study4 study5 --replicates 5 --out half
    python benchmarks/specimen_spread.py 2 study1 study2 study3 study4 study5 --replicates 5 --out double
    python benchmarks/predictions.py half/*
    python benchmarks/predictions.py double/*

The factor multiplies the standard deviation of ln mu between specimens, and the differences of ln b of the
phantoms from their mean. What is fitted, and its priors, stay as they are. Results are those of
`needlefit calibrate STUDY --truth synthetic`, in folders below `--out`.
"""

import argparse
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.cli import main as run_command
from needlefit.synthetic import design

PHANTOMS = ("phantom1", "phantom2", "phantom3")


def scale_differences(factor: float) -> None:
    """Let the specimens of synthetic truths differ `factor` times as much."""
    design.LOG_MU_SD.update({name: factor * sd for name, sd in design.LOG_MU_SD.items()})
    mean = float(np.mean([np.log(design.TRUE_MEDIA[name].bevel) for name in PHANTOMS]))
    for name in PHANTOMS:
        medium = design.TRUE_MEDIA[name]
        bevel = float(np.exp(mean + factor * (np.log(medium.bevel) - mean)))
        design.TRUE_MEDIA[name] = replace(medium, bevel=bevel)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("factor", type=float)
    parser.add_argument("studies", nargs="+")
    parser.add_argument("--replicates", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    scale_differences(options.factor)
    for study in options.studies:
        words = ["calibrate", study, "--truth", "synthetic", "--replicates", str(options.replicates)]
        words += ["--seed", str(options.seed), "--jobs", "1", "--out", str(options.out)]
        with suppress(SystemExit):  # exit code 6: not calibrated
            run_command(words)


if __name__ == "__main__":
    main()
