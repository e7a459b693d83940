"""What `tune` prints: the fit beside its rivals, how the starts agree, and what stays open."""

import math
from typing import TYPE_CHECKING, Any

from needlefit.cli import screen
from needlefit.cli.show_validation import show_head
from needlefit.project.result_warnings import KEY, as_rows, warnings_of

if TYPE_CHECKING:
    import pandas as pd

    from needlefit.validation.results import Results

_PARAMETERS = {
    "fold": "fold",
    "parameter": "parameter",
    "fitted": "fitted",
    "fitted_metric": "by IPE, TE, EDP",
    "hand_tuned": "paper, by hand",
    "hand_tuned_b": "paper, b re-tuned",
    "status": "status",
    "known": "known to",
    "as_good": "as good from ... to",
}
_METRICS = {
    "median_err_mm": "median mm",
    "ipe_mean_mm": "IPE mm",
    "ipe_max_mm": "max mm",
    "te_mm": "TE mm",
    "edp_percent": "EDP %",
}


def show_tuning(results: "Results") -> None:
    """Print the parameters and errors of the fit and its rivals, the waterfall, and what stays open."""
    from needlefit.reporting.parameters import parameters_table

    show_head(results)
    table = parameters_table(results)
    rows = table.to_dict("records")
    table["known"] = [_known(row["sd"], row["sd_of"]) for row in rows]
    table["as_good"] = [_range(row["spread_low"], row["spread_high"]) for row in rows]
    several = table["fold"].nunique() > 1
    wanted = [name for name in _PARAMETERS if (name != "fold" or several) and _says(table[name])]
    screen.show_frame(table[wanted].rename(columns=_PARAMETERS), "Parameters.")
    for fold, starts in results.starts.query("fit == 'fitted'").groupby("fold", sort=False):
        screen.say(f"Fold {fold}. {waterfall(starts)}" if several else waterfall(starts))
    for sentence in open_questions(table, results.directions):
        screen.say(sentence)
    _show_verdict(results)
    screen.say()
    _show_errors(results)
    if results.posteriors:
        from needlefit.reporting.posterior import outside_said, percentiles_table, unconverged_said

        state = " NOT CONVERGED: they are not final." if unconverged_said(results) else ""
        screen.show_frame(percentiles_table(results), f"Posterior: percentiles in Pa and mm.{state}")
        screen.say(outside_said(results))
    if results.origin == "synthetic" and "hand_tuned" in set(results.errors["rival"]):
        screen.say("The paper's set was not tuned on this data; the fair rival is the one with b re-tuned.")


def _show_verdict(results: "Results") -> None:
    """Print what profiles, information and contraction say of each parameter."""
    from needlefit.reporting.identification_said import verdict_said

    said = verdict_said(results.identification)
    if said:
        screen.say("Profile likelihoods, 95 %, drawn in profiles.pdf:")
    for sentence in said:
        screen.say(f"  {sentence}")


def _known(sd: float, of: str) -> str:
    """Return a standard deviation for people: of a logarithm in percent, or as a factor where it is large."""
    if not math.isfinite(sd):
        return ""
    if of != "ln":
        return f"+-{sd:.2g}"
    return f"+-{100 * sd:.2g} %" if sd < 0.5 else f"a factor of {math.exp(sd):.2g}"


def _range(low: float, high: float) -> str:
    return f"{low:.3g} ... {high:.3g}" if math.isfinite(low) and math.isfinite(high) else ""


def as_json(results: "Results") -> dict[str, Any]:
    """Return the fit for machines: rows under the column names of the files."""
    from needlefit.reporting.parameters import parameters_table
    from needlefit.reporting.posterior import percentiles_table

    about = {"name": results.name, "origin": results.origin, "dataset": results.dataset_title}
    frames = {"parameters": parameters_table(results)}
    frames |= {name: getattr(results, name) for name in ("errors", "starts", "failures", "directions")}
    frames |= {"identification": results.identification, "profiles": results.profiles}
    if results.posteriors:
        frames["posterior"] = percentiles_table(results)
    rows = {name: frame.to_dict("records") for name, frame in frames.items()}
    warnings = as_rows(warnings_of(results.run))
    return {**about, "interrupted": results.interrupted, KEY: warnings, **rows}


def waterfall(starts: "pd.DataFrame") -> str:
    """Say how many starts of one search end practically as well as the best."""
    best, agree = starts["objective"].min(), int(starts["as_good"].sum())
    posterior = (starts["minimized"] == "posterior").all()
    at = f"-log posterior {best:.6g}, within 0.1 of it" if posterior else f"{best:.4g} mm"
    share = f"{agree} of {len(starts)} starts end practically as well as the best ({at})"
    ended = int((starts["stopped"] == "budget").sum())
    spent = f"; {ended} ended because their budget was spent: raise the recipe's evaluations" if ended else ""
    return f"Waterfall: {share} (all of them in starts.csv){spent}."


def open_questions(parameters: "pd.DataFrame", directions: "pd.DataFrame") -> list[str]:
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


def _says(column: "pd.Series[Any]") -> bool:
    return bool((column.notna() & (column.astype(str) != "")).any())


def _show_errors(results: "Results") -> None:
    from needlefit.reporting.names import rival_name

    errors = results.errors.query("role == 'tune' and boundaries == 'measured'")
    means = errors.groupby("rival", sort=False)[list(_METRICS)].mean().reset_index()
    names = [rival_name(str(rival), results) for rival in means["rival"]]
    count = errors["insertion"].nunique()
    title = f"Errors on the {count} tuning insertion{'s' if count > 1 else ''}, mean over insertions."
    screen.show_frame(means.assign(rival=names).round(3).rename(columns=_METRICS), title)
