"""Pool the predictions of held-out tips over studies and synthetic truths.

    for n in 1 2 3 4 5; do needlefit calibrate study$n --truth synthetic --replicates 40; done
    python benchmarks/predictions.py reports/calibrate-study?-synthetic

`reports/reference/calibrate-study?-synthetic` holds such results.

For each study and for all together: the share of held-out tips inside their 50 % and 95 % intervals, the
interval score and the continuous ranked probability score (CRPS), mm. Tips of one synthetic truth share its
errors, so that the 95 % confidence interval of each figure is from a bootstrap over truths.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

RESAMPLES = 2000
FIGURES = ("in 50 %", "in 95 %", "width of 95 %", "interval score", "CRPS")


def read_truths(folder: Path) -> pd.DataFrame:
    """Return a row for each truth: its number of held-out tips, and the means of `FIGURES` over these."""
    tips = pd.read_csv(folder / "tips.csv").set_index("replicate")
    half, wide = tips[tips["level"] == 0.5], tips[tips["level"] == 0.95]
    width = wide["high_mm"] - wide["low_mm"]
    figures = half["covered"], wide["covered"], width, wide["interval_score_mm"], wide["crps_mm"]
    found = pd.concat(dict(zip(FIGURES, figures, strict=True)), axis=1)
    return found.assign(tips=wide["insertions"])


def resample(truths: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return the means of `FIGURES` over tips, and the ends of their 95 % confidence intervals."""
    counts = truths["tips"].to_numpy()
    sums = truths[list(FIGURES)].to_numpy() * counts[:, None]
    drawn = rng.integers(len(counts), size=(RESAMPLES, len(counts)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)[:, None]
    low, high = np.percentile(means, [2.5, 97.5], axis=0)
    return pd.DataFrame({"mean": sums.sum(axis=0) / counts.sum(), "low": low, "high": high}, index=FIGURES)


def main() -> None:
    """Print a row for each study, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "folders", nargs="+", type=Path, help="results of `needlefit calibrate --truth synthetic`"
    )
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    each = {folder.name: read_truths(folder) for folder in options.folders}
    rng = np.random.default_rng(options.seed)
    print(f"{'':28s} truths  tips  " + "  ".join(f"{name:>22s}" for name in FIGURES))
    for name, truths in {**each, "all": pd.concat(each.values())}.items():
        rows = resample(truths, rng).to_numpy().tolist()
        cells = "  ".join(f"{mean:7.3g} ({low:5.3g} to {high:5.3g})" for mean, low, high in rows)
        print(f"{name:28s} {len(truths):6d}  {truths['tips'].sum():4d}  {cells}")


if __name__ == "__main__":
    main()
