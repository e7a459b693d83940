"""Does a fit find the true parameters, and is it right about which of them it knows?

    python studies/recovery.py [--seeds 1:21] [--quick] [--out reports/recovery.png]

The twin (the synthetic dataset) and the thin gel are made again with other random numbers, and every medium
is fitted as the shipped fits do. A row has the truth (the mean over what the fit learns from), the estimate
(the posterior's median), its interval, the range of the least errors, and what the fit calls determined.
Where `status` is "prior", the interval is the prior's, whose centre is the truth of every twin. A run that
was stopped goes on at its rows (CSV).

What came out of 20 seeds (docs/fitting.md): of 400 truths 383 lie in intervals, all in ranges.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from synthetic import make_twin
from thin_gel import write_truth

import needlefit

TWIN_MEDIA = ("phantom1", "phantom2", "phantom3", "chicken")
FITS = (*TWIN_MEDIA, "thin_gel")
SHIPPED = Path(__file__).resolve().parents[1] / "configs/fits"


def fit_truth(seed: int, fits: tuple[str, ...], recipe: dict) -> list[dict]:
    """Return a row for each fit and each of its parameters that has a true value, of one seed."""
    rows = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        make_twin(folder / "twin", seed, TWIN_MEDIA)
        write_truth(folder / "thin_gel", seed)
        for fit in fits:
            shipped = (SHIPPED / f"{fit}.toml").read_text(encoding="utf-8")
            (folder / f"{fit}.toml").write_text(shipped.replace('dataset = "', f'dataset = "{folder}/'))
            run = needlefit.fit(folder / f"{fit}.toml", recipe=recipe)
            found = run.frames["parameters"]
            ranges = found[found["method"] == "fitted_metric"].set_index("parameter")[["low", "high"]]
            fitted = found[(found["method"] == "fitted") & found["status"].isin(["free", "prior"])]
            for row in fitted.to_dict("records"):
                if (name := row["parameter"]) in run.metadata.truth:
                    scores = score(row, run.metadata.truth[name], *ranges.loc[name])
                    rows.append({"seed": seed, "fit": fit, **scores})
    return rows


def score(row: dict, truth: float, range_low: float, range_high: float) -> dict:
    """Return an estimate beside the truth (Pa, mm), its interval and its range."""
    low, high = row["interval_low"], row["interval_high"]
    return {name: row[name] for name in ("parameter", "status", "determined")} | {
        "truth": truth,
        "value": row["median"] if pd.notna(row["median"]) else row["value"],
        "low": low,
        "high": high,
        "covered": low <= truth <= high,
        "range_low": range_low,
        "range_high": range_high,
        "in_range": range_low <= truth <= range_high,
    }


def summarize(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how many truths lie in intervals and ranges, and are called determined, by fit and parameter."""
    counts = rows.assign(seeds=1, determined=rows["determined"] == "yes")
    names = ["seeds", "covered", "in_range", "determined"]
    return counts.groupby(["fit", "parameter"], sort=False)[names].sum().astype(int)


def draw(rows: pd.DataFrame, path: Path) -> None:
    """Save the estimate of every seed beside its truth, with its interval and its range."""
    is_factor = ~rows["parameter"].str.startswith("alpha")
    sizes = [part.groupby(["fit", "parameter"]).ngroups for part in (rows[is_factor], rows[~is_factor])]
    size = 6, 2 + 0.28 * sum(sizes)
    figure, axes = plt.subplots(2, 1, figsize=size, height_ratios=sizes, layout="constrained")
    for ax, part in zip(axes, (rows[is_factor], rows[~is_factor]), strict=True):
        names = list(part.groupby(["fit", "parameter"], sort=False).groups)
        compare = np.divide if ax is axes[0] else np.subtract
        for _, row in part.iterrows():
            at = names.index((row["fit"], row["parameter"])) + 0.6 * (row["seed"] % 20) / 20 - 0.3
            colour = "#1b6ca8" if row["covered"] else "#c0392b"
            ax.plot(compare([row["range_low"], row["range_high"]], row["truth"]), [at, at], "0.85", lw=0.6)
            ax.plot(compare([row["low"], row["high"]], row["truth"]), [at, at], color=colour, lw=0.6)
            ax.plot(compare(row["value"], row["truth"]), at, ".", ms=3, color=colour)
        ax.axvline(compare(1, 1), color="0.5", lw=0.8)
        ax.set_yticks(range(len(names)), [" ".join(one).removesuffix("_pa") for one in names])
        ax.invert_yaxis()
    axes[0].set(xscale="log", xlim=(1e-3, 1e3), xlabel="estimate / truth (red: interval misses; grey: range)")
    axes[1].set(xlabel="estimate - truth")
    figure.savefig(path, dpi=150, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", help="FIRST:END of the twins' seeds (default 1:21, with --quick 1:2)")
    parser.add_argument("--quick", action="store_true", help="one seed, chicken and thin gel, two starts")
    parser.add_argument("--out", type=Path, default=Path("reports/recovery.png"))
    options = parser.parse_args()
    fits, recipe = (FITS[3:], {"starts": 2}) if options.quick else (FITS, {})
    first, end = map(int, (options.seeds or ("1:2" if options.quick else "1:21")).split(":"))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    table = options.out.with_suffix(".csv")
    rows = pd.read_csv(table) if table.is_file() else pd.DataFrame(columns=["seed"])
    for seed in sorted(set(range(first, end)) - set(rows["seed"])):
        rows = pd.concat([rows, pd.DataFrame(fit_truth(seed, fits, recipe))], ignore_index=True)
        rows.to_csv(table, index=False)
        print(f"seed {seed} is fitted", flush=True)
    free = rows[rows["status"] == "free"]
    draw(free, options.out)
    print(summarize(free).to_string())
    counts = f"{free['covered'].sum()} in intervals, {free['in_range'].sum()} in ranges"
    print(f"{len(free)} free parameters: {counts}. Figure: {options.out}, rows: {table}")


if __name__ == "__main__":
    main()
