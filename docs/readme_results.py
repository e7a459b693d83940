"""Write the README's table of the five studies from their stored results in reports/reference.

python docs/readme_results.py
"""

import re
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "README.md"
MARKS = re.compile(r"(?<=<!-- result:begin -->\n).*?(?=<!-- result:end -->)", re.DOTALL)
HEAD = """\
| study | held out | n | our IPE | our TE | noise floor of TE | paper's IPE | paper's TE |
|---|---|---|---|---|---|---|---|
"""


def write_table() -> str:
    """Return the rows of all held-out groups, as the paper counts their layers."""
    frames = [pd.read_csv(ROOT / f"reports/reference/study{n}/validation.csv") for n in range(1, 6)]
    cells = pd.concat(frames)
    ours = cells[(cells["method"] == "fitted") & (cells["boundaries"] == "measured")]
    ours = ours[(ours["grouping"] == "held_out") & ~ours["alternate_count"]]
    lines = []
    for (study, medium, layers), group in ours.groupby(["study", "medium", "layers"], sort=False):
        by = group.set_index("metric")
        medium = re.sub(r"(?<=phantom)(?=\d)", " ", str(medium))
        numbers = [
            by["value"]["ipe_mean_mm"], by["value"]["te_mm"], by["floor"]["te_mm"],
            by["paper"]["ipe_mean_mm"], by["paper"]["te_mm"],
        ]  # fmt: skip
        held_out = f"{medium}, {layers} layer{'' if layers == 1 else 's'}"
        row = [study, held_out, by["insertions"]["te_mm"], *(f"{one:.2f}" for one in numbers)]
        lines.append(f"| {' | '.join(map(str, row))} |\n")
    return HEAD + "".join(lines)


def write_page() -> str:
    """Return the README with the present results."""
    return MARKS.sub(lambda _: write_table(), PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(write_page(), encoding="utf-8")
