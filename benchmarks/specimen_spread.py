"""Predict held-out tips of synthetic truths whose specimens differ less or more than those of `Population`.

    python benchmarks/specimen_spread.py 0.5 study1 study2 study3 study4 study5 --replicates 5 --out half
    python benchmarks/specimen_spread.py 2 study1 study2 study3 study4 study5 --replicates 5 --out double
    python benchmarks/predictions.py half/*
    python benchmarks/predictions.py double/*

The factor multiplies the scales of the half-normal priors of both standard deviations between specimens, of
ln mu and of ln b. What is fitted, and its priors, stay as they are. Results are those of `needlefit calibrate
STUDY --truth synthetic`, in folders below `--out`.
"""

import argparse
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from needlefit.cli import main as run_command
from needlefit.studies.kinds import calibration
from needlefit.synthetic.design import POPULATION, Population


def scale_spread(factor: float) -> Population:
    """Return the population whose specimens differ `factor` times as much."""
    return replace(
        POPULATION,
        modulus_factor=POPULATION.modulus_factor**factor,
        bevel_factor=POPULATION.bevel_factor**factor,
    )


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
    calibration.POPULATION = scale_spread(options.factor)
    for study in options.studies:
        words = ["calibrate", study, "--truth", "synthetic", "--replicates", str(options.replicates)]
        words += ["--seed", str(options.seed), "--jobs", "1", "--out", str(options.out)]
        with suppress(SystemExit):  # exit code 6: not calibrated
            run_command(words)


if __name__ == "__main__":
    main()
