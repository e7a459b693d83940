"""What is said of the rivals: who does better than the fitted model, by how much, on how many insertions."""

from needlefit.reporting.names import METHOD_NAMES, method_name
from needlefit.reporting.numbers import MISSING
from needlefit.reporting.tables import Row, records, study_label
from needlefit.validation.results import BASELINES, Results
from needlefit.validation.summary import beats_fit, compare_methods

_SETS = ("hand_tuned", "hand_tuned_b")


def scored_role(results: Results) -> str:
    """Return "validate", or "tune" for a fit that holds nothing out."""
    return "validate" if (results.errors["role"] == "validate").any() else "tune"


def rivals_said(results: Results) -> str:
    """Return which empirical curves and which of the paper's sets do better than the fitted model."""
    table = _table(results)
    said = [_curves_said(results, table), _sets_said(results, table)]
    return " ".join(sentence for sentence in said if sentence)


def losses_said(results: Results) -> str:
    """Return every method that does better than the fitted model on the scored points, or nothing."""
    table = _table(results)
    losses = [f"{method_name(name, results)} ({_gap(row)})" for name, row in _better(table).items()]
    said = (
        f"{_study(results)}: better than the fit on the same points: {'; '.join(losses)}." if losses else ""
    )
    return " ".join(part for part in (said, _close_said(results, table)) if part)


def compared_said(results: Results) -> str:
    """Return every empirical curve's difference from the fitted model, or nothing if none was scored."""
    curves = {name: row for name, row in _table(results).items() if name in BASELINES}
    if not curves:
        return ""
    said = "; ".join(f"{METHOD_NAMES[name]} {_gap(row)}" for name, row in curves.items())
    return f"Mean IPE minus the fit’s on the same points, negative where the curve does better: {said}."


def _curves_said(results: Results, table: dict[str, Row]) -> str:
    curves = {name: row for name, row in table.items() if name in BASELINES}
    if not curves:
        return "No empirical curve was scored beside the model."
    winners = [f"{METHOD_NAMES[name]} ({_gap(row)})" for name, row in _better(curves).items()]
    if winners:
        points = "held-out points" if scored_role(results) == "validate" else "points"
        return (
            "An empirical curve that knows nothing of tissue does better here than the fitted model, on the "
            f"same {points}: {'; '.join(winners)}." + _after(_close_said(results, curves))
        )
    if close := _close_said(results, curves):
        return f"No empirical curve does better than the fitted model on these insertions. {close}"
    known = [name for name in curves if curves[name]["difference_mm"] is not None]
    if not known:
        return "No empirical curve could be compared with the fitted model."
    best = min(known, key=lambda name: curves[name]["difference_mm"])
    return (
        "No empirical curve does better than the fitted model on these insertions; the nearest is "
        f"{METHOD_NAMES[best]} ({_gap(curves[best])})."
    )


def _sets_said(results: Results, table: dict[str, Row]) -> str:
    sets = {name: row for name, row in table.items() if name in _SETS}
    close, winners = _close_said(results, sets), _better(sets)
    if not winners:
        return close
    said = "; ".join(f"{method_name(name, results)} ({_gap(row)})" for name, row in winners.items())
    return f"The paper’s parameters do better here than the fitted ones: {said}." + _after(close)


def _table(results: Results) -> dict[str, Row]:
    return {row["method"]: row for row in records(compare_methods(results, role=scored_role(results)))}


def _better(table: dict[str, Row]) -> dict[str, Row]:
    """Return the rivals that err less than the fit by more than chance gives (`beats_fit`)."""
    return {name: row for name, row in table.items() if beats_fit(row)}


def _close_said(results: Results, table: dict[str, Row]) -> str:
    """Return the rivals that err less, but by no more than chance gives, or nothing."""
    close = {name: row for name, row in table.items() if _ahead(row) and not beats_fit(row)}
    said = "; ".join(f"{method_name(name, results)} ({_gap(row)})" for name, row in close.items())
    alone = all(row["difference_se_mm"] is None for row in close.values())
    least = "half of its error, on one insertion" if alone else "two standard errors"
    return f"Not told apart from the fit, by less than {least}: {said}." if close else ""


def _ahead(row: Row) -> bool:
    return (row["difference_mm"] or 0.0) < 0


def _after(sentence: str) -> str:
    return f" {sentence}" if sentence else ""


def _study(results: Results) -> str:
    label = study_label(results)
    return f"Study {label}" if isinstance(label, int) else label


def _gap(row: Row) -> str:
    if row["difference_mm"] is None:
        return MISSING
    se = row["difference_se_mm"]
    error = "" if se is None else f" ± {se:.3f}"
    gap = f"{row['difference_mm']:+.3f}".replace("-", "−")
    return f"{gap}{error} mm mean IPE, the fit better on {row['better']} of {row['insertions']}"
