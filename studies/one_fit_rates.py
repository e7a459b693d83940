"""How often is the verdict on one fit, or one specimen, wrong, and how often does it find a true difference?

    python studies/one_fit_rates.py [--quick]

Tips of three methods, ours and two references, err by normal deviations that are correlated between needles,
for they share the fit; the measured tip errs, too, in part by the registration of the scan that all needles
share (`REGISTRATIONS`). Tip errors are the absolute differences. The verdict states what holds on these
needles: where the root mean squares of the true tip errors are equal on them (`CASES`), "closer" and "worse"
are false. Of methods that are equal in the mean of many fits, "any fit", the words show how far they hold
beyond this one: hardly, which is why they name their reach. What came out: docs/studies.md.
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
WORDS = ["closer than both", "as close", "worse than one", "bend too little"]
CLOSER, WORSE, POWER = 1.645, 1.960, 0.842  #: normal quantiles of 95, 97.5 and 80 %
#: by how many noise floors the true tip errors of the references, as root mean squares, exceed ours; None:
#: of any fit
CASES: dict[str, tuple[float, float] | None] = {
    "equal": (0.0, 0.0),
    "one reference equal": (0.0, 20.0),
    "closer by 1.5": (1.5, 1.5),
    "closer by 2": (2.0, 2.0),
    "closer by 3": (3.0, 3.0),
    "farther by 1.5": (-1.5, 0.0),
    "farther by 3": (-3.0, 0.0),
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
    """Return predicted minus measured tips (count, 3 methods, needles): ours, then the references'."""
    shared, own = rng.standard_normal((count, 3, 1)), rng.standard_normal((count, 3, needles))
    off = error * (np.sqrt(correlation) * shared + np.sqrt(1 - correlation) * own)
    if (gaps := CASES[case]) is not None:  # the true tip errors are exactly these
        added = NOISE_FLOOR * (np.array([0.0, *gaps]) - min(0.0, *gaps))
        mean = np.sqrt(np.mean(off**2, axis=2, keepdims=True))
        off *= (mean[:, :1] + added[:, None]) / mean
    own, shared = rng.standard_normal((count, 1, needles)), rng.standard_normal((count, 1, 1))
    return off - np.sqrt(1 - registration) * own - np.sqrt(registration) * shared


def judge_needles(off: np.ndarray, registration: float) -> np.ndarray:
    """Return the outcomes of `compare_with_references`, by code of its own for many simulations."""
    errors, apart = np.abs(off), off - off[:, :1]
    alone, common = np.sum(apart**2, axis=2), np.sum(apart, axis=2) ** 2
    # the registration is shared by all needles or by none, whichever makes the difference less certain
    sd = 2 * np.sqrt((1 - registration) * alone + registration * np.maximum(alone, common))
    sd = np.where(sd > 0, sd, np.inf)  # of ours beside itself
    z = ((np.sum(off**2, axis=2) - np.sum(off[:, :1] ** 2, axis=2)) / sd)[:, 1:]
    gaps = (errors.mean(axis=2) - errors[:, :1].mean(axis=2))[:, 1:]
    closer = np.all((z > CLOSER) & (gaps > 0), axis=1)
    worse = np.any((z < -WORSE) & (gaps < 0), axis=1) & (errors[:, 0].mean(axis=1) > 2 * NOISE_FLOOR)
    told = (np.abs(z) > CLOSER) | (alone[:, 1:] / sd[:, 1:] > CLOSER + POWER)
    words = np.where(told.all(axis=1), "as close", "bend too little")
    return np.where(closer, "closer than both", np.where(worse, "worse than one", words))


def tabulate_needles(off: np.ndarray, registration: float) -> pd.DataFrame:
    """Return the errors (methods, needles) of one simulation as the table of a run."""
    methods = ("fitted", *api.REFERENCES)
    names = [f"n{number}" for number in range(off.shape[1])]
    rows = pd.DataFrame(off.T, columns=methods).assign(insertion=names, hole=names)
    rows = rows.melt(["insertion", "hole"], var_name="method", value_name="tip_error_y_mm")
    sds = {"tip_across_sd_mm": 1.0, "tip_registered_sd_mm": np.sqrt(registration)}
    zeros = {"tip_error_x_mm": 0.0, "tip_error_z_mm": 0.0}
    return rows.assign(fold="all", specimen="p", te_mm=rows["tip_error_y_mm"].abs(), **sds, **zeros)


def judge_one_fit(count: int) -> pd.DataFrame:
    """Return the share of each outcome, by needles, correlation, error and case."""
    rows = []
    for *setting, case in product(NEEDLES, CORRELATIONS, ERRORS, REGISTRATIONS, CASES):
        rng = np.random.default_rng([round(10 * one) for one in setting])
        off, registration = simulate_needles(rng, count, *setting, case), setting[-1]
        words, table = judge_needles(off, registration), tabulate_needles(off[0], registration)
        found = api.compare_with_references(table, "fitted", NOISE_FLOOR).outcome
        if {"closer by one needle": "closer than both"}.get(found, found) != words[0]:
            raise SystemExit(f"the program has another rule: {found}, not {words[0]}")
        shares = {word: (words == word).mean() for word in WORDS}
        rows.append({"case": case, **dict(zip(SETTING, setting, strict=True)), **shares})
    return pd.DataFrame(rows)


def print_one_fit(table: pd.DataFrame) -> None:
    found = table.groupby(["case", "needles", "registration"], sort=False)[WORDS].agg(["min", "mean", "max"])
    print(found.to_string(float_format=lambda value: f"{value:.3f}"))
    equal = table[table["case"].isin(["equal", "one reference equal"])]
    wrong = equal.groupby(["registration", "needles"])[["closer than both", "worse than one"]].max()
    print("Largest share of false words, by registration and needles:")
    print(wrong.round(3).unstack().to_string())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="400 simulations of each case, not 20 000")
    print_one_fit(judge_one_fit(400 if parser.parse_args().quick else 20_000))


if __name__ == "__main__":
    main()
