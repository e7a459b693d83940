"""The table of `needlefit verify`: for the screen, as files, and as a page."""

import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.mechanics.control import ModelOptions
from needlefit.project.atomic_write import replace_folder
from needlefit.reporting.captions import CONVERGENCE
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import by_name, set_page
from needlefit.reporting.figures.convergence import convergence
from needlefit.reporting.files import write_csv, write_json
from needlefit.reporting.numbers import MISSING, number, typeset
from needlefit.validation.provenance import package_versions
from needlefit.verification.check import AcceptanceBound, CheckRow
from needlefit.verification.run import Verification

_PACKAGES = ("numpy", "scipy", "numba")


def layouts(verification: Verification) -> list[Display]:
    """Return the table, one part per group."""
    parts = []
    for group, rows in groupby(verification.rows, key=lambda row: row.group):
        shown = list(rows)
        cells = [_cells(row, before) for row, before in zip(shown, [None, *shown], strict=False)]
        columns = (
            text("Check"),
            text("Quantity"),
            Column("Measured"),
            Column("Bound"),
            text("Unit"),
            text("Verdict"),
        )
        remarks = "; ".join(f"{row.title.split(':')[0]}: {row.remark}" for row in _remarked(shown))
        notes = (f"{remarks}.",) if remarks else ()
        caption = f"{group.title}. {group.explanation}"
        parts.append(Display(group.name.lower(), caption, columns, tuple(cells), notes=notes))
    return parts


def summary(verification: Verification) -> str:
    """Return the outcome in a sentence."""
    judged = [row for row in verification.rows if row.verdict != "stated"]
    failed = len(verification.failed)
    said = f"{failed} of {len(judged)} rows FAIL" if failed else f"All {len(judged)} rows with a bound pass"
    stated = len(verification.rows) - len(judged)
    return f"{said}; {stated} are stated without one." if stated else f"{said}."


def table(verification: Verification) -> list[dict[str, Any]]:
    """Return the rows for machines, in the units that they name."""
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


def refinements(verification: Verification) -> list[dict[str, Any]]:
    """Return every error of the refinement studies, with the order observed since the mesh size before."""
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
        rows, studies = table(verification), refinements(verification)
        write_csv(pd.DataFrame(rows), new / "verification.csv")
        write_json(new / "verification.json", {"summary": summary(verification), "rows": rows})
        write_json(new / "run.json", provenance(verification))
        write_json(new / "timing.json", timing)
        pictures = list[Path]()
        if studies:
            pictures = [convergence(pd.DataFrame(studies), new / "convergence.pdf")]
        (new / "report.pdf").write_bytes(
            set_page("verification.typ", _payload(verification, pictures), by_name(pictures))
        )


def provenance(verification: Verification) -> dict[str, Any]:
    """Return what a reader needs to repeat the table: versions, seed and rules; no time and no path."""
    return {
        "name": "verification",
        "versions": package_versions(_PACKAGES),
        "machine": platform.machine(),
        "seed": verification.seed,
        "rules": asdict(ModelOptions()),
        "failed": len(verification.failed),
    }


def _payload(verification: Verification, pictures: Sequence[Path]) -> dict[str, Any]:
    about = provenance(verification)
    used = ", ".join(f"{name} {number}" for name, number in about["versions"].items())
    rules = about["rules"]
    return {
        "title": "Verification of the solver",
        "summary": summary(verification),
        "failed": bool(verification.failed),
        "produced": f"needlefit verify --seed {verification.seed}, with {used}, on {about['machine']}. "
        "Every figure was measured by this run; none is stored. Errors and differences are the largest "
        f"found, at and between nodes. Default rules: constraint spacing {rules['spacing']:g} mm, elements "
        f"of {rules['element']:g} mm, Newton tolerance {typeset(number(rules['tolerance']))} mm.",
        "columns": [column.label for column in layouts(verification)[0].columns],
        "groups": [
            {"caption": part.caption, "rows": part.rows, "notes": part.notes}
            for part in layouts(verification)
        ],
        "figure": pictures[0].name if pictures else None,
        "caption": CONVERGENCE,
        "version": about["versions"]["needlefit"],
    }


def _cells(row: CheckRow, before: CheckRow | None) -> tuple[str, ...]:
    begins = before is None or before.title != row.title
    same = not begins and before is not None and before.group is row.group
    return (
        "" if same else row.title,
        row.quantity,
        measured_said(row.measured),
        bound_said(row.bound),
        row.unit,
        row.verdict,
    )


def measured_said(value: float) -> str:
    """Return a measured value with three digits, trailing zeros among them."""
    if not math.isfinite(value):
        return MISSING
    if value == 0.0 or 0.1 <= abs(value) < 100:
        return f"{value:#.3g}" if value else "0"
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    return typeset(f"{mantissa}e{int(exponent)}")


def bound_said(bound: AcceptanceBound) -> str:
    """Return a bound as print has it."""
    low, high = (typeset(number(value)) for value in (bound.low, bound.high))
    if low and high:
        return f"{low} to {high}"
    return f"≤ {high}" if high else f"≥ {low}" if low else MISSING


def _remarked(rows: list[CheckRow]) -> list[CheckRow]:
    first = {row.title: row for row in reversed(rows) if row.remark}
    return [first[title] for title in dict.fromkeys(row.title for row in rows) if title in first]
