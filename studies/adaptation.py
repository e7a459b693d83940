"""How many insertions into a new phantom or specimen does a model need before it predicts the next one?

    python studies/adaptation.py [--cases 3,4,5] [--quick] [--out reports/adaptation.png]

Studies 3 to 5 go from one medium to another. Here insertions into the new one are fitted too, one by one in
four random orders, and the same needles are held out. "with": the posterior of the old medium, widened by
how far media differ (twice the variance between them, each parameter by itself), is the prior. "without":
the prior is flat within the bounds. Needed is the number from which on the mean TE stays within 0.05 mm of
that with all. Rows are kept beside the figure as CSV.

What came out (docs/studies.md): a new phantom needs one insertion; another piece of chicken breast does not
profit from three, and intervals that included the truth before then miss it: the model is wrong there.
"""

import argparse
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from research.fits import score_study

import needlefit
from needlefit.api import load_medium

MARGIN_MM, SD_LN_BEVEL = 0.05, 0.60  # SD of ln b between phantoms 1 to 3 in the paper
RECIPE = {"starts": 4, "metric": False}
# old and new medium, insertions, those held out, SD of ln mu between the paper's phantoms, or chicken's sets
PIECES = ("specimen == 'chicken-piece1'", "specimen == 'chicken-piece3'")
FOUR = "layers_alternative == 4"
CASES = {
    "3": ("phantom2", "phantom1", "insertion == 'phantom2-14'", "layers == 3", "02 04 06 10", 0.66),
    "4": ("phantom2", "phantom3", FOUR, FOUR, "02 04 06 08", 0.66),
    "5": ("chicken", "chicken", *PIECES, "07 10 12", 0.98),
}
COLUMNS = ["insertion", "te_mm", "floor_te_mm"]


def widen(medium: dict, draws: pd.DataFrame, sd_ln_mu: float) -> dict:
    """Return a tissue model whose priors are posterior draws (Pa, mm), widened by the SD between media."""
    changed = dict(medium["parameters"])
    for name, stated in changed.items():
        if "bounds" in stated and name in draws and not name.startswith("alpha"):  # that keeps its prior
            logs, between = np.log(draws[name]), sd_ln_mu if name.startswith("mu") else SD_LN_BEVEL
            factor = math.exp(math.sqrt(logs.var() + 2 * between**2))
            changed[name] = stated | {"prior": {"median": float(np.exp(logs.mean())), "factor": factor}}
    return medium | {"parameters": changed}


def predict(medium: str | dict, name: str, tune: list[str], held_out: list, recipe: dict) -> pd.DataFrame:
    """Return errors (mm) of held-out insertions by the fit to others; of a table, also what is covered."""
    sides = {"tune": {"insertions": tune}, "validate": [{"insertions": held_out}], "same_specimen": True}
    study = {"schema": 2, "dataset": "twin", "medium": name, **sides}
    if isinstance(medium, str):
        frame = score_study(study, recipe=recipe)
        return frame.query("role == 'validate' and method == 'fitted'")[COLUMNS]
    run = needlefit.validate(study, medium=medium, recipe=recipe)
    chosen = "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
    covered = run.frames["predictive"][["insertion", "tip_in_95", "tip_crps_mm"]]
    return run.frames["errors"].query(chosen)[COLUMNS].merge(covered, how="left", on="insertion")


def run_case(case: str, orders: int, recipe: dict) -> pd.DataFrame:
    """Return a row for each held-out insertion, prior and set of insertions that are fitted to."""
    old, new, old_query, new_query, numbers, sd_ln_mu = CASES[case]
    table = needlefit.load_dataset("twin").to_frame()
    held_out = [f"{new}-{number}" for number in numbers.split()]
    known = list(table.query(f"medium == '{old}' and {old_query}")["insertion"])
    new_query += " and insertion not in @held_out"
    others = list(table.query(f"medium == '{new}' and {new_query}")["insertion"])
    rng = np.random.default_rng(int(case))
    shuffled = [list(rng.permutation(others)) for _ in range(orders)]
    counts = (1,) if orders == 1 else dict.fromkeys((1, 2, 3, len(others)))
    sets = {tuple(sorted(order[:n])): n for n in counts for order in shuffled}
    fitted = needlefit.fit("twin", old, tune={"insertions": known}, recipe=recipe)
    prior = widen(load_medium(new), fitted.frames["draws"], sd_ln_mu)
    tasks = [("with", (), load_medium(old), 0)]
    tasks += [("with", ids, prior, n) for ids, n in sets.items()]
    tasks += [("without", ids, new, n) for ids, n in sets.items()]
    rows = []
    for name, ids, medium, n in tasks:
        found = predict(medium, new if ids else old, list(ids) or known, held_out, recipe)
        rows.append(found.assign(case=case, prior=name, n=n, fitted="+".join(ids) or "nothing"))
        print(f"study {case}, {name}, {n} insertions: TE {found['te_mm'].mean():.3f} mm", flush=True)
    return pd.concat(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", default="3,4,5", help="of studies 3 to 5")
    parser.add_argument("--quick", action="store_true", help="study 5, one insertion, one start")
    parser.add_argument("--out", type=Path, default=Path("reports/adaptation.png"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    cases = ["5"] if options.quick else options.cases.split(",")
    effort = (1, RECIPE | {"starts": 1}) if options.quick else (4, RECIPE)
    rows = pd.concat([run_case(case, *effort) for case in cases], ignore_index=True)
    rows.to_csv(options.out.with_suffix(".csv"), index=False)
    values = rows[[*COLUMNS[1:], "tip_in_95", "tip_crps_mm"]].astype(float)
    means = values.groupby([rows["case"], rows["prior"], rows["n"]]).mean()
    print(means.to_string(float_format="%.3f"))
    size = (3.2 * len(cases), 2.8)
    figure, panels = plt.subplots(1, len(cases), figsize=size, squeeze=False, layout="constrained")
    for axes, case in zip(panels[0], cases, strict=True):
        for prior, colour in (("with", "#1b6ca8"), ("without", "#c0392b")):
            line, first = means.loc[(case, prior), "te_mm"], means.loc[(case, "with", 0), "te_mm"]
            within = (line <= line.iloc[-1] + MARGIN_MM)[::-1].cummin()
            needed = "none pays" if first <= line.iloc[-1] else within[within].index.min()
            print(f"study {case}, {prior} the old posterior: insertions needed: {needed}")
            axes.plot(line.index, line, "o-", ms=3, color=colour, label=f"{prior} the old posterior")
        axes.axhline(means.loc[case, "floor_te_mm"].mean(), color="0.5", lw=0.8, ls="--")
        axes.set(title=f"study {case}: {CASES[case][1]}", xlabel="new insertions", ylabel="mean TE (mm)")
    panels[0][0].legend(fontsize=7)
    figure.savefig(options.out, dpi=150)
    print(f"Figure: {options.out}")


if __name__ == "__main__":
    main()
