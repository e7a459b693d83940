"""Write the README's table of the five studies from their stored results in reports/reference.

python docs/readme_results.py
"""

import re
from pathlib import Path

import pandas as pd

from needlefit.studies.judge import REFERENCES, compare_with_references
from needlefit.studies.run import PREDICTION_METHOD

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "README.md"
MARKS = re.compile(r"(?<=<!-- result:begin -->\n).*?(?=<!-- result:end -->)", re.DOTALL)
#: columns of our errors, and how they are printed; in brackets the paper's
ERRORS = {
    "te_mm": ("TE", ".2f"),
    "ipe_mean_mm": ("IPE", ".2f"),
    "ipe_max_mm": ("largest IPE", ".2f"),
    "median_err_mm": ("median IPE", ".2f"),
    "edp_percent": ("EDP, %", ".3g"),
}
NAMES = [name for name, _ in ERRORS.values()]
COLUMNS = (
    *("study", "held out", "n", "verdict", *NAMES),
    *("TE of a straight line", "of constant curvature", "noise floor"),
)
HEAD = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}\n"


def write_table() -> str:
    """Return the rows of all held-out groups, as the paper counts their layers.

    The verdict is on all insertions of a study together: before several groups stands a row of these.
    """
    lines = []
    for study in range(1, 6):
        folder = ROOT / f"reports/reference/study{study}"
        errors, cells = (pd.read_csv(folder / f"{name}.csv") for name in ("errors", "validation"))
        held_out = errors[(errors["boundaries"] == "measured") & (errors["role"] == "validate")]
        groups = cells[(cells["boundaries"] == "measured") & (cells["grouping"] == "held_out")]
        ours = groups[groups["method"] == PREDICTION_METHOD].groupby(["medium", "layers"], sort=False)
        several = len(ours) > 1
        if several:
            lines.append(write_row(study, "all", held_out, has_verdict=True))
        for (medium, layers), group in ours:
            inside = held_out[(held_out["medium"] == medium) & (held_out["layers"] == layers)]
            name = re.sub(r"(?<=phantom)(?=\d)", " ", str(medium))
            name += f", {layers} layer{'' if layers == 1 else 's'}"
            paper = group.set_index("metric")["paper"]
            lines.append(write_row(study, name, inside, has_verdict=not several, paper=paper))
    return HEAD + "".join(lines)


def write_row(
    study: int, name: str, errors: pd.DataFrame, *, has_verdict: bool, paper: "pd.Series[float] | None" = None
) -> str:
    """Return the row of some held-out insertions: our errors, the references', the paper's."""
    means = errors.groupby("method")[[*ERRORS, "floor_te_mm"]].mean()
    ours = means.loc[PREDICTION_METHOD]
    found = compare_with_references(errors, PREDICTION_METHOD, ours["floor_te_mm"])
    row = [
        *(study, name, errors["insertion"].nunique(), found.outcome if has_verdict else ""),
        *(
            format(ours[key], digits) + ("" if paper is None else f" ({paper[key]:{digits}})")
            for key, (_, digits) in ERRORS.items()
        ),
        *(f"{means.loc[one, 'te_mm']:.2f}" for one in REFERENCES),
        f"{ours['floor_te_mm']:.2f}",
    ]
    return f"| {' | '.join(map(str, row))} |\n"


def write_page() -> str:
    """Return the README with the present results."""
    return MARKS.sub(lambda _: write_table(), PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(write_page(), encoding="utf-8")
