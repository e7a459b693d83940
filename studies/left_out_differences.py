"""Do curves without mechanics predict left-out insertions as well as the fitted model?

    python studies/left_out_differences.py [STUDY] [--media NAME ...] [--quick] [--out FIGURE]

STUDY leaves insertions out (`leave_out`); by default it is `stereo_insertions`, each hole of measured needles
left out in turn, by both laws of advance. A left-out group is one trial. A method has its mean error of
left-out insertions, that minus the fitted model's, with its 95 % interval over trials (Student), and
on how many trials the model errs less. The table is kept beside the figure as CSV.

What came out (docs/real_needles.md): a straight line and a constant curvature are worse than the model; a
curvature linear or quadratic in arc length is neither better nor worse.
"""

import argparse
import math
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from scipy.special import stdtrit

import needlefit

STUDIES = Path(__file__).parent
MEDIA = {"stereo_insertions": ["gel_stereo", "gel_stereo_path_angle"]}
METRICS = ("ipe_mean_mm", "te_mm")


def compare_methods(errors: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each method and metric: its error and how far it is from the fit's, by trial (mm)."""
    held = errors[(errors["role"] == "validate") & (errors["boundaries"] == "measured")]
    rows = []
    for metric in METRICS:
        means = held.pivot_table(index="fold", columns="method", values=metric, sort=False)
        for method in held["method"].unique():
            gap = means[method] - means["fitted"]
            half = stdtrit(len(gap) - 1, 0.975) * gap.std() / math.sqrt(len(gap))
            rows.append(
                {
                    "metric": metric,
                    "method": method,
                    "error_mm": means[method].mean(),
                    "difference_mm": gap.mean(),
                    "low_mm": gap.mean() - half,
                    "high_mm": gap.mean() + half,
                    "model_better": int((gap > 0).sum()),
                    "trials": len(gap),
                }
            )
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Save the differences from the model with their intervals, a panel for each metric."""
    figure, panels = plt.subplots(1, len(METRICS), figsize=(9, 3), sharey=True)
    for axes, metric in zip(panels, METRICS, strict=True):
        others = table[(table["metric"] == metric) & (table["method"] != "fitted")]
        for number, (medium, rows) in enumerate(others.groupby("medium", sort=False)):
            at = [n + 0.2 * number for n in range(len(rows))]
            ends = [rows["difference_mm"] - rows["low_mm"], rows["high_mm"] - rows["difference_mm"]]
            axes.errorbar(rows["difference_mm"], at, xerr=ends, fmt="o", ms=3, label=medium)
            axes.set_yticks(range(len(rows)), rows["method"])
        axes.axvline(0, color="0.5", lw=0.8)
        axes.set(title=metric, xlabel="method minus model (mm)")
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", nargs="?", default="stereo_insertions")
    parser.add_argument("--media", nargs="+", help="tissue models (default: that of the study)")
    parser.add_argument("--quick", action="store_true", help="the recipe `quick`")
    parser.add_argument("--out", type=Path, default=Path("reports/left_out_differences.png"))
    options = parser.parse_args()
    study = tomllib.loads((STUDIES / f"{options.study}.toml").read_text())
    study |= {"recipe": "quick"} if options.quick else {}
    tables = []
    for medium in options.media or MEDIA.get(options.study, [study["medium"]]):
        run = needlefit.validate({**study, "medium": medium}, name=f"{options.study}-{medium}")
        tables.append(compare_methods(run.frames["errors"]).assign(medium=medium))
    table = pd.concat(tables, ignore_index=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(options.out.with_suffix(".csv"), index=False)
    draw(table, options.out)
    print(table.to_string(index=False, float_format="%.3f"))
    print(f"Figure: {options.out}, rows: {options.out.with_suffix('.csv')}")


if __name__ == "__main__":
    main()
