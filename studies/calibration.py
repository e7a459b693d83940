"""Are posteriors computed correctly? True parameters from the prior, ranked in their posteriors.

    python studies/calibration.py [--truths 60] [--quick] [--out reports/calibration.png]

Simulation-based calibration (S. Talts et al., arXiv 1804.06788): the needles that studies 1 and 2 fit are
simulated and measured with parameters from the prior, and these are ranked among draws of the posterior. So
are the tip of the deepest insertion and the log likelihood, without which the prior itself would pass for a
posterior (M. Modrak et al., Bayesian Anal. 20 (2025) 461). A quantity passes if the counts of truths in
central intervals and the ECDF of their places are as chance allows: where posteriors are right, one of a
study fails with a probability of 0.01 at most. A run that was stopped goes on at its rows (CSV). This tests
the computation; `calibration_synthetic.py` tests the model. What came out: docs/calibration.md.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from research.fits import draw_posterior
from research.simulated_data import simulate_from_prior
from scipy.stats import binom

import needlefit
from needlefit import api

DRAWS, LEVELS, ERROR_PROBABILITY = 79, (50, 80, 90, 95), 0.01


def place(quantity: str, pit: float) -> dict:
    """Return a row: the place of the truth, 0 to 1, and whether it is in each central interval."""
    inside = {f"in_{level}": float(abs(pit - 0.5) <= level / 200) for level in LEVELS}
    return {"quantity": quantity, "pit": pit} | inside


def evaluate(problem: needlefit.Problem, thetas: np.ndarray) -> dict[str, np.ndarray]:
    """Return what is ranked (N,) of thetas (N, P), by name."""
    deepest = replace(problem, insertions=(max(problem.insertions, key=lambda one: one.depth),))
    tips = np.array([deepest.points(theta)[0][0][-1, 1] for theta in thetas])
    prior = problem.parameters.prior.log_density([problem.values(theta) for theta in thetas])
    found = dict(zip(problem.names, thetas.T, strict=True))
    return found | {"tip": tips, "log likelihood": problem.log_posteriors(thetas) - prior}


def rank_truth(study: str, seed: int) -> list[dict]:
    """Return the place of each quantity of a truth from the prior among draws of its posterior."""
    theta, simulated = simulate_from_prior(api.make_problem(study), seed)
    truth = evaluate(simulated, theta[None])
    draws = evaluate(simulated, draw_posterior(simulated, DRAWS, seed).thetas)
    return [place(name, (np.sum(draws[name] < truth[name]) + 0.5) / (DRAWS + 1)) for name in truth]


def summarize(rows: pd.DataFrame, ax: plt.Axes) -> pd.DataFrame:
    """Return how many truths of a study are covered, by quantity; draw ECDFs of places minus the diagonal.

    A curve above its band first and below it then: posteriors too narrow. Rows of one truth and quantity,
    such as of several tips, are one trial: a share of it may be covered.
    """
    truths, x = rows["seed"].nunique(), np.arange(1, DRAWS + 1) / (DRAWS + 1)
    names = [f"in_{level}" for level in LEVELS]
    by_truth = rows.groupby(["quantity", "seed"], sort=False)[names].mean()
    table = by_truth.groupby("quantity", sort=False).sum(min_count=1)
    error = ERROR_PROBABILITY / (len(table) * (1 + len(LEVELS)))
    least, most = (binom.ppf(end, truths, np.array(LEVELS) / 100) for end in (error / 2, 1 - error / 2))
    passes = (((table >= least) & (table <= most)) | table.isna()).all(axis=1)
    low, high = api.ecdf_band(truths, DRAWS + 1, error)
    ax.fill_between(x, low / truths - x, high / truths - x, color="0.9")
    for name, some in rows.dropna(subset="pit").groupby("quantity", sort=False):
        lower = pd.DataFrame(some["pit"].to_numpy()[:, None] < x, index=some["seed"])
        below = lower.groupby(level=0).mean().sum()
        passes[name] &= ((low <= below) & (below <= high)).all()
        ax.plot(x, below / truths - x, lw=0.8, label=name if passes[name] else f"{name}: fails")
    ax.set(xlabel="place of the truth", ylabel="ECDF - uniform", title=rows["study"].iloc[0])
    ax.legend(fontsize=6, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    limits = zip(names, least, most, strict=True)
    heads = {name: f"{name} ({low:.0f} to {high:.0f})" for name, low, high in limits}
    return table.rename(columns=heads).assign(passes=passes)


def run_truths(score: Callable[[str, int], list[dict]], studies: list[str], truths: int, out: Path) -> None:
    """Score so many truths of each study, by their seeds; print the tables and save the figure."""
    table = out.with_suffix(".csv")
    table.parent.mkdir(parents=True, exist_ok=True)
    rows = pd.read_csv(table) if table.is_file() else pd.DataFrame(columns=["study", "seed"])
    figure, axes = plt.subplots(
        1, len(studies), figsize=(4 * len(studies), 4), layout="constrained", squeeze=False
    )
    for study, ax in zip(studies, axes[0], strict=True):
        for seed in count(1):
            known = rows[rows["study"] == study]
            if known["seed"].nunique() >= truths:
                break
            if seed not in set(known["seed"]):
                found = pd.DataFrame(score(study, seed)).assign(study=study, seed=seed)
                rows = pd.concat([rows, found], ignore_index=True)
                rows.to_csv(table, index=False, float_format="%.4g")
        print(f"{study}, {truths} truths:\n{summarize(known, ax).round(1).to_string()}", flush=True)
    figure.savefig(out, dpi=150, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--truths", type=int, default=60, help="of each study")
    parser.add_argument("--quick", action="store_true", help="two truths, study 5")
    parser.add_argument("--out", type=Path, default=Path("reports/calibration.png"))
    options = parser.parse_args()
    studies, truths = (["study5"], 2) if options.quick else (["study1", "study2"], options.truths)
    run_truths(rank_truth, studies, truths, options.out)


if __name__ == "__main__":
    main()
