"""Does a fit find the true parameters, and is it right about which of them it knows?

    python studies/recovery.py [--seeds 1:21] [--quick] [--out reports/recovery.png]

The twin (the synthetic dataset) is made again with other random numbers, and every medium is fitted as the
shipped fits do. A row has the truth (the geometric mean over what the fit learns from), the estimate (the
posterior's median), whether its interval and the range of the least errors contain the truth, how far it is
off, and whether the fit calls it determined. A run that was stopped goes on at its rows (CSV).

What came out of 20 twins (docs/fitting.md): 321 of 340 intervals of the posterior contain the truth.
"""

import argparse
import math
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import pandas as pd

import needlefit
from needlefit.api import make_twin

MEDIA = ("phantom1", "phantom2", "phantom3", "chicken")
WIDTH = 3.92  # of a Gaussian 95 % interval, in standard deviations


def fit_twin(seed: int, media: tuple[str, ...], recipe: dict) -> list[dict]:
    """Return a row for each medium and free parameter of one twin."""
    rows = []
    with TemporaryDirectory() as folder:
        twin = make_twin(folder, seed, media)
        for medium in media:
            run = needlefit.fit(twin, medium, tune={"medium": medium}, recipe=recipe)
            truth = run.metadata.truth
            least = run.frames["parameters"].query("method == 'fitted_metric'").set_index("parameter")
            fitted = run.frames["parameters"].query("method == 'fitted' and status == 'free'")
            for row in fitted.to_dict("records"):
                if (name := row["parameter"]) in truth:
                    ends = least.loc[name, ["low", "high"]] if name in least.index else (math.nan, math.nan)
                    scores = score(row, truth[name]) | {"in_range": min(ends) <= truth[name] <= max(ends)}
                    rows.append({"seed": seed, "fit": medium, **scores})
    return rows


def score(row: dict, truth: float) -> dict:
    """Return how far an estimate is from the truth (Pa, mm)."""
    value = row["median"] if pd.notna(row.get("median")) else row["value"]
    low, high = row["interval_low"], row["interval_high"]
    off = math.log(value / truth)
    return {
        "parameter": row["parameter"],
        "truth": truth,
        "value": value,
        "low": low,
        "high": high,
        "covered": low <= truth <= high,
        "factor": math.exp(abs(off)),
        "deviations": off / (math.log(high / low) / WIDTH),
        "determined": row["determined"],
    }


def summarize(rows: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each fit and parameter, over all seeds."""
    covered, known = rows["covered"].astype(bool), rows["determined"] == "yes"
    in_range = rows["in_range"].astype(bool)
    rows = rows.assign(covered=covered, in_range=in_range, yes=known, missed=known & ~covered)
    table = rows.groupby(["fit", "parameter"], sort=False).agg(
        seeds=("seed", "nunique"),
        covered=("covered", "sum"),
        in_range=("in_range", "sum"),
        median_factor=("factor", "median"),
        largest_deviation=("deviations", lambda values: values.abs().max()),
        determined=("yes", "sum"),
        determined_and_missed=("missed", "sum"),
    )
    return table.reset_index()


def draw(rows: pd.DataFrame, path: Path) -> None:
    """Save estimate over truth of every seed, with its interval, by medium and parameter."""
    names = list(rows.groupby(["fit", "parameter"], sort=False).groups)
    figure, axes = plt.subplots(figsize=(6, 1 + 0.28 * len(names)))
    for _, row in rows.iterrows():
        at = names.index((row["fit"], row["parameter"])) + 0.6 * (row["seed"] % 20) / 20 - 0.3
        colour = "#1b6ca8" if row["covered"] else "#c0392b"
        axes.plot([row["low"] / row["truth"], row["high"] / row["truth"]], [at, at], color=colour, lw=0.6)
        axes.plot(row["value"] / row["truth"], at, ".", ms=3, color=colour)
    axes.axvline(1, color="0.5", lw=0.8)
    axes.set(xscale="log", xlabel="estimate / truth (red: interval misses)")
    axes.set_yticks(range(len(names)), [" ".join(one).removesuffix("_pa") for one in names])
    axes.invert_yaxis()
    figure.savefig(path, dpi=150, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", help="FIRST:END of the twins' seeds (default 1:21, with --quick 1:2)")
    parser.add_argument("--quick", action="store_true", help="one twin, one medium, two starts")
    parser.add_argument("--out", type=Path, default=Path("reports/recovery.png"))
    options = parser.parse_args()
    media, recipe = (MEDIA[3:], {"starts": 2}) if options.quick else (MEDIA, {})
    first, end = map(int, (options.seeds or ("1:2" if options.quick else "1:21")).split(":"))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    table = options.out.with_suffix(".csv")
    rows = pd.read_csv(table) if table.is_file() else pd.DataFrame(columns=["seed"])
    for seed in sorted(set(range(first, end)) - set(rows["seed"])):
        rows = pd.concat([rows, pd.DataFrame(fit_twin(seed, media, recipe))], ignore_index=True)
        rows.to_csv(table, index=False)
        print(f"twin {seed} is fitted", flush=True)
    found = summarize(rows)
    draw(rows, options.out)
    print(found.to_string(index=False, float_format="%.2f"))
    counts = f"{rows['covered'].sum()} in intervals, {rows['in_range'].sum()} in ranges"
    print(f"{len(rows)} parameters: {counts}. Figure: {options.out}, rows: {table}")


if __name__ == "__main__":
    main()
