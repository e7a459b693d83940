"""Print the results of `tune` and `validate` as tables."""

import math
from typing import TYPE_CHECKING, Any

from needlefit.cli import screen
from needlefit.project.result_warnings import WARNINGS_KEY, read_warnings, to_rows

if TYPE_CHECKING:
    import pandas as pd

    from needlefit.validation.results import Results


_COMPARISON_HEADINGS = {
    "method": "method",
    "ipe_mean_mm": "IPE mm",
    "te_mm": "TE mm",
    "difference_mm": "ΔIPE mm",
    "difference_se_mm": "s.e. mm",
    "better": "fit better on",
    "insertions": "of",
}


def show_validation(results: "Results") -> None:
    """Print the validation table of one study, then the methods on the same insertions and points.

    A fit scores nothing but its own insertions: of it only its name and the data are printed.
    """
    from needlefit.reporting.labels import method_name
    from needlefit.reporting.score_tables import lay_out_coverage, lay_out_validation
    from needlefit.reporting.sentences import summarize_baselines
    from needlefit.validation.summary import compare_methods

    show_head(results)
    if (results.errors["role"] == "tune").all():
        return
    screen.show_display(lay_out_validation([results]))
    methods = compare_methods(results)
    table = methods.assign(method=[method_name(str(method), results) for method in methods["method"]])
    table = table[list(_COMPARISON_HEADINGS)].round(3).rename(columns=_COMPARISON_HEADINGS)
    screen.show_frame(
        table, "Methods on the same held-out insertions and points; ΔIPE is the method's IPE minus the fit's."
    )
    screen.print_line(summarize_baselines(results))
    if len(results.predictive):
        screen.show_display(lay_out_coverage(results))


def show_head(results: "Results") -> None:
    """Print what this is, what the data are, and what failed, in words that a reader cannot miss."""
    from needlefit.reporting.posterior import describe_unconverged
    from needlefit.reporting.sentences import describe_failures, describe_validity

    screen.print_line(f"{results.name}: {results.title}" if results.title else results.name)
    if results.origin == "synthetic":
        screen.print_line(
            f"  SYNTHETIC data ({results.dataset_title}): consistency, no evidence for the model"
        )
    else:
        screen.print_line(f"  measured data: {results.dataset_title}")
    if results.interrupted:
        screen.print_line("  INTERRUPTED: the best found so far")
    for sentences in (describe_failures(results), describe_validity(results), describe_unconverged(results)):
        if sentences:
            screen.print_line(f"  {sentences}")


_PARAMETER_HEADINGS = {
    "fold": "fold",
    "parameter": "parameter",
    "fitted": "fitted",
    "fitted_metric": "by IPE, TE, EDP",
    "hand_tuned": "paper, by hand",
    "hand_tuned_b": "paper, b re-tuned",
    "status": "status",
    "known": "known to",
    "within_tolerance": "as good from ... to",
}
_METRIC_HEADINGS = {
    "median_err_mm": "median mm",
    "ipe_mean_mm": "IPE mm",
    "ipe_max_mm": "max mm",
    "te_mm": "TE mm",
    "edp_percent": "EDP %",
}


def show_tuning(results: "Results") -> None:
    """Print the parameters and errors of the fit and its methods, the waterfall, and what stays open."""
    from needlefit.reporting.parameter_table import tabulate_parameters

    show_head(results)
    table = tabulate_parameters(results)
    rows = table.to_dict("records")
    table["known"] = [_format_sd(row["sd"], row["sd_of"]) for row in rows]
    table["within_tolerance"] = [_format_range(row["spread_low"], row["spread_high"]) for row in rows]
    several = table["fold"].nunique() > 1
    wanted = [
        name for name in _PARAMETER_HEADINGS if (name != "fold" or several) and _has_values(table[name])
    ]
    screen.show_frame(table[wanted].rename(columns=_PARAMETER_HEADINGS), "Parameters.")
    for fold, starts in results.starts.query("fit == 'fitted'").groupby("fold", sort=False):
        screen.print_line(f"Fold {fold}. {describe_starts(starts)}" if several else describe_starts(starts))
    for sentence in describe_undetermined(table, results.directions):
        screen.print_line(sentence)
    _show_verdict(results)
    screen.print_line()
    _show_errors(results)
    if results.posteriors:
        from needlefit.reporting.posterior import (
            describe_outside_fits,
            describe_unconverged,
            tabulate_percentiles,
        )

        state = " NOT CONVERGED: they are not final." if describe_unconverged(results) else ""
        screen.show_frame(tabulate_percentiles(results), f"Posterior: percentiles in Pa and mm.{state}")
        screen.print_line(describe_outside_fits(results))
    if results.origin == "synthetic" and "hand_tuned" in set(results.errors["method"]):
        screen.print_line(
            "The paper's set was not tuned on this data; the fair method is the one with b re-tuned."
        )


def _show_verdict(results: "Results") -> None:
    """Print what profiles, information and contraction say of each parameter."""
    from needlefit.reporting.identification_tables import describe_verdicts

    sentences = describe_verdicts(results.identification)
    if sentences:
        screen.print_line("Profile likelihoods, 95 %, drawn in profiles.pdf:")
    for sentence in sentences:
        screen.print_line(f"  {sentence}")


def _format_sd(sd: float, of: str) -> str:
    """Return a standard deviation for people: of a logarithm in percent, or as a factor where it is large."""
    if not math.isfinite(sd):
        return ""
    if of != "ln":
        return f"+-{sd:.2g}"
    return f"+-{100 * sd:.2g} %" if sd < 0.5 else f"a factor of {math.exp(sd):.2g}"


def _format_range(low: float, high: float) -> str:
    return f"{low:.3g} ... {high:.3g}" if math.isfinite(low) and math.isfinite(high) else ""


def tuning_json(results: "Results") -> dict[str, Any]:
    """Return the fit for machines: rows under the column names of the files."""
    from needlefit.reporting.parameter_table import tabulate_parameters
    from needlefit.reporting.posterior import tabulate_percentiles

    about = {"name": results.name, "origin": results.origin, "dataset": results.dataset_title}
    frames = {"parameters": tabulate_parameters(results)}
    frames |= {name: getattr(results, name) for name in ("errors", "starts", "failures", "directions")}
    frames |= {"identification": results.identification, "profiles": results.profiles}
    if results.posteriors:
        frames["posterior"] = tabulate_percentiles(results)
    rows = {name: frame.to_dict("records") for name, frame in frames.items()}
    warnings = to_rows(read_warnings(results.run))
    return {**about, "interrupted": results.interrupted, WARNINGS_KEY: warnings, **rows}


def describe_starts(starts: "pd.DataFrame") -> str:
    """Say how many starts of one search end practically as well as the best."""
    best, agree = starts["objective"].min(), int(starts["within_tolerance"].sum())
    posterior = (starts["minimized"] == "posterior").all()
    at = f"-log posterior {best:.6g}, within 0.1 of it" if posterior else f"{best:.4g} mm"
    share = f"{agree} of {len(starts)} starts end practically as well as the best ({at})"
    ended = int((starts["stopped"] == "budget").sum())
    spent = f"; {ended} ended because their budget was spent: raise the recipe's evaluations" if ended else ""
    return f"Waterfall: {share} (all of them in starts.csv){spent}."


def describe_undetermined(parameters: "pd.DataFrame", directions: "pd.DataFrame") -> list[str]:
    """Return sentences on what the data do not determine, and how well combinations are known."""
    free = parameters[parameters["status"] == "free"]
    loose = free[~free["determined"].astype(bool)].drop_duplicates(["parameter", "note"])
    fixed = parameters.loc[parameters["status"] == "fixed", "parameter"].unique()
    sentences = [
        f"NOT determined by these data: {row.parameter}: {str(row.note).removeprefix('not determined ')}."
        for row in loose.itertuples()
    ]
    if len(fixed):
        sentences.append(f"Fixed, not fitted: {', '.join(fixed)}.")
    if len(directions):
        sentences.append("Combinations, linear about this point and only as far as the model holds:")
    return [*sentences, *(f"  {row.words}." for row in directions.itertuples())]


def _has_values(column: "pd.Series[Any]") -> bool:
    return bool((column.notna() & (column.astype(str) != "")).any())


def _show_errors(results: "Results") -> None:
    from needlefit.reporting.labels import method_name

    errors = results.errors.query("role == 'tune' and boundaries == 'measured'")
    means = errors.groupby("method", sort=False)[list(_METRIC_HEADINGS)].mean().reset_index()
    names = [method_name(str(method), results) for method in means["method"]]
    count = errors["insertion"].nunique()
    title = f"Errors on the {count} tuning insertion{'s' if count > 1 else ''}, mean over insertions."
    screen.show_frame(means.assign(method=names).round(3).rename(columns=_METRIC_HEADINGS), title)
