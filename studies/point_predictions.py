"""Which needle predicts best: the posterior mode, the predictive median, the least errors, or b alone?

    python studies/point_predictions.py [--seeds 1:21] [--measured] [--quick] [--out TABLE.csv]

The twin (the synthetic dataset) is made again with other random numbers; studies 2, 3 and 5 are fitted to it,
and predict their held-out needles. A row has the mean errors of one point prediction on those of one twin and
study: of the tip (TE), in the plane (IPE), and the CRPS of the predictive distribution moved so that its
median is the point: by its five stored quantiles (weighted interval score; J. Bracher et al., PLoS Comput.
Biol. 17 (2021) e1008618). The predictive median errs across the needle alone, the others along it too, which
adds about 1 %. Shapes of unknown pose are each aligned to the measured one, the draws of the median too. "b
alone" has all else at the median of its prior. --measured: also the studies of measured needles, which need
their data. A run that was stopped goes on at its rows (CSV). What came out:
docs/studies.md.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
from synthetic import make_twin

import needlefit

STUDIES, MEASURED = ("study2", "study3", "study5"), ("stereo_depth", "stereo_insertions")
METHODS = {"prediction": "mode", "fitted_metric": "least errors", "b_alone": "b alone"}
METRICS = {"te_mm": "TE", "ipe_mean_mm": "IPE", "crps_mm": "CRPS"}
LEVELS = (0.5, 0.95)  # of the intervals that a run stores


def score_quantiles(predictive: pd.DataFrame, off: "pd.Series[float]") -> "pd.Series[float]":
    """Return the weighted interval score (mm) with the median at `off` from the measured tip, mm."""
    measured, median = predictive["tip_measured_mm"], predictive["tip_median_mm"]
    moved = measured + off - median  # by which all quantiles are moved
    score = off.abs() / 2
    for level in LEVELS:
        low, high = (predictive[f"tip_{100 * level:.0f}_{end}_mm"] + moved for end in ("low", "high"))
        beyond = (low - measured).clip(lower=0) + (measured - high).clip(lower=0)
        score += (1 - level) / 2 * (high - low) + beyond
    return score / (len(LEVELS) + 0.5)


def score_run(run: needlefit.Run) -> list[dict]:
    """Return the mean errors (mm) of every point prediction of the held-out needles of a run."""
    predictive, bands = (
        run.frames[name].set_index(["fold", "insertion"]) for name in ("predictive", "bands")
    )
    held_out = "role == 'validate' and boundaries == 'measured'"
    errors, shapes = run.frames["errors"].query(held_out), run.frames["shapes"].query(held_out)
    tips = shapes.loc[shapes.groupby(["fold", "insertion", "method"])["j"].idxmax()]
    offs = predictive["tip_median_mm"] - predictive["tip_measured_mm"]
    gaps = (bands["median_mm"] - bands["measured_mm"]).abs()
    found = [{"method": "median", "te_mm": offs.abs().mean(), "ipe_mean_mm": gaps.mean()}]
    found[0]["crps_mm"] = score_quantiles(predictive, offs).mean()
    for method, name in METHODS.items():
        ours, tip = (rows[rows["method"] == method] for rows in (errors, tips))
        if len(ours):
            tip = tip.set_index(["fold", "insertion"])
            off = tip["simulated_y_mm"] - tip["measured_y_mm"]
            row = {"method": name, **ours[["te_mm", "ipe_mean_mm"]].mean()}
            found.append(row | {"crps_mm": score_quantiles(predictive, off).mean()})
    covered = predictive[["tip_in_50", "tip_in_95"]].astype(float).mean()
    return [{**row, **covered} for row in found]


def compare(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the mean of every score, and its difference from that of the mode with its standard error."""
    found = []
    for (study, metric), some in rows.melt(["seed", "study", "method"], METRICS).groupby(
        ["study", "variable"], sort=False
    ):
        wide = some.pivot(index="seed", columns="method", values="value")
        for method in wide:
            gap = (wide[method] - wide["mode"]).dropna()
            row = {"study": study, "score": METRICS[metric], "method": method, "runs": len(gap)}
            row |= {"mean_mm": wide[method].mean(), "minus_mode_mm": gap.mean(), "se_mm": gap.sem()}
            found.append(row | {"better": int((gap < 0).sum())})
    return pd.DataFrame(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", help="FIRST:END of the twins' seeds (default 1:21, with --quick 1:3)")
    parser.add_argument("--measured", action="store_true", help="also the studies of measured needles")
    parser.add_argument("--quick", action="store_true", help="two twins, study 5, two starts")
    parser.add_argument("--out", type=Path, default=Path("reports/point_predictions.csv"))
    options = parser.parse_args()
    first, end = map(int, (options.seeds or ("1:3" if options.quick else "1:21")).split(":"))
    studies, recipe = (STUDIES[2:], {"starts": 2}) if options.quick else (STUDIES, {})
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = pd.read_csv(options.out) if options.out.is_file() else pd.DataFrame(columns=["seed", "study"])

    def add(seed: int, study: str, run: needlefit.Run) -> None:
        nonlocal rows
        found = pd.DataFrame(score_run(run)).assign(seed=seed, study=study)
        rows = pd.concat([rows, found], ignore_index=True) if len(rows) else found
        rows.to_csv(options.out, index=False)
        print(f"{study}, {seed}: is scored", flush=True)

    done = set(zip(rows["seed"], rows["study"], strict=True))
    for seed in range(first, end):
        missing = [study for study in studies if (seed, study) not in done]
        with TemporaryDirectory() as folder:
            twin = make_twin(folder, seed, ["chicken"] if missing == ["study5"] else []) if missing else None
            for study in missing:
                add(seed, study, needlefit.validate(study, dataset=twin, recipe=recipe))
    for study in MEASURED if options.measured else ():
        if (0, study) not in done:
            add(0, study, needlefit.validate(study))
    print(compare(rows).to_string(index=False, float_format="%.3f"))
    covered = rows[rows["method"] == "mode"].groupby("study")[["tip_in_50", "tip_in_95"]].mean()
    print(f"Shares of tips in their intervals, whatever the point:\n{covered.to_string(float_format='%.2f')}")


if __name__ == "__main__":
    main()
