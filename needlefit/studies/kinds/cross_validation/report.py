"""The report of a fit or cross-validation: tables, figures, files, and the blocks of its text."""

from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.metrics import list_metrics
from needlefit.reporting import document, latex
from needlefit.reporting.columns import DIGITS, METRIC_FORMAT, find_column, format_value
from needlefit.reporting.document import Block
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures.fit_forms import draw_profiles
from needlefit.reporting.number_format import choose_interval_unit, insert_symbols, typeset_interval
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import to_records, to_tidy, write_csv
from needlefit.studies.identification_tables import (
    describe_verdicts,
    lay_out_identification,
    tabulate_identification,
)
from needlefit.studies.kinds.cross_validation import figures, tables
from needlefit.studies.kinds.cross_validation.differences import COMPARISONS
from needlefit.studies.kinds.cross_validation.explorer import collect_explorer
from needlefit.studies.kinds.cross_validation.facts import TEXT, Facts, find_scored_role, list_sentences, say
from needlefit.studies.kinds.cross_validation.posterior import (
    list_free_parameters,
    tabulate_percentiles,
)
from needlefit.studies.kinds.cross_validation.tables import (
    NOT_DETERMINED,
    arrange_parameters,
    is_conditional,
    lay_out_coverage,
    lay_out_posterior,
    tabulate_parameters,
)
from needlefit.studies.kinds.cross_validation.verdict import judge
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import (
    BY_LAYERS,
    BY_MEDIA,
    list_groups,
    list_held_out_groups,
    tabulate_tuning,
    tabulate_validation,
)
from needlefit.studies.slicer import write_needles

# ---- sentences


def summarize(results: Run) -> list[str]:
    """Return the main result: one sentence per held-out group, then the comparison with its baselines.

    A study without a row of the paper is about its empirical curves, so each one's difference is given;
    of the others only the methods that do better.
    """
    if not list_held_out_groups(results):
        return list_sentences(results, "fit")
    printed = any(group.printed for group in list_held_out_groups(results))
    return list_sentences(results, "groups", *(("better", "ties") if printed else ("curve_differences",)))


def explain(results: Run) -> tuple[list[TableLayout], list[str]]:
    """Return all tables, and sentences on the search, on what failed and on what the data determine."""
    shown = [*lay_out_tables(results), tables.lay_out_baselines([results], find_scored_role(results))]
    shown += [lay_out_coverage(results)] if len(results.frames["predictive"]) else []
    shown += [lay_out_posterior(results)] if results.posteriors else []
    held_out = bool(list_held_out_groups(results))
    errors = ["groups" if held_out else "fit", "conclusion"]
    errors += ["better_others", "ties"] if held_out else ["paper_sets"]
    sentences = [
        *list_sentences(results, *errors, "noise_floor", "prediction_set", "wide_intervals", "searches"),
        *map(insert_symbols, _name_folds(_list_undetermined(results))),
        *list_sentences(results, "combinations"),
        *map(insert_symbols, _name_folds(_list_verdicts(results))),
        *list_sentences(results, "failures", "validity", "unconverged", "outside_fits"),
    ]
    return shown, sentences


def _name_folds(found: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Yield the sentences of folds, each once, with the folds that it holds for unless these are all."""
    holders: dict[str, list[str]] = {}
    for fold, sentences in found.items():
        for sentence in sentences:
            holders.setdefault(sentence, []).append(fold)
    for sentence, folds in holders.items():
        several = "Folds" if len(folds) > 1 else "Fold"
        yield sentence if len(folds) == len(found) else f"{several} {', '.join(folds)}: {sentence}"


def _list_undetermined(results: Run) -> dict[str, list[str]]:
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


def _list_verdicts(results: Run) -> dict[str, list[str]]:
    """Return by fold the interval of each parameter, and under which assumption it is determined."""
    groups = results.frames["identification"].groupby("fold", sort=False)
    return {str(fold): describe_verdicts(rows) for fold, rows in groups}


# ---- tables


def tabulate_files(result: Run) -> dict[str, pd.DataFrame]:
    """Return the tables that are written as CSV, by name."""
    names = ("design", "errors", "shapes", "starts", "failures", "directions")
    frames = {name: result.frames[name] for name in names}
    predictions = [result.frames[name] for name in ("predictive", "predictive_training")]
    if any(map(len, predictions)):
        frames["predictive"] = pd.concat([frame for frame in predictions if len(frame)])
    frames |= {name: frame for name, frame, _ in lay_out_files([result], [result]) if len(frame)}
    if len(result.frames["identification"]):
        frames["identify"] = tabulate_identification(result.frames["identification"], result.origin)
    if result.posteriors:
        frames["posterior"] = tabulate_percentiles(result)
    return frames


def fit_to_json(result: Run) -> dict[str, Any]:
    """Return the errors beside the paper's; of a fit also its parameters, starts and what they determine."""
    frames = {"validation": tabulate_validation(result)}
    if result.kind == "fit":
        names = ("errors", "starts", "failures", "directions", "identification", "profiles")
        frames = {"parameters": tabulate_parameters(result), **{name: result.frames[name] for name in names}}
        if result.posteriors:
            frames["posterior"] = tabulate_percentiles(result)
    return {name: to_records(to_tidy(frame)) for name, frame in frames.items()}


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the tables of errors and parameters beside the paper's."""
    found = [table for _, _, layouts in lay_out_files([result], [result]) for table in layouts]
    return [table for table in found if table.rows]


def lay_out_files(
    studies: Sequence[Run], tunings: Sequence[Run]
) -> Iterator[tuple[str, pd.DataFrame, list[TableLayout]]]:
    """Yield the paper's tables with our rows beside its rows: name, rows, and the tables to print."""
    every = list({one.name: one for one in (*studies, *tunings)}.values())
    validation = tabulate_validation(*studies, with_alternate=True)
    yield "validation", validation, [tables.lay_out_validation(studies)]
    by = [tables.lay_out_tuning(tunings, grouping) for grouping in (BY_LAYERS, BY_MEDIA)]
    yield "tuning", tabulate_tuning(*tunings, with_alternate=True), by
    yield "parameters", tabulate_parameters(*every), [tables.lay_out_parameters(every)]


def _list_tables(results: Run) -> Iterator[TableLayout]:
    """Yield every table that a run's report prints."""
    role = find_scored_role(results)
    baselines = tables.lay_out_baselines([results], role)
    yield tables.lay_out_design([results])
    yield tables.lay_out_validation([results])
    yield from (tables.lay_out_tuning([results], grouping) for grouping in (BY_LAYERS, BY_MEDIA))
    if len(results.frames["predictive"]):
        yield lay_out_coverage(results)
    if len(baselines.rows) > 1:
        yield baselines
    yield tables.lay_out_parameters([results])
    yield tables.lay_out_directions(results)
    if len(results.frames["identification"]):
        yield lay_out_identification(results.frames["identification"])
    if results.posteriors:
        yield lay_out_posterior(results)
    yield tables.lay_out_insertions(results, role)


# ---- files


def write_files(result: Run, folder: Path) -> None:
    """Write the numbers and methods for a paper, and every needle in its scan."""
    # With every digit: it is exactly these values that fail again.
    write_csv(result.frames["failures"].assign(origin=result.origin), folder / "failures.csv", digits=None)
    if len(result.frames["needles"]):
        write_needles(result, folder / "slicer")
    (folder / "numbers.tex").write_text(format_macros([result]), encoding="utf-8")
    if Facts(result).has_methods:
        lines, cited = format_methods(result)
        (folder / "methods.tex").write_text(lines, encoding="utf-8")
        (folder / "references.bib").write_text(format_references(cited), encoding="utf-8")


def format_methods(result: Run) -> tuple[str, list[str]]:
    """Return the methods paragraph as LaTeX, and the keys of `references.bib` that it cites."""
    values = {"facts": Facts(result)}
    parts = [TEXT.format_latex(block, values) for block in ("methods_data", "methods")]
    cited = dict.fromkeys(key for _, keys in parts for key in keys)
    return "\n".join(lines for lines, _ in parts if lines) + "\n", list(cited)


_REFERENCES_HEAD = (
    "% Cited by methods.tex. Needs \\usepackage{url} and, at the end, \\bibliographystyle and "
    "\\bibliography{references}."
)


def format_references(cited: Sequence[str]) -> str:
    """Return the BibTeX entries of these keys, which ship with needlefit."""
    text = (files("needlefit.reporting") / "templates" / "references.bib").read_text(encoding="utf-8")
    entries = [entry.strip() for entry in text.split("\n\n") if entry.strip()]
    known = {entry.split("{", 1)[1].split(",", 1)[0]: entry for entry in entries}
    return "\n\n".join([_REFERENCES_HEAD, *(known[key] for key in cited)]) + "\n"


def format_macros(results: Sequence[Run]) -> str:
    """Return a LaTeX file of macros of every printed number, by readable keys.

    A key is `<run>-<medium>-<layers>-<error>`, with `floor-` or `paper-` before the error for what stands
    beside it or `-over-floor` after it for the multiple of its noise floor; `<run>-<parameter>`, with `-low`,
    `-high` and `-interval` of its 95 % interval (`-interval` alone where that is "not determined"), all in
    the unit of the tables, `-unit`; or that of a cell of a table (`format_table_macros`).
    """
    return latex.format_macros(number for one in results for number in _list_numbers(one))


def _list_numbers(results: Run) -> Iterator[tuple[str, str]]:
    yield from _list_errors(results)
    yield from _list_parameters(results)
    yield from latex.list_cells(results.name, tuple(_list_tables(results)))


def _list_errors(results: Run) -> Iterator[tuple[str, str]]:
    for group in list_held_out_groups(results):
        head = group.head
        begin = f"{results.name}-{head['medium']}-{head['layers']}"
        yield f"{begin}-n", str(head["insertions"])
        for metric in list_metrics():
            row = {"metric": metric.name, DIGITS: 3 if head["comparison"] == "aligned" else 2}
            for key, column in (("", "value"), ("floor-", "floor"), ("paper-", "paper")):
                value = group.get(metric.name, column)
                if value is not None or not key:
                    yield f"{begin}-{key}{metric.macro_name}", format_value(METRIC_FORMAT, value, row)
            if (times := group.over_floor(metric.name)) is not None:
                words = find_column("over_floor").format_cell({"over_floor": times})
                yield f"{begin}-{metric.macro_name}-over-floor", words


def _list_parameters(results: Run) -> Iterator[tuple[str, str]]:
    table = arrange_parameters(tabulate_parameters(results))
    several = len({row["fold"] for row in table}) > 1
    for row in table:
        name = str(row["parameter"]).removesuffix("_pa").removesuffix("_mm").replace("_", "-")
        where = f"-{row['fold']}" if several else ""
        key = f"{results.name}{where}-{name}"
        label, scale = choose_interval_unit(row, row["value_used"])
        yield key, tables.format_in_unit(row["fitted"], scale)
        if unit := label.partition(" (")[2].rstrip(")"):
            yield f"{key}-unit", unit
        if interval := typeset_interval(row, scale):
            yield f"{key}-interval", interval
            low, to, high = interval.partition(" to ")
            yield from ((f"{key}-low", low), (f"{key}-high", high)) if to else ()


# ---- figures and sections


def draw_figures(results: Run, folder: Path) -> dict[str, Path]:
    """Draw what the tables allow to be drawn."""
    role, frames = find_scored_role(results), results.frames
    found: dict[str, Drawing] = {}
    if all(_has_fitted(frames[name], role) for name in ("errors", "shapes")):
        found |= figures.draw_insertions(results, role)
    if len(frames["draws"]) and list_free_parameters(results):
        found["corner"] = figures.draw_corner(results)
    if len(frames["starts"]) and not Facts(results).agreement:
        found["waterfall"] = figures.draw_starts(results)
    drawn = {name: one.save(folder / f"{name}.pdf") for name, one in found.items()}
    if len(frames["profiles"]):
        drawn["profiles"] = draw_profiles(
            frames["identification"], frames["profiles"], results.origin, folder / "profiles.pdf"
        )
    return drawn | draw_error_figures([results], folder)


def draw_error_figures(results: Sequence[Run], folder: Path) -> dict[str, Path]:
    """Draw the errors on held-out insertions, if there are any."""
    if tabulate_validation(*results).empty:
        return {}
    return {name: one.save(folder / f"{name}.pdf") for name, one in figures.draw_errors(results).items()}


def _has_fitted(frame: pd.DataFrame, role: str) -> bool:
    return bool(((frame["role"] == role) & (frame["method"] == "fitted")).any())


def compose_sections(results: Run, paths: FigurePaths) -> list[Block]:
    """Return the report below its verdicts: evidence, schematic and errors in short; then errors and
    coverage, parameters, insertions, methods; diagnostics last.
    """
    shown = [*_list_tables(results), tables.lay_out_summary([results])]
    shown.append(tables.lay_out_all_errors(results))
    methods = list_sentences(results, "methods") if Facts(results).has_methods else []
    paragraph = {"methods": [document.text(" ".join(methods))]}
    return TEXT.compose("report", {"facts": Facts(results)}, shown, paths, paragraph)


def tuning_tables(results: Sequence[Run]) -> list[TableLayout]:
    """Return the in-sample tables; by media only where the paper has a cell."""
    groups = list_groups(tabulate_tuning(*results))
    printed = any(group.head["grouping"] == BY_MEDIA and group.printed for group in groups)
    groupings = (BY_LAYERS, BY_MEDIA) if printed else (BY_LAYERS,)
    return [tables.lay_out_tuning(results, by) for by in groupings if groups]


REPORT = StudyReport(
    summarize=summarize,
    lay_out=lay_out_tables,
    draw=draw_figures,
    compose=compose_sections,
    tabulate=tabulate_files,
    write_files=write_files,
    to_json=fit_to_json,
    comparisons=COMPARISONS,
    compares_only_these=True,
    judge=judge,
    explore=collect_explorer,
    lay_out_first=lambda results: [
        tables.lay_out_summary([results]),
        tables.lay_out_values(results),
    ],
    explain=explain,
    say=say,
)
