"""Which spread between specimens of one batch predicts a further one best? Chosen without the one judged.

    python studies/spread_scale.py [--factors 1.05 1.1 1.2] [--quick] [--out reports/spread_scale.png]

The prior of the spread between specimens has a scale, `tip_factor` of the recipe: the factor between tip
deflections of specimens at one standard deviation. Of the six holes of `stereo_shapes` each is left out in
turn. Of the other five every one is predicted by a fit to the remaining four, with each factor; that with the
smallest mean CRPS of tips is chosen. With it a fit to all five predicts the hole left out, and that
alone is judged. (A fit to four holes predicts both others, each for the choice made without the other.)
Needs the measured data; what came out: docs/real_needles.md.
"""

import argparse
from itertools import combinations
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

import needlefit
from needlefit.api import load_dataset

DATASET = "stereo_shapes"
STUDY = {"schema": 2, "dataset": DATASET, "medium": "gel_stereo", "compared": "plane"}
FACTORS = (1.05, 1.1, 1.2)
COLUMNS = ["tip_crps_mm", "width_mm", "tip_in_50", "tip_in_95"]


def predict(factor: float, without: tuple[str, ...]) -> pd.DataFrame:
    """Return a row for each hole left out of a fit: means over its tips of CRPS, width (mm) and coverage."""
    holes = load_dataset(DATASET).to_frame().groupby("specimen")["insertion"].agg(list)
    study = STUDY | {
        "tune": {"insertions": holes.drop(list(without)).explode().tolist()},
        "validate": [{"insertions": holes[list(without)].explode().tolist()}],
    }
    run = needlefit.validate(study, recipe={"metric": False, "specimens": {"tip_factor": factor}})
    rows = run.frames["predictive"]
    rows = rows.assign(width_mm=rows["tip_95_high_mm"] - rows["tip_95_low_mm"])
    means = rows.groupby("specimen")[COLUMNS].mean().rename_axis("hole").reset_index()
    return means.assign(factor=factor, without=" ".join(without), left_out=len(without))


def choose(rows: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each hole: the factor that the others choose, and its prediction by a fit to them."""
    pairs, alone, found = rows[rows["left_out"] == 2], rows[rows["left_out"] == 1], []
    for hole, judged in alone.groupby("hole"):
        without = pairs["without"].str.split().explode() == hole
        of_others = pairs[without.groupby(level=0).any() & (pairs["hole"] != hole)]
        scores = of_others.groupby("factor")["tip_crps_mm"].mean()
        chosen = judged[judged["factor"] == scores.idxmin()]
        found.append(chosen.assign(crps_of_others_mm=scores.min()))
    return pd.concat(found, ignore_index=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--factors", type=float, nargs="+", default=FACTORS)
    parser.add_argument("--quick", action="store_true", help="three holes in place of six")
    parser.add_argument("--out", type=Path, default=Path("reports/spread_scale.png"))
    options = parser.parse_args()
    names = sorted(load_dataset(DATASET).to_frame()["specimen"].unique())[: 3 if options.quick else None]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    table, parts = options.out.with_suffix(".csv"), list[pd.DataFrame]()
    for without in [*combinations(names, 2), *((name,) for name in names)]:
        parts += [predict(factor, without) for factor in options.factors]
        pd.concat(parts).to_csv(table, index=False)
        print(f"without {' and '.join(without)}: done", flush=True)
    rows = pd.concat(parts, ignore_index=True)
    means = rows.groupby(["left_out", "factor"])[COLUMNS].mean()
    print(means.to_string(float_format="%.3f"))
    chosen = choose(rows)
    print(
        chosen[["hole", "factor", "crps_of_others_mm", *COLUMNS]].to_string(index=False, float_format="%.3f")
    )
    print(f"chosen without the hole that is judged: {chosen[COLUMNS].mean().round(3).to_dict()}")
    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    for hole, some in rows[rows["left_out"] == 1].groupby("hole"):
        axes.plot(some["factor"], some["tip_crps_mm"], color="0.7", lw=0.8, label=f"hole {hole}")
    axes.plot(
        *means.loc[2]["tip_crps_mm"].reset_index().to_numpy().T, "o-", color="#1b6ca8", label="chosen by"
    )
    axes.plot(
        *means.loc[1]["tip_crps_mm"].reset_index().to_numpy().T, "s-", color="#b8511b", label="judged by"
    )
    axes.set(xscale="log", xlabel="tip_factor", ylabel="CRPS of tips, mm")
    axes.legend(fontsize=7)
    figure.savefig(options.out, dpi=150)
    print(f"Figure: {options.out}; rows: {table}")


if __name__ == "__main__":
    main()
