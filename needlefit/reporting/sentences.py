"""The sentences of a report: errors beside noise floor and baselines, failures, validity."""

from collections.abc import Mapping

from needlefit.project.result_warnings import WARNINGS_KEY
from needlefit.reporting.labels import METHOD_NAMES, layers_name, medium_name, method_name
from needlefit.reporting.number_format import MISSING, format_mm, format_symbol
from needlefit.reporting.parameter_table import find_fixed, find_undetermined
from needlefit.reporting.tables import Row, study_label, tabulate_validation, to_records
from needlefit.validation.results import BASELINES, Results
from needlefit.validation.summary import aggregate, beats_fit, compare_methods, count_reasons
from needlefit.validation.validity import VALIDITY_KEY as VALIDITY
from needlefit.validation.validity import describe_outside

_PAPER_SETS = ("hand_tuned", "hand_tuned_b")


def find_scored_role(results: Results) -> str:
    """Return the role that is scored: "validate", or "tune" for a fit without held-out insertions."""
    return "validate" if (results.errors["role"] == "validate").any() else "tune"


def summarize_baselines(results: Results) -> str:
    """Return which empirical curves and which of the paper's parameter sets have smaller errors
    than the fit.
    """
    table = _rows_by_method(results)
    summary = [_summarize_curves(results, table), _summarize_paper_sets(results, table)]
    return " ".join(sentence for sentence in summary if sentence)


def list_better_methods(results: Results) -> str:
    """Return every method with smaller errors than the fitted model on the scored points; empty if there is
    none.
    """
    table = _rows_by_method(results)
    losses = [
        f"{method_name(name, results)} ({_format_difference(row)})"
        for name, row in _select_better(table).items()
    ]
    summary = (
        f"{_name_study(results)}: better than the fit on the same points: {'; '.join(losses)}."
        if losses
        else ""
    )
    return " ".join(part for part in (summary, _list_ties(results, table)) if part)


def list_curve_differences(results: Results) -> str:
    """Return every empirical curve's difference from the fitted model; empty if none was scored."""
    curves = {name: row for name, row in _rows_by_method(results).items() if name in BASELINES}
    if not curves:
        return ""
    summary = "; ".join(f"{METHOD_NAMES[name]} {_format_difference(row)}" for name, row in curves.items())
    return f"Mean IPE minus the fit’s on the same points, negative where the curve does better: {summary}."


def _summarize_curves(results: Results, table: dict[str, Row]) -> str:
    curves = {name: row for name, row in table.items() if name in BASELINES}
    if not curves:
        return "No empirical curve was scored beside the model."
    winners = [
        f"{METHOD_NAMES[name]} ({_format_difference(row)})" for name, row in _select_better(curves).items()
    ]
    if winners:
        points = "held-out points" if find_scored_role(results) == "validate" else "points"
        return (
            "An empirical curve that knows nothing of tissue does better here than the fitted model, on the "
            f"same {points}: {'; '.join(winners)}." + _prepend_space(_list_ties(results, curves))
        )
    if ties := _list_ties(results, curves):
        return f"No empirical curve does better than the fitted model on these insertions. {ties}"
    known = [name for name in curves if curves[name]["difference_mm"] is not None]
    if not known:
        return "No empirical curve could be compared with the fitted model."
    best = min(known, key=lambda name: curves[name]["difference_mm"])
    return (
        "No empirical curve does better than the fitted model on these insertions; the nearest is "
        f"{METHOD_NAMES[best]} ({_format_difference(curves[best])})."
    )


def _summarize_paper_sets(results: Results, table: dict[str, Row]) -> str:
    sets = {name: row for name, row in table.items() if name in _PAPER_SETS}
    ties, winners = _list_ties(results, sets), _select_better(sets)
    if not winners:
        return ties
    summary = "; ".join(
        f"{method_name(name, results)} ({_format_difference(row)})" for name, row in winners.items()
    )
    return f"The paper’s parameters do better here than the fitted ones: {summary}." + _prepend_space(ties)


def _rows_by_method(results: Results) -> dict[str, Row]:
    return {
        row["method"]: row for row in to_records(compare_methods(results, role=find_scored_role(results)))
    }


def _select_better(table: dict[str, Row]) -> dict[str, Row]:
    """Return the baselines that err less than the fit by more than chance gives (`beats_fit`)."""
    return {name: row for name, row in table.items() if beats_fit(row)}


def _list_ties(results: Results, table: dict[str, Row]) -> str:
    """Return the baselines that err less, but by no more than chance gives, or nothing."""
    ties = {name: row for name, row in table.items() if _errs_less(row) and not beats_fit(row)}
    summary = "; ".join(
        f"{method_name(name, results)} ({_format_difference(row)})" for name, row in ties.items()
    )
    alone = all(row["difference_se_mm"] is None for row in ties.values())
    margin = "half of its error, on one insertion" if alone else "two standard errors"
    return f"Not significantly different from the fit, by less than {margin}: {summary}." if ties else ""


def _errs_less(row: Row) -> bool:
    return (row["difference_mm"] or 0.0) < 0


def _prepend_space(sentence: str) -> str:
    return f" {sentence}" if sentence else ""


def _name_study(results: Results) -> str:
    label = study_label(results)
    return f"Study {label}" if isinstance(label, int) else label


def _format_difference(row: Row) -> str:
    if row["difference_mm"] is None:
        return MISSING
    se = row["difference_se_mm"]
    error = "" if se is None else f" ± {se:.3f}"
    difference = f"{row['difference_mm']:+.3f}".replace("-", "−")
    return f"{difference}{error} mm mean IPE, the fit better on {row['better']} of {row['insertions']}"


_OMITTED_RUN_KEYS = (
    "name",
    "study",
    "fit",
    "medium",
    "folds",
    "searches",
    "hand_tuned",
    WARNINGS_KEY,
    VALIDITY,
)


def summarize_errors(results: Results) -> list[str]:
    """Return the main result: one sentence per held-out group, then the comparison with its baselines.

    A study without a row of the paper is about its empirical curves, so each one's difference is given;
    of the others only the baselines that do better, named in the same breath as the errors.
    """
    rows = to_records(tabulate_validation(results))
    if not rows:
        return [_summarize_fit(results)]
    printed = any(row["paper_te_mm"] is not None for row in rows)
    comparisons = list_better_methods(results) if printed else list_curve_differences(results)
    return [*(_summarize_group(row) for row in rows), *([comparisons] if comparisons else [])]


def describe_undetermined(results: Results) -> str:
    """Return which parameters the data do not determine."""
    open_ones = find_undetermined(results)
    if not (results.parameters["method"] == "fitted").any():
        return "The search gave no parameters."
    fixed_ones = find_fixed(results)
    alone = "" if len(results.identification) else " Judged by the information at the optimum alone."
    summary = f" Held fixed, not fitted: {_join_symbols(fixed_ones)}." if fixed_ones else ""
    if not open_ones:
        return (
            f"The data determine every free parameter, as far as this model and its noise go.{alone}{summary}"
        )
    where = ", in at least one fold" if results.parameters["fold"].nunique() > 1 else ""
    return (
        f"The data do not determine {_join_symbols(open_ones)}{where}: printed as such, because the "
        f"prediction "
        f"used one of many values that fit practically as well, and that value is no "
        f"estimate.{alone}{summary}"
    )


def describe_failures(results: Results) -> str:
    """Return how many evaluations failed and why; empty if none did."""
    failed = int(results.starts["failed_solves"].sum())
    evaluations = int(results.starts["evaluations"].sum())
    sampled = sum(posterior.failures for posterior in results.posteriors.values())
    if not failed + sampled:
        return ""
    recorded = len(results.failures)
    counts = ", ".join(f"{count} {reason}" for reason, count in count_reasons(results.failures).items())
    summary = f"{failed} of {evaluations} evaluations failed"
    summary += f", and {sampled} of the sampler's" if sampled else ""
    if recorded == failed + sampled:
        return f"{summary}: {counts}; failures.csv holds their parameters."
    return f"{summary}; failures.csv holds the parameters of the first {recorded}: {counts}."


def describe_validity(results: Results) -> str:
    """Return how many simulations violate the model's assumptions; empty if none does."""
    words = describe_outside(results.run)
    return f"Outside what the model assumes: {words}." if words else ""


def describe_noise_floor(results: Results) -> str:
    """Return the errors that even perfect parameters would show."""
    row = _aggregate_fit(results)
    if row is None or row["floor_ipe_mean_mm"] is None:
        return (
            "The dataset states no measurement noise: no noise floor can be given, and the fit minimises the "
            "errors themselves, for without noise a posterior has no width."
        )
    digits = _choose_digits(row["floor_ipe_mean_mm"])
    cells = [
        f"{name} {format_mm(row[f'floor_{key}_mm'], digits)} mm"
        for name, key in (
            ("median", "median_err"),
            ("mean IPE", "ipe_mean"),
            ("maximum", "ipe_max"),
            ("TE", "te"),
        )
    ]
    return (
        "With perfect parameters the measurement noise stated with the dataset would alone still give these "
        f"errors, on average over the scored insertions: {', '.join(cells)}. An error means something only "
        "beside this floor, and the floor is no better than what the dataset states: errors that lie below "
        "it say that this is too much."
    )


def describe_run(run: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return the settings of the run, one line per key; what the report shows elsewhere is left to
    run.json.
    """
    summary = [
        (key, _format_value(value)) for key, value in sorted(run.items()) if key not in _OMITTED_RUN_KEYS
    ]
    return [(key.replace("_", " "), line) for key, line in summary if line]


def _summarize_group(row: Row) -> str:
    digits = 3 if row["comparison"] == "aligned" else 2

    def format_pair(prefix: str) -> str:
        ipe, te = (format_mm(row[f"{prefix}{metric}_mm"], digits) for metric in ("ipe_mean", "te"))
        return f"{ipe} and {te} mm"

    study = f"Study {row['study']}, " if isinstance(row["study"], int) else ""
    group = f"{medium_name(row['validate_medium'])}, {layers_name(row['validate_layers'])}"
    count = "1 insertion" if row["insertions"] == 1 else f"{row['insertions']} insertions"
    summary = f"{study}{group} ({count}): mean IPE and TE {format_pair('')}"
    summary += f"; noise floor {format_pair('floor_')}" if row["floor_te_mm"] is not None else ""
    summary += f"; the paper {format_pair('paper_')}" if row["paper_te_mm"] is not None else ""
    return summary[:1].upper() + summary[1:] + "."


def _summarize_fit(results: Results) -> str:
    row = _aggregate_fit(results)
    if row is None:
        return f"{results.name}: nothing could be scored."
    digits = _choose_digits(row["ipe_mean_mm"])
    cells = f"{format_mm(row['ipe_mean_mm'], digits)} and {format_mm(row['te_mm'], digits)} mm"
    return (
        f"{results.name}: mean IPE and TE {cells} on the {row['insertions']} insertions that tuned "
        "it. Nothing is held out, so this says how well the model can follow them, not how well it predicts."
    )


def _join_symbols(names: list[str]) -> str:
    return ", ".join(format_symbol(name).split(" (")[0] for name in names)


def _aggregate_fit(results: Results) -> Row | None:
    """Return the fitted model's errors over everything it is scored on, or None if it was not."""
    wanted = (find_scored_role(results), "fitted", "measured")
    rows = to_records(aggregate(results, ("role", "method", "boundaries")))
    return next((r for r in rows if (r["role"], r["method"], r["boundaries"]) == wanted), None)


def _choose_digits(value: float | None) -> int:
    return 3 if value is not None and value < 0.1 else 2


def _format_value(value: object) -> str:
    """Return a value of run.json on one line; digests are cut, notes stand elsewhere."""
    if isinstance(value, Mapping):
        pairs = ((str(key), _format_value(item)) for key, item in sorted(value.items()) if key != "notes")
        return "; ".join(f"{key.replace('_', ' ')} {line}" for key, line in pairs if line)
    if isinstance(value, list | tuple):
        return ", ".join(_format_value(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    words = "" if value is None else str(value)
    return f"{words[:16]}…" if len(words) >= 40 and " " not in words else words
