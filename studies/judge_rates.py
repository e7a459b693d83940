"""How often is the verdict of several fits wrong, and how often does it find a true difference?

    python studies/judge_rates.py [--quick] [--out FIGURE]

Tip errors and CRPS of our fits are simulated, and tip errors of five curves, which predict points: CRPS is
the same. All are normal, with a correlation within a fit (insertions of one fit err alike; curves have the
same correlation and nothing in common with ours); that of our two scores is 0.9. For each number of fits, of
insertions that each predicts and of the correlation, five cases are judged (`CASES`). --quick: 20 simulations
of each in place of 300. What came out: docs/studies.md.
"""

import argparse
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from needlefit import api

FITS, INSERTIONS, CORRELATIONS = (1, 3, 6, 12), (1, 3, 8, 14), (0.0, 0.3, 0.6)
OURS = "prediction"
CURVES = ("straight", "constant_curvature", "linear_curvature", "quadratic_curvature", "mean_shape")
CRPS, BETWEEN_SCORES = "tip_crps_mm", 0.9  #: the second score, and its correlation with the first
#: by how much errors of the first curve exceed our tip errors and our CRPS, and those of the others our tip
#: errors, in standard deviations of a fit's difference
CASES = {
    "equal": (0.0, 0.0, 0.0),
    "one curve equal": (0.0, 0.0, 3.0),
    "CRPS equal": (3.0, 0.0, 6.0),
    "ours smaller": (1.0, 1.0, 3.0),
    "ours larger": (-1.0, -1.0, 0.0),
}


def simulate(
    rng: np.random.Generator, fits: int, insertions: int, correlation: float, shifts: tuple[float, ...]
) -> np.ndarray:
    """Return scores (methods + 1, fits, insertions), mm, of SD 0.1: our tip errors, our CRPS, the curves'."""
    size = (2 + len(CURVES), fits, insertions)
    shared, own = rng.standard_normal((*size[:2], 1)), rng.standard_normal(size)
    scores = np.sqrt(correlation) * shared + np.sqrt(1 - correlation) * own
    scores[1] = BETWEEN_SCORES * scores[0] + np.sqrt(1 - BETWEEN_SCORES**2) * scores[1]
    of_fit = np.sqrt(2 * (correlation + (1 - correlation) / insertions))
    tip, crps, others = shifts
    scores[1] += of_fit * (tip - crps)
    scores[2:] += of_fit * np.array([tip, *[others] * (len(CURVES) - 1)])[:, None, None]
    return 0.5 + 0.1 * scores


def tabulate(scores: np.ndarray) -> pd.DataFrame:
    """Return the scores as the table of a run."""
    numbers = [range(count) for count in scores.shape[1:]]
    index = pd.MultiIndex.from_product([[OURS, *CURVES], *numbers], names=["method", "fold", "n"])
    rows = pd.Series(np.delete(scores, 1, axis=0).ravel(), index, name="te_mm").reset_index()
    rows[CRPS] = pd.Series(scores[1].ravel())  # of our rows, the first
    rows["insertion"] = rows["fold"].astype(str) + "-" + rows["n"].astype(str)
    return rows.assign(specimen=rows["insertion"], hole=rows["insertion"])


def judge_by_insertions(scores: np.ndarray) -> str:
    """Return the verdict of a simpler rule: two standard errors of tip errors over single insertions."""
    gaps = (scores[2:] - scores[0]).reshape(len(CURVES), -1)
    if gaps.shape[1] < 2:
        return "not shown"
    z = gaps.mean(axis=1) / (gaps.std(axis=1, ddof=1) / np.sqrt(gaps.shape[1]))
    return "does not generalise" if z.min() < -2 else "generalises" if z.min() > 2 else "not shown"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="20 simulations of each case")
    parser.add_argument("--out", type=Path, default=Path("reports/judge_rates.png"))
    options = parser.parse_args()
    count = 20 if options.quick else 300
    rows = []
    for fits, insertions, correlation in product(FITS, INSERTIONS, CORRELATIONS):
        rng = np.random.default_rng([fits, insertions, round(10 * correlation)])
        for case, shifts in CASES.items():
            every = [simulate(rng, fits, insertions, correlation, shifts) for _ in range(count)]
            row = {"fits": fits, "insertions": insertions, "correlation": correlation, "case": case}
            found = pd.Series([api.judge_fits(tabulate(one)) for one in every])
            simpler = pd.Series([judge_by_insertions(one) for one in every])
            row |= {
                word: (found == word).mean() for word in ("generalises", "not shown", "does not generalise")
            }
            row |= {"does not, by insertions": (simpler == "does not generalise").mean()}
            rows.append(row)
    table = pd.DataFrame(rows)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(options.out.with_suffix(".csv"), index=False)
    print(table.to_string(index=False, float_format=lambda value: f"{value:.3f}"))
    shares = table[table["fits"] > 1].groupby(["case", "fits"])[list(table.columns[4:])]
    print(shares.agg(["min", "mean", "max"]).to_string(float_format=lambda value: f"{value:.3f}"))
    equal = table[table["case"] == "equal"]
    figure, panels = plt.subplots(1, 2, figsize=(7.2, 2.8), sharex=True, layout="constrained")
    panels[0].plot(equal["fits"], 100 * equal["does not generalise"], "o")
    panels[0].axhline(5, color="grey", lw=0.8)
    panels[0].set(ylabel="false “does not generalise” (%)", xlabel="fits")
    better = table[table["case"] == "ours smaller"]
    for insertions, some in better.groupby("insertions"):
        means = 100 * some.groupby("fits")["generalises"].mean()
        panels[1].plot(means.index, means, "o-", label=f"{insertions} insertions")
    panels[1].set(ylabel="“generalises”, where it is true (%)", xlabel="fits")
    panels[1].legend(fontsize=7)
    figure.savefig(options.out, dpi=150)
    print(f"Figure: {options.out}")


if __name__ == "__main__":
    main()
