"""How often do intervals contain the truth if it is another model than the fitted one?

    python studies/calibration_synthetic.py [--studies study1,study2] [--truths 40] [--quick] [--out FIGURE]

In each truth the synthetic dataset is made again, of other tissues, with friction, layers and a needle that
no fit knows; where a needle has no solution, or the truth is outside the bounds of the tissue model, the next
seed is taken. A study is fitted to it, and predicts its held-out needles. Rows are kept and counted as by
`calibration.py`; held-out tips of one truth share a fit, so a truth is one trial. Printed besides is how wide
95 % intervals of tips are (median, mm). What came out: docs/calibration.md.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
from calibration import place, run_truths
from synthetic import find_twin_truth, make_twin

import needlefit
from needlefit.api import make_problem

MEDIA = {
    "study1": ["phantom2"],
    "study2": ["phantom2"],
    "study3": ["phantom1", "phantom2"],
    "study4": ["phantom2", "phantom3"],
    "study5": ["chicken"],
}
BANDS = {"shape": "simultaneous band", "points": "pointwise band"}


def score_study(study: str, seed: int) -> list[dict]:
    """Return a row for each parameter, held-out tip and kind of band of a truth; none if it is not taken."""
    with TemporaryDirectory() as folder:
        try:
            twin = make_twin(f"{folder}/twin", seed, MEDIA[study], population=True)
        except needlefit.NeedlefitError:  # a needle has no solution
            return []
        run = needlefit.validate(study, dataset=twin, recipe={"metric": False}, seed=seed)
    draws, predictive = run.frames["draws"].query("specimen == '(tuned)'"), run.frames["predictive"]
    fitted = run.frames["parameters"].query("method == 'fitted'").set_index("parameter")
    known = fitted.assign(truth=pd.Series(find_twin_truth(make_problem(study), seed))).dropna(subset="truth")
    if not known["truth"].between(known["bound_low"], known["bound_high"]).all():
        return []
    rows = [place(name, (draws[name] < truth).mean()) for name, truth in known["truth"].items()]
    for _, row in predictive.iterrows():  # places count from the side away from which the needle bends
        pit = row["tip_pit"] if row["tip_median_mm"] > 0 else 1 - row["tip_pit"]
        width = row["tip_95_high_mm"] - row["tip_95_low_mm"]
        rows.append(place("held-out tip", pit) | {"width_mm": width})
    for key, name in BANDS.items():
        shares = {f"in_{level}": predictive[f"{key}_in_{level}"].astype(float).mean() for level in (50, 95)}
        rows.append({"quantity": name} | shares)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", default=",".join(MEDIA))
    parser.add_argument("--truths", type=int, default=40, help="of each study")
    parser.add_argument("--quick", action="store_true", help="two truths, study 5")
    parser.add_argument("--out", type=Path, default=Path("reports/calibration_synthetic.png"))
    options = parser.parse_args()
    studies, truths = (["study5"], 2) if options.quick else (options.studies.split(","), options.truths)
    run_truths(score_study, studies, truths, options.out)
    rows = pd.read_csv(options.out.with_suffix(".csv"))
    print(rows.groupby("study")["width_mm"].median().round(1).to_string())


if __name__ == "__main__":
    main()
