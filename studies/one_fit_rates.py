"""How often is the verdict on one fit, or one specimen, wrong, and how often does it find a true difference?

    python studies/one_fit_rates.py [--quick]

Tips of three methods, ours and two references, err by normal deviations that are correlated between needles,
for they share the fit; the measured tip errs, too, in part by the registration of the scan that all needles
share (`REGISTRATIONS`). Tip errors are the absolute differences. The verdict
states what holds on these needles: where the means of true tip errors are equal on them (`CASES`), any word
but "as close" is false. Of methods that are equal in the mean of many fits, "any fit", the words show how far
they hold beyond this one: hardly, which is why they name their reach. What came out: docs/studies.md.
"""

import argparse
from itertools import product

import numpy as np
import pandas as pd

from needlefit import api

NEEDLES, CORRELATIONS = (1, 3, 6, 12), (0.0, 0.3, 0.6, 0.9)
REGISTRATIONS = (0.0, 0.5, 0.9)  #: share of the variance of measured tips that all needles of a scan share
ERRORS = (0.3, 1.0, 3.0, 10.0)  #: SD of a method's deviations, in those of the noise
SETTING = ("needles", "correlation", "error", "registration")
NOISE_FLOOR = np.sqrt(2 / np.pi)  #: mean distance of a measured tip, for noise of SD 1
#: by how many noise floors the true mean tip errors of the references exceed ours; None: of any fit
CASES: dict[str, tuple[float, float] | None] = {
    "equal": (0.0, 0.0),
    "one reference equal": (0.0, 20.0),
    "closer by 3": (3.0, 3.0),
    "closer by 6": (6.0, 6.0),
    "farther by 3": (-3.0, 0.0),
    "farther by 6": (-6.0, 0.0),
    "any fit": None,
}


def simulate_needles(
    rng: np.random.Generator,
    count: int,
    needles: int,
    correlation: float,
    error: float,
    registration: float,
    case: str,
) -> np.ndarray:
    """Return measured tip errors (count, 3 methods, needles): ours, then the references'."""
    shared, own = rng.standard_normal((count, 3, 1)), rng.standard_normal((count, 3, needles))
    off = error * (np.sqrt(correlation) * shared + np.sqrt(1 - correlation) * own)
    if (gaps := CASES[case]) is not None:  # the means of true tip errors are exactly these
        ours, *others = NOISE_FLOOR * np.array(
            [max(0.0, -min(gaps)), *(gap - min(0.0, *gaps) for gap in gaps)]
        )
        mean = np.abs(off).mean(axis=2, keepdims=True)
        off *= (mean[:, :1] + np.array([ours, *others])[:, None]) / mean
    own, shared = rng.standard_normal((count, 1, needles)), rng.standard_normal((count, 1, 1))
    return np.abs(off - np.sqrt(1 - registration) * own - np.sqrt(registration) * shared)


def judge_needles(tips: np.ndarray, stated: float = 1.0) -> np.ndarray:
    """Return the outcomes of `compare_with_references`, by code of its own for many simulations.

    `stated`: the margin that a study states (`margin_mm`), in noise floors.
    """
    ours, *others = np.moveaxis(tips.mean(axis=2), 1, 0)
    margin = NOISE_FLOOR * max(stated, api.NOISE_GUARD / np.sqrt(tips.shape[2]))
    closer = np.all([other - ours > margin for other in others], axis=0)
    worse = np.any([ours - other > margin for other in others], axis=0) & (ours > 2 * NOISE_FLOOR)
    return np.where(closer, "closer than both", np.where(worse, "worse than one", "as close"))


def tabulate_needles(tips: np.ndarray) -> pd.DataFrame:
    """Return the errors (methods, needles) of one simulation as the table of a run."""
    methods = ("fitted", *api.REFERENCES)
    names = [f"n{number}" for number in range(tips.shape[1])]
    rows = pd.DataFrame(tips.T, columns=methods).assign(insertion=names, hole=names)
    rows = rows.melt(["insertion", "hole"], var_name="method", value_name="te_mm")
    return rows.assign(fold="all", specimen="p")


def judge_one_fit(count: int) -> pd.DataFrame:
    """Return the share of each outcome, by needles, correlation, error and case."""
    rows = []
    for *setting, case in product(NEEDLES, CORRELATIONS, ERRORS, REGISTRATIONS, CASES):
        rng = np.random.default_rng([round(10 * one) for one in setting])
        tips = simulate_needles(rng, count, *setting, case)
        words = judge_needles(tips)
        one = api.compare_with_references(tabulate_needles(tips[0]), "fitted", NOISE_FLOOR)
        more = {"closer by one needle": "closer than both", "not clearly closer": "as close"}
        if more.get(one.outcome, one.outcome) != words[0]:
            raise SystemExit(f"the program has another rule: {one.outcome}, not {words[0]}")
        shares = {word: (words == word).mean() for word in ("closer than both", "as close", "worse than one")}
        shares["as close, margin stated"] = (judge_needles(tips, api.NOISE_GUARD) == "as close").mean()
        rows.append({"case": case, **dict(zip(SETTING, setting, strict=True)), **shares})
    return pd.DataFrame(rows)


def print_one_fit(table: pd.DataFrame) -> None:
    words = ["closer than both", "as close", "worse than one"]
    found = table.groupby(["case", "needles", "registration"], sort=False)[words].agg(["min", "mean", "max"])
    print(found.to_string(float_format=lambda value: f"{value:.3f}"))
    equal = table[table["case"].isin(["equal", "one reference equal"])]
    for name, what in (
        ("as close", ""),
        ("as close, margin stated", f", margin {api.NOISE_GUARD:g} noise floors"),
    ):
        wrong = (1 - equal[name]).groupby([equal["registration"], equal["needles"]]).max().unstack()
        print(f"Largest share of false words, by registration and needles{what}:")
        print(wrong.round(3).to_string())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="400 simulations of each case, not 20 000")
    print_one_fit(judge_one_fit(400 if parser.parse_args().quick else 20_000))


if __name__ == "__main__":
    main()
