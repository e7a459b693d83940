"""Summarize a simulation-based calibration as a table of coverage and as sentences."""

from needlefit.reporting.number_format import format_symbol, insert_symbols
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.validation.calibration.quantities import DESIGN, FIT, LIKELIHOOD, TIP
from needlefit.validation.calibration.rank_statistics import (
    FAMILY_ERROR,
    LEVELS,
    RANK_DRAWS,
    single_check_error,
)
from needlefit.validation.calibration.replicate import UNDERSTATED_SD_FACTOR, Control
from needlefit.validation.calibration.run import Calibration

SCOPE_NOTE = (
    "This proves the computation, not the model: needles, errors and parameters were drawn from what the "
    "likelihood and the prior say of them. Whether the model holds, held-out coverage on other truths and on "
    "real needles says."
)
QUANTITY_NAMES = {
    DESIGN: "stiffest, of the design",
    FIT: "stiffest, at the fit",
    TIP: "tip of the deepest",
    LIKELIHOOD: "log likelihood",
}
CONTROL_NAMES: dict[Control, str] = {
    "sigma": f"noise and pose taken for {UNDERSTATED_SD_FACTOR} of what they were",
    "prior": "the prior returned as the posterior",
    "pose": "errors of the pose left out",
    "shuffled": "one insertion with another's shape, or on the wrong side",
}


def name_quantity(name: str) -> str:
    """Return the printed name of a ranked quantity."""
    return QUANTITY_NAMES.get(name, format_symbol(name).split(" (")[0])


def lay_out_calibration(found: Calibration) -> TableLayout:
    """Return one row per quantity: how many true values each central interval covered, and the range expected
    by chance.
    """
    tables = {name: list(rows) for name, rows in _group_by_quantity(to_records(found.coverage)).items()}
    outside = found.ecdfs[~found.ecdfs["passes"]].groupby("quantity").size()
    rows = tuple(
        (
            name_quantity(name),
            *(_interval_cell(row) for row in levels),
            f"{out} of {RANK_DRAWS} outside" if (out := int(outside.get(name, 0))) else "inside",
            "NO" if name in found.failing else "yes",
        )
        for name, levels in tables.items()
    )
    heads = (TableColumn(f"{100 * level:.0f} %") for level in LEVELS)
    columns = (text_column("Quantity"), *heads, text_column("ECDF of the ranks"), text_column("Calibrated"))
    note = (
        f"How often the central interval held the truth, and between which counts chance keeps it; ranks "
        f"among {RANK_DRAWS} draws. Each check may fail with probability "
        f"{single_check_error(len(rows)):.1e}, all "
        f"together with {FAMILY_ERROR:g} at most (Bonferroni). Stiffest: the combination of parameters that "
        f"the "
        "design, or the data at their fit, tell best."
    )
    return TableLayout("calibration", describe_figure(found), columns, rows, notes=(note,))


def describe_figure(found: Calibration) -> str:
    """Return the caption of table and figure."""
    wrong = f" A control: {CONTROL_NAMES[found.control]}." if found.control else ""
    cut = " INTERRUPTED." if found.interrupted else ""
    return f"Where the truth stood among draws of its posterior, {len(found.replicates)} times.{wrong}{cut}"


def summarize_calibration(found: Calibration) -> list[str]:
    """Return sentences: the outcome, the method, and the version and settings."""
    return [
        _describe_outcome(found),
        _describe_design(found),
        *_describe_computation(found),
        _describe_redrawn(found),
    ]


def _describe_outcome(found: Calibration) -> str:
    names = insert_symbols(", ".join(name_quantity(name) for name in found.failing))
    count = len(found.replicates)
    few = f"{count} replicate{' is' if count == 1 else 's are'} too few to tell"
    if found.control is not None:
        seen = f"is noticed, by {names}" if found.failing else "is NOT noticed"
        if not found.failing and not found.conclusive:
            seen = f"{few} whether it is noticed"
        return f"Control: {CONTROL_NAMES[found.control]}: {seen}."
    if found.failing:
        return f"NOT calibrated: {names}."
    if not found.conclusive:
        return f"{few} whether anything is wrong."
    return f"All {found.coverage['quantity'].nunique()} quantities are calibrated."


def _describe_design(found: Calibration) -> str:
    count = len(found.depths)
    shallow, deep = (f"{depth:.3g}" for depth in (min(found.depths), max(found.depths)))
    depth = f"{shallow} mm" if shallow == deep else f"{shallow} to {deep} mm"
    few = f" ({', '.join(found.insertions)})" if found.sampled else ""
    return (
        f"{len(found.replicates)} replicates of {count} insertion{'s' if count > 1 else ''}{few}, {depth} "
        "deep: parameters from their prior, needles simulated anew, errors of depths, pose and points as "
        "stated."
    )


def _describe_computation(found: Calibration) -> list[str]:
    """Return the method that computed the posteriors, and how many were not certified."""
    count = len(found.replicates)
    by = found.replicates["draw_source"].value_counts().to_dict()
    parts = [f"{one} by {who} ({100 * one / count:.1f} %)" for who, one in by.items()]
    lines = [f"Posteriors: {', '.join(parts)}; none was left out."]
    if found.untrusted and found.control is None:
        lines.append(f"{found.untrusted} of them NOT CONVERGED: they count as they are.")
    return lines


def _describe_redrawn(found: Calibration) -> str:
    again = int(found.replicates["redrawn"].sum())
    drawn = again + len(found.replicates)
    return f"{again} of {drawn} parameter sets drawn from the prior have no solution, and were drawn again."


def _interval_cell(row: Row) -> str:
    mark = "" if row["passes"] else " !"
    return f"{row['covered']} ({row['count_low']}–{row['count_high']}){mark}"


def _group_by_quantity(rows: list[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(str(row["quantity"]), []).append(row)
    return found
