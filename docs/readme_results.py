"""Write the README's table of the five studies from their stored results in reports/reference.

python docs/readme_results.py
"""

import re
from pathlib import Path

import pandas as pd

from needlefit.inference.baselines import BASELINES
from needlefit.studies.fit_frames import MEDIAN_METHOD
from needlefit.studies.judge import describe_fit

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "README.md"
MARKS = re.compile(r"(?<=<!-- result:begin -->\n).*?(?=<!-- result:end -->)", re.DOTALL)
HEAD = """\
| study | held out | n | verdict | our TE | curve's TE | noise floor | our IPE | paper's TE | paper's IPE |
|---|---|---|---|---|---|---|---|---|---|
"""


def write_table() -> str:
    """Return the rows of all held-out groups, as the paper counts their layers."""
    frames = [pd.read_csv(ROOT / f"reports/reference/study{n}/validation.csv") for n in range(1, 6)]
    cells = pd.concat(frames)
    cells = cells[(cells["boundaries"] == "measured") & (cells["grouping"] == "held_out")]
    lines = []
    for (study, medium, layers), group in cells.groupby(["study", "medium", "layers"], sort=False):
        by = group[group["method"] == MEDIAN_METHOD].set_index("metric")
        curves = group[group["method"].isin(BASELINES.names()) & (group["metric"] == "te_mm")]
        curve = curves.loc[curves["value"].idxmin()]
        medium = re.sub(r"(?<=phantom)(?=\d)", " ", str(medium))
        ours = by["value"]
        held_out = f"{medium}, {layers} layer{'' if layers == 1 else 's'}"
        best = f"{curve['value']:.2f} ({BASELINES[curve['method']].label})"
        numbers = (
            by["floor"]["te_mm"],
            ours["ipe_mean_mm"],
            by["paper"]["te_mm"],
            by["paper"]["ipe_mean_mm"],
        )
        count, verdict = by["insertions"]["te_mm"], describe_study(study)
        row = [
            study,
            held_out,
            count,
            verdict,
            f"{ours['te_mm']:.2f}",
            best,
            *(f"{one:.2f}" for one in numbers),
        ]
        lines.append(f"| {' | '.join(map(str, row))} |\n")
    return HEAD + "".join(lines)


def describe_study(study: int) -> str:
    """Return the verdict on all insertions that a study held out, together."""
    errors = pd.read_csv(ROOT / f"reports/reference/study{study}/errors.csv")
    held_out = errors[(errors["boundaries"] == "measured") & (errors["role"] == "validate")]
    means = held_out.groupby("method")[["te_mm", "floor_te_mm"]].mean()
    ours, floor = means.loc[MEDIAN_METHOD]
    return describe_fit(ours, ours / floor, means.loc[means.index.isin(BASELINES.names()), "te_mm"].min())


def write_page() -> str:
    """Return the README with the present results."""
    return MARKS.sub(lambda _: write_table(), PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(write_page(), encoding="utf-8")
