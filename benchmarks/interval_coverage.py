"""How often do the intervals that are printed contain what they are of? The table of docs/calibration.md.

    python benchmarks/interval_coverage.py [--datasets 20] [--quick] [--out reports/interval_coverage.csv]

Intervals of held-out tips, shapes and parameters are those of the kept rows of
`studies/calibration_synthetic.py`.
For the others each study is fitted to synthetic datasets of its own, with tissues, specimens and needle drawn
anew. Then the deepest held-out insertion is predicted as a planned one, a path is planned to a target beside
it, tried with the specimen's true moduli and bevel, and, in a new specimen, its tip is added to the fit.
Needles of one fit are one trial. Rows are kept; a run that was stopped goes on there.
"""

import argparse
import sys
import tomllib
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

sys.path.append(str(Path(__file__).resolve().parents[1] / "studies"))

from synthetic import make_twin
from synthetic.design import POPULATION, draw_specimen

import needlefit
from needlefit import Run
from needlefit.datasets.first_study import describe_scene
from needlefit.errors import NeedlefitError
from needlefit.inference.forward_model import ParameterDraws
from needlefit.inference.proportion import wilson_interval
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.planning.goals import Goal, find_hits
from needlefit.planning.steering import plan_steering
from needlefit.project.locate import find_file
from needlefit.viewer.opening import open_target

SEED, LEVELS, TARGET_RADIUS_MM = 7800, (50, 95), 1.0
MEDIA = {"study2": ["phantom2"], "study3": ["phantom1", "phantom2"], "study5": ["chicken"]}
KEPT = Path(__file__).parent.parent / "docs/figures/calibration_synthetic.csv"
#: quantities of its rows that are no parameters, and what they are called
HELD_OUT = {
    "held-out tip": "held-out tip",
    "simultaneous band": "shape, simultaneous band",
    "pointwise band": "shape, pointwise band",
}
PLAN = "target reached by `plan`"


def read_calibration() -> pd.DataFrame:
    """Return the kept rows of studies/calibration_synthetic.py: of a truth the share covered."""
    kept = pd.read_csv(KEPT)
    kept["interval"] = kept["quantity"].map(HELD_OUT).fillna("parameter")
    kept = kept.melt(
        ["study", "seed", "interval", "width_mm"], [f"in_{one}" for one in LEVELS], "level", "covered"
    )
    kept["level"] = kept["level"].str.removeprefix("in_").astype(int)
    keys = ["interval", "study", "seed", "level"]
    return kept.groupby(keys, as_index=False)[["covered", "width_mm"]].mean()


def test_study(study: str, seed: int, folder: str) -> list[dict]:
    """Return the rows of one dataset, which is written to a folder."""
    twin = make_twin(f"{folder}/twin", seed, MEDIA[study], population=True)
    settings = {"dataset": twin, "recipe": {"metric": False}, "seed": seed}
    run = needlefit.validate(study, **settings)
    predictive = run.frames["predictive"]
    rows = []
    promised = predictive.dropna(subset="tip_95_width_after_one_mm")
    row = (promised if len(promised) else predictive).sort_values("depth_mm").iloc[-1]
    insertion = next(one for one in twin.insertions if one.id == row["insertion"])
    scene = describe_scene(twin, insertion, run.metadata.medium.advance)
    where = "same" if row["specimen_treatment"] == "same" else "new"
    tip, y = needlefit.predict(run, scene, where).frames["forecast"].iloc[-1], insertion.points[-1, 1]
    for level in LEVELS:
        low, high = tip[f"needle_{level}_low_mm"], tip[f"needle_{level}_high_mm"]
        about = {"interval": "planned tip, by `predict`", "level": level, "width_mm": high - low}
        rows.append({**about, "covered": low <= y <= high})
    run.save(f"{folder}/run")
    rows += try_plan(row, f"{folder}/run/{row['insertion']}", seed)
    return rows + (add_tip(study, row, run, settings) if len(promised) else [])


def try_plan(row: pd.Series, target: str, seed: int) -> list[dict]:
    """Return the probability of a plan to 1 mm beside the predicted tip, and whether the true needle hits."""
    started = open_target(target, specimen="planned").begin_insertion()
    goal = Goal((row["depth_mm"] - 2.0, row["tip_median_mm"] + 1.0), TARGET_RADIUS_MM)
    plan = plan_steering(started, goal, threads=1)
    specimen = draw_specimen(seed, row["medium"], row["specimen"], POPULATION)
    mu, shape = specimen.mu[: len(started.tissue.mu)], started.tissue.shape
    true, steps = ParameterDraws(mu[None], shape[None], np.array([specimen.bevel])), plan.steps
    batch = true.make_batch(started.needle, started.tissue, (*started.path, *steps), started.rules)
    tips = compute_batch_positions(simulate_batches([batch], threads=1)[0], np.array([steps[-1].depth]))
    hit = float(find_hits(tips[:, :, :2], plan.goal)[0])
    return [{"interval": PLAN, "level": 100 * plan.probability, "covered": hit}]


def add_tip(study: str, row: pd.Series, run: Run, settings: dict) -> list[dict]:
    """Return how other tips fall into intervals of the promised width about the medians of a new fit."""
    errors, others = run.frames["errors"], run.frames["predictive"]
    known = [*errors[errors["role"] == "tune"]["insertion"].unique(), row["insertion"]]
    alike = (others["specimen"] == row["specimen"]) & (others["layers"] == row["layers"])
    alike &= others["insertion"] != row["insertion"]
    keys = tomllib.loads(find_file("study", study).read_text(encoding="utf-8"))
    parts = {"tune": {"insertions": known}, "validate": [{"insertions": list(others[alike]["insertion"])}]}
    again = needlefit.validate(keys | parts, **settings).frames["predictive"]
    width = row["tip_95_width_after_one_mm"]
    inside = (again["tip_measured_mm"] - again["tip_median_mm"]).abs() <= width / 2
    about = {"interval": "tip, one more tip measured", "level": 95, "width_mm": width}
    return [{**about, "covered": inside.mean()}]


def write_share(covered: pd.Series) -> str:
    """Return a mean over trials with Wilson's 95 % interval, in percent."""
    if covered.empty:
        return "–"
    low, high = wilson_interval(float(covered.mean()), len(covered))
    return f"{100 * covered.mean():.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"


def tabulate(rows: pd.DataFrame) -> str:
    """Return two tables as Markdown: a row for each interval and study, and one for each study's plans."""
    lines = ["| interval of | study | in 50 % | in 95 % | width of 95 %, mm | trials |", f"|{'---|' * 6}"]
    planned = rows["interval"] == PLAN
    for (name, study), some in rows[~planned].groupby(["interval", "study"], sort=False):
        own = [some[some["level"] == level] for level in LEVELS]
        shares, width = [write_share(one["covered"]) for one in own], own[-1]["width_mm"].median()
        cells = [*shares, "" if np.isnan(width) else f"{width:.1f}", str(len(own[-1]))]
        lines.append(f"| {name} | {study.removeprefix('study')} | {' | '.join(cells)} |")
    lines += ["", "| plans, study | stated on average | reached | trials |", f"|{'---|' * 4}"]
    for study, some in rows[planned].groupby("study", sort=False):
        cells = [f"{some['level'].mean():.0f} %", write_share(some["covered"]), str(len(some))]
        lines.append(f"| {study.removeprefix('study')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--datasets", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="two datasets, study 5")
    parser.add_argument("--out", type=Path, default=Path("reports/interval_coverage.csv"))
    options = parser.parse_args()
    studies, count = (["study5"], 2) if options.quick else (list(MEDIA), options.datasets)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = pd.read_csv(options.out) if options.out.is_file() else pd.DataFrame({"study": [], "seed": []})
    seed, done = SEED, dict.fromkeys(studies, 0)
    while min(done.values()) < count:
        for study in (one for one in studies if done[one] < count):
            if not ((rows["study"] == study) & (rows["seed"] == seed)).any():
                with TemporaryDirectory() as folder, suppress(NeedlefitError):  # needles without a solution
                    found = pd.DataFrame(test_study(study, seed, folder)).astype({"covered": float})
                    rows = pd.concat([rows, found.assign(study=study, seed=seed)], ignore_index=True)
                    rows.to_csv(options.out, index=False)
            done[study] = rows.loc[rows["study"] == study, "seed"].nunique()
        seed += 1
        print(f"datasets: {done}", flush=True)
    order = {name: place for place, name in enumerate((*HELD_OUT.values(), "parameter"))}
    stored = read_calibration().sort_values("interval", key=lambda names: names.map(order), kind="stable")
    print(tabulate(pd.concat([stored, rows], ignore_index=True)))


if __name__ == "__main__":
    main()
