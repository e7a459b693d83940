"""How much do the paper's tables depend on the rules of the model?

    python studies/sensitivity.py [--studies study1,study3] [--quick] [--out reports/sensitivity.png]

Each study is tuned and scored again under other rules: which layer a constraint cell at a boundary belongs to
(tie), the direction of advance, the spacing of the constraint points and where the first one is, and the
thickness of the tissue. b belongs to its spacing and its rule of advance: parameters are fitted again, never
carried over. The data follow the rules as they are: this shows how much a rule matters, not which is right.

The direction of advance matters most: 4 noise floors of study 3's tip error. Study 5 depends on no rule.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from research.fits import score_study

from needlefit.api import load_medium

STUDIES = {
    **{f"study{n}": "phantom2" for n in (1, 2, 3, 4)},
    "study5": "chicken",
}  #: with their tissue models
METRICS = {"ipe_mean_mm": "mean IPE", "te_mm": "TE"}
RULES = {
    "as decided": {},
    "tie: cells belong to the point ahead": {"constraint_switch": 0.0},
    "tie: cells belong to the point behind": {"constraint_switch": 1.0},
    "advance: along half of the slope": {"tangent_part": 0.5},
    "advance: a shift in x": {"tangent_part": 0.0},
    "constraint spacing 0.5 mm": {"constraint_spacing_mm": 0.5},
    "constraint spacing 2 mm": {"constraint_spacing_mm": 2.0},
    "first cell always whole": {"first_cell_mm": 1.0},
    "first constraint at 0.25 mm": {"first_cell_mm": 0.25},
    "first constraint at 0.5 mm": {"first_cell_mm": 0.5},
    "first constraint at 0.75 mm": {"first_cell_mm": 0.75},
    "thickness 20 mm": {"thickness_mm": 20.0},
    "thickness 80 mm": {"thickness_mm": 80.0},
}


def score(study: str, name: str, starts: int) -> dict:
    """Return the mean errors of held-out insertions, and their noise floors, mm."""
    medium = load_medium(STUDIES[study]) | RULES[name]
    found = score_study(study, medium=medium, recipe={"starts": starts, "metric": False})
    held_out = found.query("role == 'validate' and method == 'fitted'")
    columns = [column for metric in METRICS for column in (metric, f"floor_{metric}")]
    return {"study": study, "rules": name, **held_out[columns].mean().to_dict()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", default=",".join(STUDIES))
    parser.add_argument("--quick", action="store_true", help="study 5 under two other rules, one start")
    parser.add_argument("--out", type=Path, default=Path("reports/sensitivity.png"))
    options = parser.parse_args()
    studies = ["study5"] if options.quick else options.studies.split(",")
    names = list(RULES)[:5:2] if options.quick else list(RULES)
    rows = []
    for name in names:
        rows += [score(study, name, 1 if options.quick else 4) for study in studies]
        print(f"{name}: done", flush=True)
    frame = pd.DataFrame(rows).set_index(["rules", "study"])
    base = frame.loc["as decided"]
    changes = pd.DataFrame(
        {
            label: frame[metric] - base[metric].reindex(frame.index, level="study")
            for metric, label in METRICS.items()
        }
    )
    floors = pd.DataFrame(
        {
            label: changes[label] / base[f"floor_{metric}"].reindex(frame.index, level="study")
            for metric, label in METRICS.items()
        }
    )
    print("Held-out errors under the rules as decided, mm:")
    print(base.to_string(float_format="%.3f"))
    print("Changes under other rules, mm:")
    table = changes.unstack("study").reindex(list(dict.fromkeys(frame.index.get_level_values("rules"))))
    print(table.drop("as decided").to_string(float_format="%+.2f"))
    largest = floors.abs().max(axis=1).groupby(level="rules").max().drop("as decided").sort_values()
    print("Largest change of a mean, in noise floors:")
    print(largest[::-1].to_string(float_format="%.1f"))
    figure, axes = plt.subplots(figsize=(6, 1 + 0.25 * len(largest)), layout="constrained")
    for study in studies:
        own = floors.xs(study, level="study")["TE"].reindex(largest.index)
        axes.plot(own, range(len(own)), "o", ms=4, alpha=0.8, label=study)
    axes.axvspan(-1, 1, color="0.92")
    axes.set(xlabel="change of the mean held-out TE (noise floors)", yticks=range(len(largest)))
    axes.set_yticklabels(largest.index)
    axes.legend(fontsize=7)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=150)
    print(f"Figure: {options.out}")


if __name__ == "__main__":
    main()
