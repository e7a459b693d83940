"""Report of a verification: the table of checks, and the refinement studies."""

import math
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, plot
from needlefit.reporting.labels import CONVERGENCE_CAPTION, GREY, INK
from needlefit.reporting.number_format import MISSING, format_number, typeset
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Verdict
from needlefit.verification.check import AcceptanceBound, Group

_CASE_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", INK)  # Okabe and Ito
_CASE_MARKERS = "osD^vPX"
_CONVERGENCE_PANELS = (("deflection", 4, "error of the deflection (mm)"), ("slope", 3, "error of the slope"))


def draw_convergence(errors: pd.DataFrame, path: Path) -> Path:
    """Draw the largest error of deflection and slope over the mesh size, one line per case.

    `errors` has a row per `case`, `norm` and mesh size `h_mm`, with the `error` and the `order` observed.
    """
    return plot(path, errors, _paint_convergence)


def _paint_convergence(errors: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.9))
    panels = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    for axes, (norm, order, words) in zip(panels[:2], _CONVERGENCE_PANELS, strict=True):
        _draw_panel(axes, errors, norm, order)
        axes.set_title(words, loc="left")
        axes.set_xlabel("element size h (mm)")
    handles, labels = panels[0].get_legend_handles_labels()
    panels[2].axis("off")
    panels[2].legend(handles, labels, loc="center left", fontsize=6, handlelength=1.6, labelspacing=0.7)
    return figure


def _draw_panel(axes: Axes, errors: pd.DataFrame, norm: str, order: int) -> None:
    curves = errors[errors["norm"] == norm]
    sizes = curves["h_mm"].drop_duplicates().to_numpy(dtype=np.float64)
    for i, (case, curve) in enumerate(curves.groupby("case", sort=False)):
        style = {
            "color": _CASE_COLOURS[i % 7],
            "marker": _CASE_MARKERS[i % 7],
            "ms": 3.2,
            "mfc": "none",
            "lw": 0.8,
            "mew": 0.7,
        }
        axes.loglog(curve["h_mm"], curve["error"], label=_shorten_case(str(case)), **style)
    nodes = errors[errors["norm"] == f"{norm} at the nodes"]
    at_nodes = nodes.groupby("h_mm", sort=False)["error"].max().to_numpy(dtype=np.float64)
    axes.loglog(sizes, at_nodes, ".-", color=GREY, ms=3, lw=0.8, label="at the nodes, all")
    finest = float(curves.loc[curves["h_mm"] == sizes[-1], "error"].max())
    for error, slope in ((2.2 * finest, order), (at_nodes[-1] / 2.2, 4)):
        line = error * (sizes / sizes[-1]) ** slope
        axes.loglog(sizes, line, color=INK, lw=0.6, ls=(0, (4, 3)), zorder=1)
        axes.annotate(
            f"order {slope}", (sizes[1], line[1]), xytext=(0, 7 if error > finest else -9), color=INK,
            textcoords="offset points", ha="center", fontsize=6.5,
        )  # fmt: skip
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_tick_params(which="minor", size=0)
    axes.margins(x=0.12)


def _shorten_case(case: str) -> str:
    return case.replace(", ", ",\n", 1)


_COLUMNS = ("check", "quantity", "measured", "bound", "unit", "verdict")


def lay_out_verification(found: Run) -> list[TableLayout]:
    """Return the table, one part per group."""
    rows = [
        {
            **row,
            "measured": format_measured(row["measured"]),
            "bound": format_bound(AcceptanceBound(row["bound_low"], row["bound_high"])),
        }
        for row in to_records(found.frames["verification"])
    ]
    groups = {group.title: group for group in Group}
    return [_lay_out_group(groups[title], list(part)) for title, part in groupby(rows, itemgetter("group"))]


def lay_out_groups(found: Run) -> list[TableLayout]:
    """Return one table with a row for each group of checks."""
    rows = [
        {"group": title, "checks": len(part), "failed_checks": int((part["verdict"] == "FAILS").sum())}
        for title, part in found.frames["verification"].groupby("group", sort=False)
    ]
    return [Table("groups", "Checks by group.", rows, ("group", "checks", "failed_checks")).lay_out()]


def _lay_out_group(group: Group, rows: list[Row]) -> TableLayout:
    remarks = {str(row["check"]).split(":")[0]: row["note"] for row in reversed(rows) if row["note"]}
    checks = dict.fromkeys(str(row["check"]).split(":")[0] for row in rows)
    listed = "; ".join(f"{check}: {remarks[check]}" for check in checks if check in remarks)
    notes = (f"{listed}.",) if listed else ()
    caption = f"{group.title}. {group.explanation}"
    return Table(
        group.name.lower(), caption, rows, _COLUMNS, groups=("check",), heads=1, ruled=False, notes=notes
    ).lay_out()


def describe_outcome(found: Run) -> str:
    """Return the outcome in one sentence."""
    verdicts = found.frames["verification"]["verdict"]
    stated, failed = int((verdicts == "stated").sum()), int((verdicts == "FAILS").sum())
    judged = len(verdicts) - stated
    summary = f"{failed} of {judged} checks FAIL" if failed else f"All {judged} checks with a bound pass"
    return f"{summary}; {stated} quantities are reported without a bound." if stated else f"{summary}."


def judge(found: Run) -> list[Verdict]:
    """Return whether all rows with a bound pass."""
    verdicts = found.frames["verification"]["verdict"]
    numbers = {"rows": len(verdicts), "failed": int((verdicts == "FAILS").sum())}
    return [
        Verdict(describe_outcome(found).rstrip("."), "fail" if numbers["failed"] else "pass", "", numbers)
    ]


def summarize(found: Run) -> list[str]:
    """Return the outcome, and how it was measured."""
    rules = found.run["rules"]
    return [
        describe_outcome(found),
        f"needlefit verify --seed {found.run['study']['seed']}, on {found.run['machine']}: all values were "
        "measured by this run. Errors and differences are the largest found, at and between nodes. Default "
        f"options: constraint spacing {rules['spacing']:g} mm, elements of "
        f"{rules['element']:g} mm, Newton tolerance {typeset(format_number(rules['tolerance']))} mm.",
    ]


def draw_figures(found: Run, folder: Path) -> dict[str, Path]:
    """Draw the refinement studies, if there are any."""
    errors = found.frames["convergence"]
    return {"convergence": draw_convergence(errors, folder / "convergence.pdf")} if len(errors) else {}


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the table, and the refinement studies."""
    return [
        document.heading("Checks"),
        *(document.table(table) for table in lay_out_verification(found)),
        *(document.figure(path, CONVERGENCE_CAPTION) for path in figures.values()),
    ]


def verification_to_json(found: Run) -> dict[str, Any]:
    """Return the verification as JSON values."""
    rows, refinements = (to_records(found.frames[name]) for name in ("verification", "convergence"))
    about = {"seed": found.run["study"]["seed"], "summary": describe_outcome(found)}
    return {**about, "rows": rows, "refinements": refinements}


REPORT = StudyReport(
    summarize,
    lay_out_verification,
    draw_figures,
    compose_sections,
    to_json=verification_to_json,
    judge=judge,
    lay_out_first=lay_out_groups,
    headline=lambda fault: "",  # the verdict counts the checks that fail
)


def format_measured(value: float | None) -> str:
    """Return a measured value as text with three digits, including trailing zeros."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0 or 0.1 <= abs(value) < 100:
        return f"{value:#.3g}" if value else "0"
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    return typeset(f"{mantissa}e{int(exponent)}")


def format_bound(bound: AcceptanceBound) -> str:
    """Return a bound as text."""
    low, high = (typeset(format_number(value)) for value in (bound.low, bound.high))
    if low and high:
        return f"{low} to {high}"
    return f"≤ {high}" if high else f"≥ {low}" if low else MISSING
