"""What is said of the rivals: who does better than the fitted model, by how much, on how many insertions."""

from needlefit.reporting.names import RIVAL_NAMES, rival_name
from needlefit.reporting.numbers import MISSING
from needlefit.reporting.tables import Row, records, study_label
from needlefit.validation.results import BASELINES, Results
from needlefit.validation.summary import paired

_SURE = 2.0
"""Standard errors up to which a difference may be chance."""

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
    """Return every rival that does better than the fitted model on the scored points, or nothing."""
    losses = [f"{rival_name(name, results)} ({_gap(row)})" for name, row in _better(_table(results)).items()]
    return (
        f"{_study(results)}: better than the fit on the same points: {'; '.join(losses)}." if losses else ""
    )


def compared_said(results: Results) -> str:
    """Return every empirical curve's difference from the fitted model, or nothing if none was scored."""
    curves = {name: row for name, row in _table(results).items() if name in BASELINES}
    if not curves:
        return ""
    said = "; ".join(f"{RIVAL_NAMES[name]} {_gap(row)}" for name, row in curves.items())
    return f"Mean IPE minus the fit’s on the same points, negative where the curve does better: {said}."


def _curves_said(results: Results, table: dict[str, Row]) -> str:
    curves = {name: row for name, row in table.items() if name in BASELINES}
    if not curves:
        return "No empirical curve was scored beside the model."
    winners = [f"{RIVAL_NAMES[name]} ({_gap(row)})" for name, row in _better(curves).items()]
    if winners:
        points = "held-out points" if scored_role(results) == "validate" else "points"
        return (
            "An empirical curve that knows nothing of tissue does better here than the fitted model, on the "
            f"same {points}: {'; '.join(winners)}."
        )
    known = [name for name in curves if curves[name]["difference_mm"] is not None]
    if not known:
        return "No empirical curve could be compared with the fitted model."
    best = min(known, key=lambda name: curves[name]["difference_mm"])
    return (
        "No empirical curve does better than the fitted model on these insertions; the nearest is "
        f"{RIVAL_NAMES[best]} ({_gap(curves[best])})."
    )


def _sets_said(results: Results, table: dict[str, Row]) -> str:
    winners = _better({name: row for name, row in table.items() if name in _SETS})
    if not winners:
        return ""
    said = "; ".join(f"{rival_name(name, results)} ({_gap(row)})" for name, row in winners.items())
    return f"The paper’s parameters do better here than the fitted ones: {said}."


def _table(results: Results) -> dict[str, Row]:
    return {row["rival"]: row for row in records(paired(results, role=scored_role(results)))}


def _better(table: dict[str, Row]) -> dict[str, Row]:
    return {name: row for name, row in table.items() if (row["difference_mm"] or 0.0) < 0}


def _study(results: Results) -> str:
    label = study_label(results)
    return f"Study {label}" if isinstance(label, int) else label


def _gap(row: Row) -> str:
    if row["difference_mm"] is None:
        return MISSING
    se = row["difference_se_mm"]
    error = "" if se is None else f" ± {se:.3f}"
    within = "" if se is None or abs(row["difference_mm"]) > _SURE * se else "; within two standard errors"
    gap = f"{row['difference_mm']:+.3f}".replace("-", "−")
    return f"{gap}{error} mm mean IPE, the fit better on {row['better']} of {row['insertions']}{within}"
