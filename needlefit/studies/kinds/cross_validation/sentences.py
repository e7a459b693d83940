"""The sentences of a report: errors beside noise floor and baselines, failures, validity."""

from needlefit.inference.baselines import BASELINES
from needlefit.metrics import headline_metrics, list_metrics
from needlefit.reporting.labels import layers_name, medium_name, method_name
from needlefit.reporting.number_format import (
    MISSING,
    format_bare_symbol,
    format_metric,
    format_quantity,
    join_metrics,
    join_words,
)
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.kinds.cross_validation.parameter_table import (
    find_conditional,
    find_fixed,
    find_undetermined,
)
from needlefit.studies.kinds.cross_validation.tables import ScoredGroup, list_held_out_groups, study_label
from needlefit.studies.run import Run
from needlefit.studies.summary import aggregate, beats_fit, compare_methods, count_reasons
from needlefit.studies.validity import describe_outside

_PAPER_SETS = ("hand_tuned", "hand_tuned_b")


def find_scored_role(results: Run) -> str:
    """Return the role that is scored: "validate", or "tune" for a fit without held-out insertions."""
    return "validate" if (results.frames["errors"]["role"] == "validate").any() else "tune"


def summarize_baselines(results: Run) -> str:
    """Return which empirical curves and sets of the paper have smaller errors than the fit."""
    table = _rows_by_method(results)
    summary = [_summarize_curves(results, table), _summarize_paper_sets(results, table)]
    return " ".join(sentence for sentence in summary if sentence)


def list_better_methods(results: Run) -> str:
    """Return every method with smaller errors than the fitted model on the scored points."""
    table = _rows_by_method(results)
    return " ".join(part for part in (_list_better(results, table), _list_ties(results, table)) if part)


def _list_better(results: Run, table: dict[str, Row]) -> str:
    losses = [
        f"{method_name(name, results.origin)} ({_format_difference(row)})"
        for name, row in _select_better(table).items()
    ]
    where = f"{_name_study(results)}, smaller errors than the fit on the same points"
    return f"{where}: {'; '.join(losses)}." if losses else ""


def list_curve_differences(results: Run) -> str:
    """Return every empirical curve's difference from the fitted model; empty if none was scored."""
    curves = {name: row for name, row in _rows_by_method(results).items() if name in BASELINES}
    if not curves:
        return ""
    summary = "; ".join(f"{method_name(name)} {_format_difference(row)}" for name, row in curves.items())
    return f"Mean IPE minus that of the fit on the same points (negative: the baseline is better): {summary}."


def _summarize_curves(results: Run, table: dict[str, Row]) -> str:
    curves = _select_curves(table)
    ties = _list_ties(results, curves) if curves else ""
    return _conclude_curves(results, curves) + _prepend_space(ties)


def _select_curves(table: dict[str, Row]) -> dict[str, Row]:
    return {name: row for name, row in table.items() if name in BASELINES}


def _conclude_curves(results: Run, curves: dict[str, Row]) -> str:
    """Return whether a baseline errs less than the fit, by which metric and on which insertions."""
    if not curves:
        return "No baseline was scored."
    known = [name for name in curves if curves[name]["difference_mm"] is not None]
    if not known:
        return "No baseline could be compared with the fitted model."
    held_out = find_scored_role(results) == "validate"
    scope = f"By mean IPE over all {'held-out' if held_out else 'tuning'} insertions"
    by_group = " Verdicts compare the tip error (TE), in each group." if held_out else ""
    if winners := _select_better(curves):
        names = "; ".join(f"{method_name(name)} ({_format_difference(row)})" for name, row in winners.items())
        found = f"{scope}, a baseline has a significantly smaller error than the fitted model: {names}."
    elif any(map(_errs_less, curves.values())):
        found = f"{scope}, no baseline has a significantly smaller error than the fitted model."
    else:
        best = min(known, key=lambda name: curves[name]["difference_mm"])
        found = (
            f"{scope}, no baseline has a smaller error than the fitted model; the closest is "
            f"{method_name(best)} ({_format_difference(curves[best])})."
        )
    return found + by_group


def _summarize_paper_sets(results: Run, table: dict[str, Row]) -> str:
    sets = {name: row for name, row in table.items() if name in _PAPER_SETS}
    ties, winners = _list_ties(results, sets), _select_better(sets)
    if not winners:
        return ties
    summary = "; ".join(
        f"{method_name(name, results.origin)} ({_format_difference(row)})" for name, row in winners.items()
    )
    return f"The paper’s parameters have smaller errors than the fitted ones: {summary}." + _prepend_space(
        ties
    )


def _rows_by_method(results: Run) -> dict[str, Row]:
    return {
        row["method"]: row for row in to_records(compare_methods(results, role=find_scored_role(results)))
    }


def _select_better(table: dict[str, Row]) -> dict[str, Row]:
    """Return the baselines that err less than the fit by more than chance gives (`beats_fit`)."""
    return {name: row for name, row in table.items() if beats_fit(row)}


def _list_ties(results: Run, table: dict[str, Row]) -> str:
    """Return the baselines that err less, but by no more than chance gives, or nothing."""
    ties = {name: row for name, row in table.items() if _errs_less(row) and not beats_fit(row)}
    summary = "; ".join(
        f"{method_name(name, results.origin)} ({_format_difference(row)})" for name, row in ties.items()
    )
    alone = all(row["difference_se_mm"] is None for row in ties.values())
    margin = "half of its error, on one insertion" if alone else "two standard errors"
    return f"Not significantly different from the fit, by less than {margin}: {summary}." if ties else ""


def _errs_less(row: Row) -> bool:
    return (row["difference_mm"] or 0.0) < 0


def _prepend_space(sentence: str) -> str:
    return f" {sentence}" if sentence else ""


def _name_study(results: Run) -> str:
    label = study_label(results)
    return f"Study {label}" if isinstance(label, int) else label


def _format_difference(row: Row) -> str:
    if row["difference_mm"] is None:
        return MISSING
    se = row["difference_se_mm"]
    error = "" if se is None else f" ± {se:.3f}"
    difference = f"{row['difference_mm']:+z.3f}".replace("-", "−")
    return f"{difference}{error} mm mean IPE, the fit better on {row['better']} of {row['insertions']}"


def summarize_errors(results: Run) -> list[str]:
    """Return the main result: one sentence per held-out group, then the comparison with its baselines.

    A study without a row of the paper is about its empirical curves, so each one's difference is given;
    of the others only the baselines that do better, named in the same breath as the errors.
    """
    groups = list_held_out_groups(results)
    if not groups:
        return [_summarize_fit(results)]
    printed = any(group.printed for group in groups)
    comparisons = list_better_methods(results) if printed else list_curve_differences(results)
    return [*map(_summarize_group, groups), *([comparisons] if comparisons else [])]


def explain_errors(results: Run) -> list[str]:
    """Return `summarize_errors` with every comparison, each method's numbers once."""
    groups = list_held_out_groups(results)
    if not groups:
        return [_summarize_fit(results), summarize_baselines(results)]
    table = _rows_by_method(results)
    curves = _select_curves(table)
    others = {name: row for name, row in table.items() if name not in curves}
    return [
        *map(_summarize_group, groups),
        _conclude_curves(results, curves),
        _list_better(results, others),
        _list_ties(results, table),
    ]


def describe_undetermined(results: Run) -> str:
    """Return which parameters the data do not determine."""
    open_ones = find_undetermined(results)
    if not (results.frames["parameters"]["method"] == "fitted").any():
        return "The search gave no parameters."
    fixed_ones = find_fixed(results)
    identification = results.frames["identification"]
    alone = "" if len(identification) else " Judged by the information at the optimum alone."
    summary = f" Held fixed, not fitted: {_join_symbols(fixed_ones)}." if fixed_ones else ""
    if not open_ones:
        return (
            f"The data determine every free parameter, given this model and the stated noise.{alone}{summary}"
        )
    where = ", in at least one fold" if results.frames["parameters"]["fold"].nunique() > 1 else ""
    conditional = find_conditional(results)
    loose = [name for name in open_ones if name not in conditional]
    found = (
        f"The data do not determine {_join_symbols(loose)}{where}: many values fit equally well within "
        "tolerance. The predictions use one of them, which is no estimate."
        if loose
        else ""
    )
    found += (
        f" The data determine {_join_symbols(conditional)} only under an assumption, which the note in the "
        "table names."
        if conditional
        else ""
    )
    return f"{found.strip()}{alone}{summary}"


def describe_prediction_set(results: Run) -> str:
    """Return which parameter values the predictions use; empty if the search gave none."""
    rows = [row for row in to_records(results.frames["parameters"]) if row["method"] == "fitted"]
    if not rows:
        return ""
    by_metric = (results.frames["starts"].query("fit == 'fitted'")["minimized"] == "metric").any()
    mode = "least-error" if by_metric else "posterior-mode"
    free = [row for row in rows if row["status"] != "fixed"]
    values = ", ".join(_describe_value(row) for row in free) or "all fixed"
    several = len({row["fold"] for row in rows}) > 1
    found = f"Curves and errors use each fold’s {mode} values (`value_used` in parameters.csv)"
    if not several:
        found = f"Curves and errors use the {mode} values: {values}"
    draws = results.frames["predictive"]["draws"]
    if not len(draws):
        return f"{found}."
    return f"{found}; predictive medians and intervals use {int(draws.max())} draws of the posterior."


def _describe_value(row: Row) -> str:
    name = str(row["parameter"])
    return f"{_join_symbols([name])} {format_quantity(name, row['value'])}"


def describe_failures(results: Run) -> str:
    """Return how many evaluations failed and why; empty if none did."""
    failed = int(results.frames["starts"]["failed_solves"].sum())
    evaluations = int(results.frames["starts"]["evaluations"].sum())
    sampled = sum(posterior.failures for posterior in results.posteriors.values())
    if not failed + sampled:
        return ""
    recorded = len(results.frames["failures"])
    failures = results.frames["failures"]
    counts = ", ".join(f"{count} {reason}" for reason, count in count_reasons(failures).items())
    summary = f"{failed} of {evaluations} evaluations failed"
    summary += f", and {sampled} of the sampler's" if sampled else ""
    if recorded == failed + sampled:
        return f"{summary}: {counts}; failures.csv holds their parameters."
    return f"{summary}; failures.csv holds the parameters of the first {recorded}: {counts}."


def describe_validity(results: Run) -> str:
    """Return how many simulations violate the model's assumptions; empty if none does."""
    words = describe_outside(results.run)
    return f"Outside what the model assumes: {words}." if words else ""


def describe_noise_floor(results: Run) -> str:
    """Return the errors that even perfect parameters would show."""
    rows = _aggregate_fit(results)
    if not rows or rows["ipe_mean_mm"]["floor"] is None:
        return (
            "The dataset states no measurement noise: there is no noise floor, no likelihood and no "
            "posterior. The fit minimises the errors themselves."
        )
    digits = _choose_digits(rows["ipe_mean_mm"]["floor"])
    cells = [
        f"{one.label} {format_metric(one, rows[one.name]['floor'], digits)} {one.unit}"
        for one in list_metrics()
        if one.has_floor
    ]
    return (
        "Noise floor, the mean errors of perfect parameters with the stated measurement noise: "
        f"{', '.join(cells)}. Differences below it are not significant. Means far below it show that the "
        "measurements err less than stated."
    )


def _summarize_group(group: ScoredGroup) -> str:
    row = group.head
    digits = 3 if row["comparison"] == "aligned" else 2

    def join(column: str) -> str:
        return join_metrics(
            {metric.name: group.get(metric.name, column) for metric in headline_metrics()}, digits
        )

    study = f"Study {row['study']}, " if isinstance(row["study"], int) else ""
    name = f"{medium_name(row['medium'])}, {layers_name(row['layers'])}"
    count = "1 insertion" if row["insertions"] == 1 else f"{row['insertions']} insertions"
    summary = f"{study}{name} ({count}): mean {_name_headline()} {join('value')}"
    summary += f"; noise floor {join('floor')}" if group.get("te_mm", "floor") is not None else ""
    summary += f"; the paper {join('paper')}" if group.printed else ""
    return summary[:1].upper() + summary[1:] + "."


def _summarize_fit(results: Run) -> str:
    rows = _aggregate_fit(results)
    if not rows:
        return f"{results.name}: nothing could be scored."
    digits = _choose_digits(rows["ipe_mean_mm"]["value"])
    cells = join_metrics({metric.name: rows[metric.name]["value"] for metric in headline_metrics()}, digits)
    return (
        f"{results.name}: mean {_name_headline()} {cells} on the {rows['ipe_mean_mm']['insertions']} "
        "insertions that it was fitted to. Nothing is held out: this is goodness of fit, not prediction."
    )


def _join_symbols(names: list[str]) -> str:
    return ", ".join(format_bare_symbol(name) for name in names)


def _name_headline() -> str:
    return join_words([metric.label for metric in headline_metrics()])


def _aggregate_fit(results: Run) -> dict[str, Row]:
    """Return the fitted model's errors over everything it is scored on, by metric; empty if it was not."""
    wanted = (find_scored_role(results), "fitted", "measured")
    rows = to_records(aggregate(results, ("role", "method", "boundaries")))
    return {r["metric"]: r for r in rows if (r["role"], r["method"], r["boundaries"]) == wanted}


def _choose_digits(value: float | None) -> int:
    return 3 if value is not None and value < 0.1 else 2
