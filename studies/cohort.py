"""How do parameters differ between the specimens of many datasets? The same fit for each specimen.

    python studies/cohort.py MEDIUM DATASET ... [--recipe quick] [--jobs N] [--scheduler ADDRESS]
        [--out reports/cohort.png]

MEDIUM is a tissue model, DATASET the folder or name of a dataset. Every specimen is fitted by itself; where a
dataset has several media, the insertions into MEDIUM are. Rows beside the figure (CSV) have the parameters,
their 95 % intervals and the in-sample errors, or in `note` why a dataset or specimen could not be fitted. A
task is a dataset: it runs in one of N processes, or on a worker of a Dask cluster, which must find the files
under the same paths (docs/developers/scale.md). A run that was stopped goes on at its rows.
"""

import argparse
import os
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import needlefit
from needlefit import api

COLUMNS = ["dataset", "specimen", "insertions", "parameter", "value", "median", "interval_low"]
COLUMNS += ["interval_high", "determined", "ipe_mean_mm", "te_mm", "note"]


def find_path(name: str) -> str:
    """Return a path that holds in any working folder; a bare name stays."""
    return str(Path(name).resolve()) if Path(name).exists() else name


def fit_dataset(name: str, medium: str, recipe: str) -> list[dict]:
    """Return a row for each specimen and free parameter of a dataset, and for what could not be fitted."""
    try:
        dataset = needlefit.load_dataset(name)
    except needlefit.NeedlefitError as error:
        return [{"dataset": name, "note": str(error)}]
    rows, tune = [], {"medium": Path(medium).stem} if len(dataset.media) > 1 else {}
    chosen = [one for one in dataset.insertions if not tune or one.medium == tune["medium"]]
    for specimen in dict.fromkeys(one.specimen for one in chosen):
        about = {"dataset": name, "specimen": specimen}
        try:
            run = needlefit.fit(dataset, medium, tune=tune | {"specimens": [specimen]}, recipe=recipe, jobs=1)
        except needlefit.NeedlefitError as error:
            rows.append(about | {"note": str(error)})
            continue
        errors = run.frames["errors"].query("method == 'fitted' and boundaries == 'measured'")
        about |= {"insertions": len(errors), "note": "; ".join(map(str, run.faults))}
        about |= errors[["ipe_mean_mm", "te_mm"]].mean().to_dict()
        free = run.frames["parameters"].query("method == 'fitted' and status == 'free'")
        rows += [about | row for row in free.reindex(columns=COLUMNS[3:9]).to_dict("records")]
    return rows


def summarize(fits: pd.DataFrame) -> pd.DataFrame:
    """Return the values of each parameter over specimens (Pa, mm), and how many determine it."""
    groups = fits.groupby("parameter", sort=False)
    table = groups["value"].quantile([0.05, 0.5, 0.95]).unstack()
    table.columns = ["5 %", "median", "95 %"]
    determined = groups["determined"].agg(lambda cells: (cells == "yes").sum())
    return table.assign(specimens=groups.size(), determined=determined)


def draw(fits: pd.DataFrame, path: Path) -> None:
    """Save a histogram of each parameter over specimens."""
    groups = fits.groupby("parameter", sort=False)
    figure, axes = plt.subplots(
        1, groups.ngroups, figsize=(3 * groups.ngroups, 3), squeeze=False, layout="constrained"
    )
    for ax, (name, rows) in zip(axes[0], groups, strict=True):
        has_log = not name.startswith("alpha")
        ax.hist(np.log10(rows["value"]) if has_log else rows["value"])
        ax.set(xlabel=f"log10 {name}" if has_log else name, ylabel="specimens")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("medium")
    parser.add_argument("datasets", nargs="+")
    parser.add_argument("--recipe", default="quick")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--scheduler", help="address of a Dask scheduler, such as tls://HOST:8786")
    parser.add_argument("--out", type=Path, default=Path("reports/cohort.png"))
    options = parser.parse_args()
    table = options.out.with_suffix(".csv")
    table.parent.mkdir(parents=True, exist_ok=True)
    rows = pd.read_csv(table) if table.is_file() else pd.DataFrame(columns=COLUMNS)
    names = list(dict.fromkeys(map(find_path, options.datasets)))
    left = [name for name in names if name not in set(rows["dataset"])]
    work = partial(fit_dataset, medium=find_path(options.medium), recipe=find_path(options.recipe))
    pool = nullcontext(api.LocalPool(options.jobs))
    with api.connect_cluster(options.scheduler) if options.scheduler else pool as workers:
        for number, found in workers.run(work, left):
            rows = pd.concat([rows, pd.DataFrame(found, columns=COLUMNS)], ignore_index=True)
            rows.to_csv(table, index=False)
            print(f"{left[number]} is fitted", flush=True)
    rows = pd.read_csv(table)
    fits = rows.dropna(subset="parameter")
    if len(fits):
        draw(fits, options.out)
        print(summarize(fits).to_string(float_format="%.4g"))
    failed = rows[rows["parameter"].isna()]
    print(f"{len(failed)} datasets or specimens could not be fitted. Figure: {options.out}, rows: {table}")


if __name__ == "__main__":
    main()
