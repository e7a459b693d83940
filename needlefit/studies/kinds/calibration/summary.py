"""Summarize a simulation-based calibration as a table of coverage and as sentences."""

from collections.abc import Mapping
from typing import Any

from needlefit.reporting.number_format import format_bare_symbol, insert_symbols
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.calibration.quantities import DESIGN, FIT, LIKELIHOOD, TIP
from needlefit.studies.kinds.calibration.replicate import UNDERSTATED_SD_FACTOR
from needlefit.studies.kinds.calibration.schema import Control
from needlefit.studies.kinds.calibration.synthetic_truth import HELD_OUT_TIP
from needlefit.studies.rank_statistics import (
    FAMILY_ERROR,
    LEVELS,
    RANK_DRAWS,
    single_check_error,
)
from needlefit.studies.run import Run
from needlefit.studies.verdict import Status, Verdict, headline_fault

SCOPE_NOTE = (
    "This tests the computation, not the model: needles, errors and parameters were drawn from the "
    "likelihood and the prior. Held-out coverage on other truths and on real needles tests the model."
)
SYNTHETIC_SCOPE_NOTE = (
    "This tests model and measurement together: the truth has friction, layers that differ between specimens "
    "and a needle stiffness other than stated, which the fitted model does not contain. The truth is another "
    "model, not tissue; measured needles are stronger evidence."
)
QUANTITY_NAMES = {
    HELD_OUT_TIP: "held-out tips",
    DESIGN: "stiffest, of the design",
    FIT: "stiffest, at the fit",
    TIP: "tip of the deepest",
    LIKELIHOOD: "log likelihood",
}
PRINTED_LEVELS = (0.50, 0.95)
"""Of synthetic truths: the intervals whose coverage is printed."""

CONTROL_NAMES: dict[Control, str] = {
    "sigma": f"errors of points and pose understated by a factor of {UNDERSTATED_SD_FACTOR}",
    "prior": "the prior returned as the posterior",
    "pose": "errors of the pose ignored",
    "shuffled": "shape of another insertion, or wrong bevel side",
}


def scope_note(found: Run) -> str:
    """Return what a calibration tests and what not."""
    return SYNTHETIC_SCOPE_NOTE if is_of_synthetic_truths(found.run) else SCOPE_NOTE


def is_of_synthetic_truths(run: Mapping[str, Any]) -> bool:
    """Return whether truths were another model's, from the `run.json` of a calibration."""
    return bool(run["study"].get("truth") == "synthetic")


def name_quantity(name: str) -> str:
    """Return the printed name of a ranked quantity."""
    return QUANTITY_NAMES.get(name, format_bare_symbol(name))


def lay_out_calibration(found: Run) -> TableLayout:
    """Return a row per quantity: true values covered by each central interval, and the range by chance."""
    outside = found.frames["ranks"].query("not passes").groupby("quantity").size()
    calibrated = "yes" if found.run["conclusive"] else "undecided"
    rows = [
        {
            **row,
            "mark": "" if row["passes"] else "!",
            "ranks": f"{out} of {RANK_DRAWS} outside"
            if (out := outside.get(row["quantity"], 0))
            else "inside",
            "calibrated": "NO" if row["quantity"] in found.run["not_calibrated"] else calibrated,
            "quantity": name_quantity(row["quantity"]),
        }
        for row in to_records(found.frames["coverage"])
    ]
    quantities = pivot(rows, ["quantity"], ["level"])
    columns = ("quantity", *(part("covered_by_chance", level=one) for one in LEVELS), "ranks", "calibrated")
    if is_of_synthetic_truths(found.run):
        shares = (part("covered_share", level=one) for one in PRINTED_LEVELS)
        columns = ("quantity", *shares, "ranks", "calibrated")
    notes = (_describe_checks(found, len(quantities)),)
    return Table("calibration", describe_figure(found), quantities, columns, notes=notes).lay_out()


def _describe_checks(found: Run, quantities: int) -> str:
    """Return what the table of coverage counts, and how often chance alone fails a check."""
    chance = (
        f"Each check may fail with probability {single_check_error(quantities):.1e}, all together with "
        f"{FAMILY_ERROR:g} at most (Bonferroni)."
    )
    if is_of_synthetic_truths(found.run):
        return (
            "Share of central intervals that contain the truth, with its 95 % binomial interval. The "
            "held-out tips of a replicate share needle, specimens and fit, and count as one trial. PIT "
            f"values in {RANK_DRAWS + 1} equal parts, as ranks. {chance}"
        )
    return (
        f"How often the central interval contains the truth, and the range of that count by chance; ranks "
        f"among {RANK_DRAWS} draws. {chance} Stiffest: the combination of parameters that the design, or the "
        "data at their fit, determine best."
    )


def describe_figure(found: Run) -> str:
    """Return the caption of table and figure."""
    wrong = f" Control: {CONTROL_NAMES[found.run['control']]}." if found.run["control"] else ""
    cut = " INTERRUPTED." if found.interrupted else ""
    where = "Rank of the truth among posterior draws"
    if is_of_synthetic_truths(found.run):
        where = "Synthetic truths in their posterior and predictive distributions"
    count = found.run["replicates"]
    return f"{where}, {count} replicate{'' if count == 1 else 's'}.{wrong}{cut}"


def summarize_calibration(found: Run) -> list[str]:
    """Return sentences: the outcome, the method, and the version and settings."""
    synthetic = is_of_synthetic_truths(found.run)
    return [
        _describe_outcome(found),
        *(_describe_tips(found) if synthetic else ()),
        _describe_design(found),
        *_describe_computation(found),
        *(() if synthetic else (_describe_redrawn(found),)),
    ]


def judge_calibration(found: Run) -> list[Verdict]:
    """Return whether the uncertainties are correct; a control passes if it is detected."""
    status: Status = "pass" if found.run["passes"] else "fail"
    numbers = {"replicates": found.run["replicates"], "not_calibrated": len(found.run["not_calibrated"])}
    sentence = _describe_outcome(found).rstrip(".")
    return [Verdict(sentence, status if found.run["conclusive"] else "warn", "", numbers)]


def headline_calibration(fault: str) -> str:
    """Return the headline of a fault; of an outcome that is the verdict itself."""
    missing = fault.endswith(("have not converged", "could not be predicted"))
    return headline_fault(fault) if missing else ""


def _describe_tips(found: Run) -> list[str]:
    """Return how often held-out tips lay in their intervals, and how far they were predicted."""
    rows = found.frames["predictions"]
    if not len(rows):
        return []
    shares = ", ".join(
        f"{100 * row['share']:.0f} % ({100 * row['low']:.0f} to {100 * row['high']:.0f} %) in the "
        f"{100 * row['level']:.0f} % interval"
        for row in to_records(found.frames["coverage"])
        if row["quantity"] == HELD_OUT_TIP and row["level"] in PRINTED_LEVELS
    )
    crps, score = rows["tip_crps_mm"].mean(), rows["tip_interval_score_mm"].mean()
    return [f"Of {len(rows)} held-out tips {shares}; CRPS {crps:.2f} mm, interval score {score:.2f} mm."]


def _describe_outcome(found: Run) -> str:
    run = found.run
    failing, control = run["not_calibrated"], run["control"]
    names = insert_symbols(", ".join(name_quantity(name) for name in failing))
    count = run["replicates"]
    few = f"{count} replicate{' is' if count == 1 else 's are'} too few"
    if control is not None:
        outcome = f"detected, by {names}" if failing else "NOT detected"
        if not failing and not run["conclusive"]:
            outcome = f"not decided, {few}"
        return f"Control ({CONTROL_NAMES[control]}): {outcome}."
    if failing:
        return f"NOT calibrated: {names}."
    if not run["conclusive"]:
        return f"Not decided: {few}."
    total = found.frames["coverage"]["quantity"].nunique()
    return f"Calibrated: all {total} quantities, {count} replicates."


def _describe_design(found: Run) -> str:
    design = found.frames["design"]
    count = len(design)
    shallow, deep = (f"{depth:.3g}" for depth in (design["depth_mm"].min(), design["depth_mm"].max()))
    depth = f"{shallow} mm" if shallow == deep else f"{shallow} to {deep} mm"
    if is_of_synthetic_truths(found.run):
        how = "through CT volumes" if found.run["study"]["ct"] else "without scans, with their errors"
        total = found.run["replicates"]
        return (
            f"{total} synthetic truth{'s' if total > 1 else ''}, each fitted to {count} "
            f"insertion{'s' if count > 1 else ''}, {depth} deep, measured {how}."
        )
    few = f" ({', '.join(design['insertion'])})" if found.run["study"]["sampled"] else ""
    return (
        f"{found.run['replicates']} replicates of {count} insertion{'s' if count > 1 else ''}{few}, {depth} "
        "deep: parameters from their prior, needles simulated anew, errors of depths, pose and points as "
        "stated."
    )


def _describe_computation(found: Run) -> list[str]:
    """Return the method that computed the posteriors, and how many were not certified."""
    count = found.run["replicates"]
    sources = found.run["draw_source"].items()
    parts = [f"{one} by {who} ({100 * one / count:.1f} %)" for who, one in sources]
    lines = [f"Posteriors: {', '.join(parts)}; none was left out."]
    if found.run["untrusted"] and found.run["control"] is None:
        lines.append(f"{found.run['untrusted']} of them have NOT CONVERGED; they are counted.")
    return lines


def _describe_redrawn(found: Run) -> str:
    again = found.run["redrawn"]
    drawn = again + found.run["replicates"]
    return f"{again} of {drawn} parameter sets drawn from the prior have no solution and were redrawn."
