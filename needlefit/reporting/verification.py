"""The table of `needlefit verify`: for the screen, as files, and as a page with its convergence figure."""

import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from needlefit.mechanics.control import ModelOptions
from needlefit.project.atomic_write import replace_folder
from needlefit.reporting.document import compile_template, key_by_file_name
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, plot
from needlefit.reporting.labels import CONVERGENCE_CAPTION, GREY, INK
from needlefit.reporting.number_format import MISSING, format_number, typeset
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.validation.provenance import package_versions
from needlefit.verification.check import AcceptanceBound, CheckRow
from needlefit.verification.run import Verification

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


_PACKAGES = ("numpy", "scipy", "numba")


def lay_out_verification(verification: Verification) -> list[TableLayout]:
    """Return the table, one part per group."""
    parts = []
    for group, rows in groupby(verification.rows, key=lambda row: row.group):
        shown = list(rows)
        cells = [_check_cells(row, before) for row, before in zip(shown, [None, *shown], strict=False)]
        columns = (
            text_column("Check"),
            text_column("Quantity"),
            TableColumn("Measured"),
            TableColumn("Bound"),
            text_column("Unit"),
            text_column("Verdict"),
        )
        remarks = "; ".join(f"{row.title.split(':')[0]}: {row.remark}" for row in _rows_with_remarks(shown))
        notes = (f"{remarks}.",) if remarks else ()
        caption = f"{group.title}. {group.explanation}"
        parts.append(TableLayout(group.name.lower(), caption, columns, tuple(cells), notes=notes))
    return parts


def summarize_verification(verification: Verification) -> str:
    """Return the outcome in one sentence."""
    judged = [row for row in verification.rows if row.verdict != "stated"]
    failed = len(verification.failed)
    summary = (
        f"{failed} of {len(judged)} rows FAIL" if failed else f"All {len(judged)} rows with a bound pass"
    )
    stated = len(verification.rows) - len(judged)
    return f"{summary}; {stated} are stated without one." if stated else f"{summary}."


def tabulate_verification(verification: Verification) -> list[dict[str, Any]]:
    """Return the rows for the CSV file, in the units that they name."""
    return [
        {
            "group": row.group.title,
            "check": row.title,
            "quantity": row.quantity,
            "measured": row.measured,
            "bound_low": row.bound.low,
            "bound_high": row.bound.high,
            "unit": row.unit,
            "verdict": row.verdict,
            "remark": row.remark,
        }
        for row in verification.rows
    ]


def tabulate_refinements(verification: Verification) -> list[dict[str, Any]]:
    """Return every error of the refinement studies, with the observed order from one mesh size to
    the next.
    """
    rows: list[dict[str, Any]] = []
    for curve in verification.curves:
        for norm, errors in curve.errors.items():
            orders = [None, *curve.orders(norm)]
            rows += [
                {"case": curve.case, "norm": norm, "h_mm": h, "error": error, "order": order}
                for h, error, order in zip(curve.h, errors, orders, strict=True)
            ]
    return rows


def write_verification(verification: Verification, folder: Path, timing: Mapping[str, Any]) -> None:
    """Write table, refinement studies, figure and report to `folder`, replacing an earlier result there.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        rows, studies = tabulate_verification(verification), tabulate_refinements(verification)
        write_csv(pd.DataFrame(rows), new / "verification.csv")
        write_json(new / "verification.json", {"summary": summarize_verification(verification), "rows": rows})
        write_json(new / "run.json", verification_provenance(verification))
        write_json(new / "timing.json", timing)
        pictures = list[Path]()
        if studies:
            pictures = [draw_convergence(pd.DataFrame(studies), new / "convergence.pdf")]
        (new / "report.pdf").write_bytes(
            compile_template("verification.typ", _payload(verification, pictures), key_by_file_name(pictures))
        )


def verification_provenance(verification: Verification) -> dict[str, Any]:
    """Return the provenance of the table: versions, seed and rules; without times or paths."""
    return {
        "name": "verification",
        "versions": package_versions(_PACKAGES),
        "machine": platform.machine(),
        "seed": verification.seed,
        "rules": asdict(ModelOptions()),
        "failed": len(verification.failed),
    }


def _payload(verification: Verification, pictures: Sequence[Path]) -> dict[str, Any]:
    about = verification_provenance(verification)
    used = ", ".join(f"{name} {number}" for name, number in about["versions"].items())
    rules = about["rules"]
    return {
        "title": "Verification of the solver",
        "summary": summarize_verification(verification),
        "failed": bool(verification.failed),
        "produced": f"needlefit verify --seed {verification.seed}, with {used}, on {about['machine']}. "
        "Every figure was measured by this run; none is stored. Errors and differences are the largest "
        f"found, at and between nodes. Default rules: constraint spacing {rules['spacing']:g} mm, elements "
        f"of {rules['element']:g} mm, Newton tolerance {typeset(format_number(rules['tolerance']))} mm.",
        "columns": [column.label for column in lay_out_verification(verification)[0].columns],
        "groups": [
            {"caption": part.caption, "rows": part.rows, "notes": part.notes}
            for part in lay_out_verification(verification)
        ],
        "figure": pictures[0].name if pictures else None,
        "caption": CONVERGENCE_CAPTION,
        "version": about["versions"]["needlefit"],
    }


def _check_cells(row: CheckRow, before: CheckRow | None) -> tuple[str, ...]:
    begins = before is None or before.title != row.title
    same = not begins and before is not None and before.group is row.group
    return (
        "" if same else row.title,
        row.quantity,
        format_measured(row.measured),
        format_bound(row.bound),
        row.unit,
        row.verdict,
    )


def format_measured(value: float) -> str:
    """Return a measured value as text with three digits, including trailing zeros."""
    if not math.isfinite(value):
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


def _rows_with_remarks(rows: list[CheckRow]) -> list[CheckRow]:
    first = {row.title: row for row in reversed(rows) if row.remark}
    return [first[title] for title in dict.fromkeys(row.title for row in rows) if title in first]
