"""What `tune` prints: the fit beside its rivals, how the starts agree, and what stays open."""

from typing import TYPE_CHECKING, Any

from needlefit.cli import screen
from needlefit.cli.show_validation import origin

if TYPE_CHECKING:
    import pandas as pd

    from needlefit.validation.results import Results

_NAMES = {"fitted": "fitted", "hand_tuned": "paper, by hand", "hand_tuned_b": "paper, b re-tuned"}
_METRICS = ["median_err_mm", "ipe_mean_mm", "ipe_max_mm", "te_mm", "edp_percent"]
_AGREE = 0.01


def show_tuning(results: "Results") -> None:
    """Print the parameters and errors of the fit and its rivals, the waterfall, and what stays open."""
    screen.say(f"{results.name}: {results.title}")
    screen.say(f"  {origin(results)}")
    if results.interrupted:
        screen.say("  INTERRUPTED: the best found so far")
    for fold, rows in results.parameters.groupby("fold", sort=False):
        several = results.parameters["fold"].nunique() > 1
        _show_parameters(rows, f"Parameters, {fold}" if several else "Parameters")
        screen.say(waterfall(results.starts.query("fold == @fold and fit == 'fitted'")))
        for sentence in open_questions(rows, results.directions.query("fold == @fold")):
            screen.say(sentence)
    _show_errors(results)
    if results.origin == "synthetic" and "hand_tuned" in set(results.errors["rival"]):
        screen.say("The paper's hand-tuned set was not tuned on this data; the fair rival has b re-tuned.")


def as_json(results: "Results") -> dict[str, Any]:
    """Return the fit for machines: every frame as rows under its column names."""
    frames = ("parameters", "errors", "starts", "directions")
    rows = {name: getattr(results, name).to_dict("records") for name in frames}
    about = {"name": results.name, "origin": results.origin, "dataset": results.dataset_title}
    return {**about, "interrupted": results.interrupted, **rows}


def waterfall(starts: "pd.DataFrame") -> str:
    """Say how many starts of one search end at practically the same objective as the best."""
    best = starts["objective"].min()
    agree = int((starts["objective"] <= best * (1 + _AGREE)).sum())
    failed = int(starts["failed_solves"].sum())
    share = f"{agree} of {len(starts)} starts end within {_AGREE:.0%} of the best objective"
    text = f"Waterfall: {share}, {best:.4g}"
    return f"{text}; {failed} failed solves." if failed else f"{text}."


def open_questions(parameters: "pd.DataFrame", directions: "pd.DataFrame") -> list[str]:
    """Return sentences on what one fit's data do not determine."""
    free = parameters.query("rival == 'fitted' and status == 'free'")
    loose = free[~free["determined"].astype(bool)]
    sentences = [
        f"NOT determined by these data: {row.parameter} (practically equal fits from {row.spread_low:.3g} "
        f"to {row.spread_high:.3g}){f'; {row.note}' if row.note else ''}"
        for row in loose.itertuples()
    ]
    return [*sentences, *(f"Known to {row.sd:.2g}: {row.words}" for row in directions.itertuples())]


def _show_parameters(rows: "pd.DataFrame", title: str) -> None:
    rivals = [rival for rival in _NAMES if rival in set(rows["rival"])]
    values = {rival: rows[rows["rival"] == rival].set_index("parameter")["value"] for rival in rivals}
    fitted = rows[rows["rival"] == "fitted"]
    table = [
        [
            row.parameter,
            *(values[rival].get(row.parameter) for rival in rivals),
            row.status,
            row.sd,
            ("yes" if row.determined else "NO") if row.status == "free" else "",
        ]
        for row in fitted.itertuples()
    ]
    columns = ["parameter", *(_NAMES[rival] for rival in rivals), "status", "sd", "determined"]
    screen.show_table(columns, table, title)


def _show_errors(results: "Results") -> None:
    errors = results.errors.query("role == 'tune' and boundaries == 'measured'")
    means = errors.groupby("rival", sort=False)[_METRICS].mean()
    rows = [
        [_NAMES.get(str(rival), str(rival).replace("_", " ")), *row]
        for rival, row in zip(means.index, means.to_numpy().tolist(), strict=True)
    ]
    labels = ["", "median mm", "IPE mm", "max mm", "TE mm", "EDP %"]
    screen.show_table(
        labels, rows, f"Errors on the {errors['insertion'].nunique()} tuning insertions, mean over insertions"
    )
