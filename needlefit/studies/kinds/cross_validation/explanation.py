"""What `--explain` prints of a fit or cross-validation: how the search ended, what the data determine."""

from collections.abc import Iterator

import pandas as pd

from needlefit.inference.identifiability.information import UNINFORMED_SD_RATIO
from needlefit.reporting.number_format import insert_symbols
from needlefit.reporting.table_files import to_records
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
    find_scored_role,
    summarize_baselines,
    summarize_errors,
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
        *summarize_errors(results),
        summarize_baselines(results),
        describe_noise_floor(results),
        describe_prediction_set(results),
        *describe_wide_intervals(results),
        *_describe_searches(results.frames["starts"]),
        *map(insert_symbols, _describe_undetermined(results)),
        *map(insert_symbols, describe_verdicts(results.frames["identification"])),
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


def _describe_undetermined(results: Run) -> Iterator[str]:
    """Yield what the data do not determine, and how well they determine combinations."""
    table = pd.DataFrame(arrange_parameters(tabulate_parameters(results)))
    if table.empty:
        return
    free = table[table["status"] == "free"]
    loose = free[~free["determined"].astype(bool)].drop_duplicates(["parameter", "note"])
    judged = set(results.frames["identification"]["parameter"])  # `describe_verdicts` names their conditions
    for row in to_records(loose):
        if not (row["parameter"] in judged and is_conditional(row)):
            note = str(row["note"] or NOT_DETERMINED)
            yield f"{row['parameter']}: {note if 'determined' in note else f'{NOT_DETERMINED}: {note}'}."
    directions = results.frames["directions"]
    informed = directions[~(directions["sd_ratio"].astype(float) >= UNINFORMED_SD_RATIO)]
    if len(informed):
        yield "Combinations of parameters, linear about the fit:"
    yield from (f"  {row.note}." for row in informed.itertuples())
