"""Compare held-out predictions with those of a plainer likelihood, on the same synthetic truths.

    python benchmarks/plain_likelihood.py study1 study2 study5 --replicates 10 --out FOLDER

The plainer likelihood has exact ties and one bevel offset for all insertions, and predicts from the training
insertions alone, as the paper does. Both run `needlefit calibrate STUDY --truth synthetic`, in FOLDER/default
and FOLDER/plain. A row: interval score and CRPS (mm) of both over all held-out tips, and their ratios,
default over plain; brackets hold the 95 % confidence interval of a bootstrap over truths.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from predictions import RESAMPLES, read_truths

from needlefit.project.locate import shipped_folder

SCORES = ("interval score", "CRPS")
FILES = ("configs/recipes/default.toml", "configs/media/*.toml", "studies/study?.toml")
CHANGES = (
    ("bevel_spread = 0.1\n", "bevel_spread = 0.0\n"),  # of the likelihood, in the recipe
    ("spread = 1.2", "spread = 1.0"),  # of ties, in a tissue model
    ('\nrecipe = "default"\n', '\nrecipe = "default"\nspecimens = "training only"\n'),  # in a study
)


def write_plain_files(folder: Path) -> None:
    """Write recipe, tissue models and studies of the plainer likelihood; a run in `folder` takes them."""
    for pattern in FILES:
        for path in shipped_folder().glob(pattern):
            text = path.read_text(encoding="utf-8")
            for before, after in CHANGES:
                text = text.replace(before, after)
            target = folder / path.relative_to(shipped_folder())
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")


def run_study(folder: Path, study: str, replicates: int, jobs: int) -> pd.DataFrame:
    """Run a study's synthetic truths in `folder`; return a row for each, as `read_truths`."""
    line = (
        f"-m needlefit calibrate {study} --truth synthetic --replicates {replicates} --jobs {jobs} --resume"
    )
    done = subprocess.run([sys.executable, *line.split()], cwd=folder, stdout=subprocess.DEVNULL, check=False)
    if done.returncode not in (0, 5, 6):  # 5: few truths, 6: not calibrated
        raise SystemExit(f"python {line}: exit code {done.returncode}")
    return read_truths(folder / "reports" / f"calibrate-{study}-synthetic")


def compare(default: pd.DataFrame, plain: pd.DataFrame, rng: np.random.Generator) -> dict[str, str]:
    """Return the scores of both, and their ratios with confidence intervals."""
    counts = default["tips"].to_numpy()
    found = {"truths": str(len(counts)), "tips": str(counts.sum())}
    for name in SCORES:
        ours, theirs = (truths[name].to_numpy() * counts for truths in (default, plain))
        drawn = rng.integers(len(ours), size=(RESAMPLES, len(ours)))
        low, high = np.percentile(ours[drawn].sum(axis=1) / theirs[drawn].sum(axis=1), [2.5, 97.5])
        means = f"{ours.sum() / counts.sum():.3g} {theirs.sum() / counts.sum():.3g}"
        found[name] = f"{means}  ratio {ours.sum() / theirs.sum():.2f} ({low:.2f} to {high:.2f})"
    return found


def main() -> None:
    """Run both likelihoods and print a row for each study."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("studies", nargs="+")
    parser.add_argument("--replicates", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    folders = options.out / "default", options.out / "plain"
    for folder in folders:
        shutil.rmtree(folder / "configs", ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
    write_plain_files(folders[1])
    for study in options.studies:
        both = [run_study(folder, study, options.replicates, options.jobs) for folder in folders]
        row = compare(*both, np.random.default_rng(1))
        print(study, *(f"{name} {text}" for name, text in row.items()), sep="  ", flush=True)


if __name__ == "__main__":
    main()
