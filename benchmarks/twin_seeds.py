"""The five studies over many twins: how every row of the validation table is distributed over seeds.

    python benchmarks/twin_seeds.py [--seeds 20] [--first 1] [--recipe default] [--out FILE] [--json]

Each seed draws another twin (noise, specimens, registration; the plan of insertions stays), on which all
five studies are tuned and validated. Printed per row: median and 5-95 % range over seeds of mean IPE and
TE, for the automatic fit, the paper's hand-tuned set (not tuned on this data) and that set with b alone
re-tuned; and on how many seeds the automatic fit is better than each. No win is required. The twin's b was
set from the paper's tables, so this is the twin's consistency, not evidence for the model.

`--out` keeps one line a seed as it is finished; a rerun with the same file goes on after the last one.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import pandas as pd

from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.study import StudyRecord
from needlefit.synthetic.build import build
from needlefit.validation.run import Settings, run
from needlefit.validation.summary import aggregate

STUDIES = ("study1", "study2", "study3", "study4", "study5")
RIVALS = ("fitted", "hand_tuned", "hand_tuned_b")
ROW = ["study", "medium", "layers"]


def one_seed(seed: int, recipe: str, jobs: int) -> pd.DataFrame:
    """Return the validation rows of all five studies on the twin of one seed."""
    parts = []
    with tempfile.TemporaryDirectory() as folder:
        dataset = build(Path(folder) / "twin", seed, jobs=jobs)
        for name in STUDIES:
            record = load(find("study", name), StudyRecord)
            record = record.model_copy(update={"dataset": str(dataset), "recipe": recipe})
            results = run(name, record, Settings(jobs=jobs))
            held_out = results.errors[
                (results.errors["role"] == "validate") & (results.errors["boundaries"] == "measured")
            ]
            table = aggregate(replace(results, errors=held_out), ["medium", "layers", "rival"])
            parts.append(table.assign(study=name, seed=seed))
    return pd.concat(parts, ignore_index=True)


def distribution(rows: pd.DataFrame) -> pd.DataFrame:
    """Return median and 5-95 % range of mean IPE and TE over seeds, by row and rival, and the fit's wins."""
    wide = rows[rows["rival"].isin(RIVALS)].set_index([*ROW, "seed", "rival"])
    lines = []
    for key, group in wide.groupby(level=ROW, sort=False):
        ipe = group["ipe_mean_mm"].unstack("rival")
        te = group["te_mm"].unstack("rival")
        for rival in RIVALS:
            line = dict(zip(ROW, key, strict=True)) | {"rival": rival, "seeds": len(ipe)}
            for name, values in (("ipe_mm", ipe[rival]), ("te_mm", te[rival])):
                line |= {f"{name}_{q:02d}": values.quantile(q / 100) for q in (5, 50, 95)}
            line["fit_better_ipe"] = int((ipe["fitted"] < ipe[rival]).sum()) if rival != "fitted" else None
            line["fit_better_te"] = int((te["fitted"] < te[rival]).sum()) if rival != "fitted" else None
            lines.append(line)
    wins = ["fit_better_ipe", "fit_better_te"]
    return pd.DataFrame(lines).astype(dict.fromkeys(wins, "Int64"))


def main() -> None:
    """Run the seeds that are missing and print the distribution."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--recipe", default="default")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    kept = arguments.out.read_text().splitlines() if arguments.out and arguments.out.exists() else []
    rows = [pd.DataFrame(json.loads(line)) for line in kept if line]
    done = {int(frame["seed"].iloc[0]) for frame in rows}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        if seed in done:
            continue
        rows.append(one_seed(seed, arguments.recipe, arguments.jobs))
        print(f"seed {seed} done", file=sys.stderr)
        if arguments.out:
            with arguments.out.open("a") as file:
                file.write(json.dumps(rows[-1].to_dict("list")) + "\n")
    table = distribution(pd.concat(rows, ignore_index=True))
    if arguments.json:
        print(table.to_json(orient="records", indent=2))
    else:
        print(table.to_string(index=False, float_format=lambda x: f"{x:.2f}"))


if __name__ == "__main__":
    main()
