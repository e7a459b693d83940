"""What a report says in words: the answer first, its noise floor and its rivals in the same breath."""

from collections.abc import Mapping

from needlefit.project.result_warnings import WARNINGS_KEY
from needlefit.reporting.contest import compared_said, losses_said, scored_role
from needlefit.reporting.names import layers_name, medium_name
from needlefit.reporting.numbers import fixed, symbol
from needlefit.reporting.parameters import held_fixed, undetermined
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import Results
from needlefit.validation.summary import aggregate, count_reasons
from needlefit.validation.validity import VALIDITY_KEY as VALIDITY
from needlefit.validation.validity import describe_outside

_SHOWN_ELSEWHERE = (
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


def in_short(results: Results) -> list[str]:
    """Return the answer: one sentence per held-out group, then how it stands against its rivals.

    A study without a row of the paper is about its empirical curves, so each one's difference is given;
    of the others only the rivals that do better, named in the same breath as the errors.
    """
    rows = records(validation_table(results))
    if not rows:
        return [_fit_answer(results)]
    printed = any(row["paper_te_mm"] is not None for row in rows)
    rivals = losses_said(results) if printed else compared_said(results)
    return [*(_answer(row) for row in rows), *([rivals] if rivals else [])]


def undetermined_said(results: Results) -> str:
    """Return which parameters the data leave open."""
    open_ones = undetermined(results)
    if not (results.parameters["method"] == "fitted").any():
        return "The search gave no parameters."
    fixed_ones = held_fixed(results)
    alone = "" if len(results.identification) else " Judged by the information at the optimum alone."
    said = f" Held fixed, not fitted: {_symbols(fixed_ones)}." if fixed_ones else ""
    if not open_ones:
        return f"The data determine every free parameter, as far as this model and its noise go.{alone}{said}"
    where = ", in at least one fold" if results.parameters["fold"].nunique() > 1 else ""
    return (
        f"The data do not determine {_symbols(open_ones)}{where}: printed as such, because the prediction "
        f"used one of many values that fit practically as well, and that value is no estimate.{alone}{said}"
    )


def failures_said(results: Results) -> str:
    """Return how many evaluations failed and why; nothing if none did."""
    failed = int(results.starts["failed_solves"].sum())
    evaluations = int(results.starts["evaluations"].sum())
    sampled = sum(posterior.failures for posterior in results.posteriors.values())
    if not failed + sampled:
        return ""
    recorded = len(results.failures)
    counts = ", ".join(f"{count} {reason}" for reason, count in count_reasons(results.failures).items())
    said = f"{failed} of {evaluations} evaluations failed"
    said += f", and {sampled} of the sampler's" if sampled else ""
    if recorded == failed + sampled:
        return f"{said}: {counts}; failures.csv holds their parameters."
    return f"{said}; failures.csv holds the parameters of the first {recorded}: {counts}."


def validity_said(results: Results) -> str:
    """Return how many simulations are outside what the model assumes; nothing if none is."""
    words = describe_outside(results.run)
    return f"Outside what the model assumes: {words}." if words else ""


def floor_said(results: Results) -> str:
    """Return what perfect parameters would still show."""
    row = _overall(results)
    if row is None or row["floor_ipe_mean_mm"] is None:
        return (
            "The dataset states no measurement noise: no noise floor can be given, and the fit minimises the "
            "errors themselves, for without noise a posterior has no width."
        )
    digits = _digits(row["floor_ipe_mean_mm"])
    cells = [
        f"{name} {fixed(row[f'floor_{key}_mm'], digits)} mm"
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


def run_said(run: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what the run was, a line per key; what the report shows elsewhere is left to run.json."""
    said = [(key, _line(value)) for key, value in sorted(run.items()) if key not in _SHOWN_ELSEWHERE]
    return [(key.replace("_", " "), line) for key, line in said if line]


def _answer(row: Row) -> str:
    digits = 3 if row["comparison"] == "aligned" else 2

    def both(prefix: str) -> str:
        return f"{fixed(row[f'{prefix}ipe_mean_mm'], digits)} and {fixed(row[f'{prefix}te_mm'], digits)} mm"

    study = f"Study {row['study']}, " if isinstance(row["study"], int) else ""
    what = f"{medium_name(row['validate_medium'])}, {layers_name(row['validate_layers'])}"
    count = "1 insertion" if row["insertions"] == 1 else f"{row['insertions']} insertions"
    said = f"{study}{what} ({count}): mean IPE and TE {both('')}"
    said += f"; noise floor {both('floor_')}" if row["floor_te_mm"] is not None else ""
    said += f"; the paper {both('paper_')}" if row["paper_te_mm"] is not None else ""
    return said[:1].upper() + said[1:] + "."


def _fit_answer(results: Results) -> str:
    row = _overall(results)
    if row is None:
        return f"{results.name}: nothing could be scored."
    digits = _digits(row["ipe_mean_mm"])
    cells = f"{fixed(row['ipe_mean_mm'], digits)} and {fixed(row['te_mm'], digits)} mm"
    return (
        f"{results.name}: mean IPE and TE {cells} on the {row['insertions']} insertions that tuned "
        "it. Nothing is held out, so this says how well the model can follow them, not how well it predicts."
    )


def _symbols(names: list[str]) -> str:
    return ", ".join(symbol(name).split(" (")[0] for name in names)


def _overall(results: Results) -> Row | None:
    """Return the fitted model's errors over everything it is scored on, or None if it was not."""
    wanted = (scored_role(results), "fitted", "measured")
    rows = records(aggregate(results, ("role", "method", "boundaries")))
    return next((r for r in rows if (r["role"], r["method"], r["boundaries"]) == wanted), None)


def _digits(value: float | None) -> int:
    return 3 if value is not None and value < 0.1 else 2


def _line(value: object) -> str:
    """Return a value of run.json on one line; digests are cut, notes stand elsewhere."""
    if isinstance(value, Mapping):
        pairs = ((str(key), _line(item)) for key, item in sorted(value.items()) if key != "notes")
        return "; ".join(f"{key.replace('_', ' ')} {line}" for key, line in pairs if line)
    if isinstance(value, list | tuple):
        return ", ".join(_line(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    words = "" if value is None else str(value)
    return f"{words[:16]}…" if len(words) >= 40 and " " not in words else words
