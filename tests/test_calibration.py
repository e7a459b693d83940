"""The script of calibrations: right posteriors pass, and wrong ones are noticed."""

from pathlib import Path

import calibration
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import scipy
from test_simulated_data import small_problem

from needlefit import api

ROOT = Path(__file__).resolve().parents[1]


def summarize(rows):
    figure, ax = plt.subplots()
    plt.close(figure)
    return calibration.summarize(rows.assign(study="study"), ax)


def place_all(pits):
    """Rows of truths (N,) or, of several rows each, (N, K)."""
    rows = [
        calibration.place(name, float(pit)) | {"seed": seed}
        for name, each in pits.items()
        for seed, truth in enumerate(each)
        for pit in np.atleast_1d(truth)
    ]
    return pd.DataFrame(rows)


def test_exact_posteriors_pass_and_narrow_ones_fail():
    """A Gaussian toy: data with sd 1 about a truth with sd 1, the posterior known exactly."""
    rng = np.random.default_rng(3)
    truth = rng.normal(size=500)
    middle = 0.5 * (truth + rng.normal(size=500))
    exact, narrow, wide = (
        scipy.stats.norm.cdf((truth - middle) / (width * np.sqrt(0.5))) for width in (1.0, 0.7, 1.4)
    )
    passes = summarize(place_all({"exact": exact, "narrow": narrow, "wide": wide}))["passes"]
    assert passes.to_dict() == {"exact": True, "narrow": False, "wide": False}


def rank_small(count, monkeypatch):
    monkeypatch.setattr(api, "make_problem", lambda _: small_problem())
    rows = [calibration.rank_truth("small", seed) for seed in range(count)]
    return pd.DataFrame([one | {"seed": seed} for seed, each in enumerate(rows) for one in each])


@pytest.mark.sweep
def test_needles_of_the_model_itself_are_calibrated(monkeypatch):
    table = summarize(rank_small(25, monkeypatch))
    assert list(table.index) == ["mu1_pa", "bevel_mm", "tip", "log likelihood"]
    assert table["passes"].all()


def test_the_rows_of_the_documents_pass_from_the_prior_and_cover_tips_of_other_truths():
    rows = pd.read_csv(ROOT / "docs/figures/calibration.csv")
    for study, some in rows.groupby("study"):
        assert some["seed"].nunique() == 60 and summarize(some)["passes"].all(), study
    tips = pd.read_csv(ROOT / "docs/figures/calibration_synthetic.csv").query("quantity == 'held-out tip'")
    assert tips.groupby("study")["seed"].nunique().tolist() == [40] * 5
    assert tips.groupby("study")["in_95"].mean().between(0.91, 1.0).all()
