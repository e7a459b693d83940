"""What `--explain` prints of a fit or cross-validation: how the search ended, what the data determine."""

from collections.abc import Iterator, Mapping, Sequence

import pandas as pd

from needlefit.inference.identifiability.precision import UNINFORMED_SD_RATIO
from needlefit.reporting.number_format import insert_symbols
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.identification_tables import describe_verdicts
from needlefit.studies.kinds.cross_validation.detail_tables import lay_out_baselines
from needlefit.studies.kinds.cross_validation.files import lay_out_tables
from needlefit.studies.kinds.cross_validation.parameter_table import (
    NOT_DETERMINED,
    arrange_parameters,
    is_conditional,
    tabulate_parameters,
)
from needlefit.studies.kinds.cross_validation.posterior import (
    describe_outside_fits,
    describe_unconverged,
    lay_out_posterior,
)
from needlefit.studies.kinds.cross_validation.score_tables import lay_out_coverage
from needlefit.studies.kinds.cross_validation.sentences import (
    describe_failures,
    describe_noise_floor,
    describe_prediction_set,
    describe_validity,
    explain_errors,
    find_scored_role,
)
from needlefit.studies.kinds.cross_validation.verdict import describe_wide_intervals
from needlefit.studies.run import Run


def explain(results: Run) -> tuple[list[TableLayout], list[str]]:
    """Return all tables, and sentences on the search, on what failed and on what the data determine."""
    role = find_scored_role(results)
    tables = [*lay_out_tables(results), lay_out_baselines([results], role)]
    tables += [lay_out_coverage(results)] if len(results.frames["predictive"]) else []
    tables += [lay_out_posterior(results)] if results.posteriors else []
    return tables, _list_sentences(results)


def _list_sentences(results: Run) -> list[str]:
    sentences = [
        *explain_errors(results),
        describe_noise_floor(results),
        describe_prediction_set(results),
        *describe_wide_intervals(results),
        *_describe_searches(results.frames["starts"]),
        *map(insert_symbols, _name_folds(_describe_undetermined(results))),
        *map(insert_symbols, _describe_combinations(results)),
        *map(insert_symbols, _name_folds(_list_verdicts(results))),
        describe_failures(results),
        describe_validity(results),
        describe_unconverged(results),
        describe_outside_fits(results) if results.posteriors else "",
    ]
    return [sentence for sentence in sentences if sentence]


def _describe_searches(starts: pd.DataFrame) -> Iterator[str]:
    fitted = starts[starts["fit"] == "fitted"]
    several = fitted["fold"].nunique() > 1
    for fold, rows in fitted.groupby("fold", sort=False):
        yield f"{f'Fold {fold}: ' if several else ''}{_describe_starts(rows)}"


def _describe_starts(starts: pd.DataFrame) -> str:
    """Return how many starts of one search end within tolerance of the optimum."""
    best, agree = starts["objective"].min(), int(starts["within_tolerance"].sum())
    posterior = (starts["minimized"] == "posterior").all()
    at = (
        f"0.1 of the lowest -log posterior ({best:.6g})"
        if posterior
        else f"tolerance of the lowest objective ({best:.4g} mm)"
    )
    share = f"{agree} of {len(starts)} starts end within {at}"
    ended = int((starts["stopped"] == "budget").sum())
    spent = f"; {ended} stopped at the limit of evaluations: raise the recipe's evaluations" if ended else ""
    return f"{share}; all starts are in starts.csv{spent}."


def _name_folds(found: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Yield the sentences of folds, each once, with the folds that it holds for unless these are all."""
    holders: dict[str, list[str]] = {}
    for fold, sentences in found.items():
        for sentence in sentences:
            holders.setdefault(sentence, []).append(fold)
    for sentence, folds in holders.items():
        several = "Folds" if len(folds) > 1 else "Fold"
        yield sentence if len(folds) == len(found) else f"{several} {', '.join(folds)}: {sentence}"


def _describe_undetermined(results: Run) -> dict[str, list[str]]:
    """Return by fold what the data do not determine."""
    rows = arrange_parameters(tabulate_parameters(results))
    # `describe_verdicts` names the conditions of these
    judged = set(results.frames["identification"]["parameter"])
    found: dict[str, list[str]] = {str(row["fold"]): [] for row in rows}
    for row in rows:
        conditional = row["parameter"] in judged and is_conditional(row)
        if row["status"] == "free" and not row["determined"] and not conditional:
            note = str(row["note"] or NOT_DETERMINED)
            words = note if "determined" in note else f"{NOT_DETERMINED}: {note}"
            found[str(row["fold"])].append(f"{row['parameter']}: {words}.")
    return found


def _describe_combinations(results: Run) -> Iterator[str]:
    """Yield how well the data of each fold determine combinations of parameters."""
    directions = results.frames["directions"]
    several = directions["fold"].nunique() > 1
    informed = directions[~(directions["sd_ratio"].astype(float) >= UNINFORMED_SD_RATIO)]
    for fold, rows in informed.groupby("fold", sort=False):
        yield f"Combinations of parameters{f', fold {fold}' if several else ''}, linear about the fit:"
        yield from (f"  {row.note}." for row in rows.itertuples())


def _list_verdicts(results: Run) -> dict[str, list[str]]:
    """Return by fold the interval of each parameter, and under which assumption it is determined."""
    groups = results.frames["identification"].groupby("fold", sort=False)
    return {str(fold): describe_verdicts(rows) for fold, rows in groups}
