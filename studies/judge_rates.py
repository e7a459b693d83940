"""How often is the verdict of several fits wrong, and how often does it find a true difference?

    python studies/judge_rates.py [--quick] [--out FIGURE]

Tip errors of our fits and of five curves are simulated: normal, with a correlation within a fit (insertions
of one fit err alike; curves have the same correlation and nothing in common with ours). Of each number of
fits, of insertions that each predicts and of the correlation three cases are judged: all errors are equal on
average; ours are smaller than those of the closest curve by one standard deviation of the differences between
fits, and than the others' by three; one curve's are smaller than ours by one. --quick: 20 simulations of each
case in place of 300.

What came out of 300 simulations of each (seed 1): equal errors are called "does not generalise" in 0 to 7 %
of cases (4 % on average), "generalises" in less than 1 %, and "not shown" in all others. With one fit neither
verdict occurs. With six fits a true difference of one standard deviation is found in 64 to 71 %. A rule of
two standard errors over insertions, whatever they share, calls equal errors "does not generalise" in 7 to
68 % of cases with more than one insertion.
"""

import argparse
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from needlefit import api

FITS, INSERTIONS, CORRELATIONS = (1, 3, 6, 12), (1, 3, 8, 14), (0.0, 0.3, 0.6)
OURS = "predictive_median"
CURVES = ("straight", "constant_curvature", "linear_curvature", "quadratic_curvature", "mean_shape")
#: by how much the errors of the first curve, and of the others, exceed ours, in SDs of a fit's difference
CASES = {"equal": (0.0, 0.0), "ours smaller": (1.0, 3.0), "ours larger": (-1.0, 0.0)}


def simulate(
    rng: np.random.Generator, fits: int, insertions: int, correlation: float, shifts: tuple[float, float]
) -> np.ndarray:
    """Return tip errors (methods, fits, insertions), mm, ours first; each has SD 0.1 about 0.5."""
    size = (1 + len(CURVES), fits, insertions)
    shared, own = rng.standard_normal((*size[:2], 1)), rng.standard_normal(size)
    errors = 0.5 + 0.1 * (np.sqrt(correlation) * shared + np.sqrt(1 - correlation) * own)
    of_fit = 0.1 * np.sqrt(2 * (correlation + (1 - correlation) / insertions))
    errors[1] += shifts[0] * of_fit
    errors[2:] += shifts[1] * of_fit
    return errors


def tabulate(errors: np.ndarray, names: list[str]) -> pd.DataFrame:
    """Return the errors as the table of a run."""
    index = pd.MultiIndex.from_product([names, *map(range, errors.shape[1:])], names=["method", "fold", "n"])
    rows = pd.Series(errors.ravel(), index, name="te_mm").reset_index()
    rows["insertion"] = rows["fold"].astype(str) + "-" + rows["n"].astype(str)
    return rows.assign(specimen=rows["insertion"], hole=rows["insertion"])


def judge_by_insertions(errors: np.ndarray) -> str:
    """Return the verdict of a simpler rule: two standard errors over insertions, whatever they share."""
    gaps = (errors[1:] - errors[0]).reshape(len(CURVES), -1)
    if gaps.shape[1] < 2:
        return "not shown"
    z = gaps.mean(axis=1) / (gaps.std(axis=1, ddof=1) / np.sqrt(gaps.shape[1]))
    return "does not generalise" if z.min() < -2 else "generalises" if z.min() > 2 else "not shown"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="20 simulations of each case")
    parser.add_argument("--out", type=Path, default=Path("reports/judge_rates.png"))
    options = parser.parse_args()
    count, rng = 20 if options.quick else 300, np.random.default_rng(1)
    names = [OURS, *CURVES]
    rows = []
    for fits, insertions, correlation in product(FITS, INSERTIONS, CORRELATIONS):
        for case, shifts in CASES.items():
            every = [simulate(rng, fits, insertions, correlation, shifts) for _ in range(count)]
            found = pd.Series([api.judge_fits(tabulate(one, names)) for one in every])
            row = {"fits": fits, "insertions": insertions, "correlation": correlation, "case": case}
            row |= {word: (found == word).mean() for word in ("generalises", "not shown")}
            row |= {"does not": (found == "does not generalise").mean()}
            simpler = pd.Series([judge_by_insertions(one) for one in every])
            row |= {"by insertions: generalises": (simpler == "generalises").mean()}
            row |= {"does not, by insertions": (simpler == "does not generalise").mean()}
            rows.append(row)
    table = pd.DataFrame(rows)
    print(table.to_string(index=False, float_format=lambda value: f"{value:.3f}"))
    equal = table[table["case"] == "equal"]
    figure, panels = plt.subplots(1, 2, figsize=(7.2, 2.8), sharex=True, layout="constrained")
    panels[0].plot(equal["fits"], 100 * equal["does not"], "o")
    panels[0].axhline(5, color="grey", lw=0.8)
    panels[0].set(ylabel="false “does not generalise” (%)", xlabel="fits")
    better = table[table["case"] == "ours smaller"]
    for insertions, some in better.groupby("insertions"):
        means = 100 * some.groupby("fits")["generalises"].mean()
        panels[1].plot(means.index, means, "o-", label=f"{insertions} insertions")
    panels[1].set(ylabel="“generalises”, where it is true (%)", xlabel="fits")
    panels[1].legend(fontsize=7)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=150)
    print(f"Figure: {options.out}")


if __name__ == "__main__":
    main()
