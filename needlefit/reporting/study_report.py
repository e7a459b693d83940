"""Compose the report of one study or fit, section by section, and the overview of several studies."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from needlefit.reporting import detail_tables, document, labels, score_tables, sentences
from needlefit.reporting.comparability import SYNTHETIC_NOTE
from needlefit.reporting.document import Block, Document
from needlefit.reporting.identification_tables import describe_verdicts, lay_out_identification
from needlefit.reporting.methods_paragraph import format_methods_text
from needlefit.reporting.number_format import insert_symbols
from needlefit.reporting.posterior import (
    describe_draws,
    describe_outside_fits,
    describe_unconverged,
    lay_out_posterior,
)
from needlefit.reporting.score_tables import lay_out_coverage
from needlefit.reporting.table_layout import TableLayout, text_column
from needlefit.reporting.tables import study_label, tabulate_tuning, to_records
from needlefit.validation import paper
from needlefit.validation.results import Results

FigurePaths = Mapping[str, Path]


def compose_report(results: Results, figures: FigurePaths) -> Document:
    """Return the report: question, data, parameters, errors beside the paper's, baselines, figures, run."""
    synthetic = results.origin == "synthetic"
    blocks = [
        *warning_blocks([results]),
        document.bullets(sentences.summarize_errors(results)),
        *_question_blocks(results, synthetic),
        *_parameter_blocks(results, figures, synthetic),
        *_identifiability_blocks(results, figures, synthetic),
        *_error_blocks(results, figures, synthetic),
        *_baseline_blocks(results, figures, synthetic),
        *_insertion_blocks(results, figures, synthetic),
        *run_blocks(results, synthetic),
    ]
    subtitle = f"{results.name} · {results.dataset_title}"
    return Document(results.title or results.name, subtitle, synthetic, tuple(blocks))


def warning_blocks(results: list[Results]) -> list[Block]:
    """Return the warnings that must be read before any number."""
    summary = []
    if any(one.origin == "synthetic" for one in results):
        summary.append(
            document.warning(
                f"SYNTHETIC DATA. {SYNTHETIC_NOTE.removeprefix('Synthetic data: ').capitalize()}"
            )
        )
    stopped = [one.name for one in results if one.interrupted]
    if stopped:
        summary.append(
            document.warning(
                f"INTERRUPTED: {', '.join(stopped)}. The search was stopped; this is its best so far."
            )
        )
    failed = [(one.name, _count_failures(one)) for one in results]
    summary += [
        document.warning(
            f"NOT CONVERGED: {name}, {count} scored simulations of the fitted model. They have no errors and "
            "are missing from every mean."
        )
        for name, count in failed
        if count
    ]
    summary += [
        document.warning(f"NOT CONVERGED: {one.name}: {'; '.join(faults)}.")
        for one in results
        if (faults := [fault for found in one.run.get("search_faults", {}).values() for fault in found])
    ]
    return summary + [block for one in results for block in document.run_warning_blocks(one.run, one.name)]


def figure_blocks(figures: FigurePaths, name: str, caption: str, synthetic: bool) -> list[Block]:
    """Return the block of a figure if it was drawn."""
    return [document.figure(figures[name], caption, synthetic)] if name in figures else []


def run_blocks(results: Results, synthetic: bool) -> list[Block]:
    """Return the settings of the run."""
    rows = tuple(sentences.describe_run(results.run))
    if not rows:
        return []
    table = TableLayout(
        "run",
        f"What {results.name} was computed with.",
        (text_column("What"), text_column("Value", wide=True)),
        rows,
    )
    return [
        *_methods_blocks(results),
        document.heading("Run"),
        document.text("The file run.json holds all of this in full; the same inputs give the same bytes."),
        document.table(table, synthetic),
    ]


def _methods_blocks(results: Results) -> list[Block]:
    summary = format_methods_text(results)
    if not summary:
        return []
    return [
        document.heading("Methods"),
        document.text(summary),
        document.text("The same as LaTeX, with citations: methods.tex and references.bib."),
    ]


def tuning_blocks(results: Sequence[Results], synthetic: bool) -> list[Block]:
    """Return the in-sample tables; by media only where the paper has a cell."""
    rows = to_records(tabulate_tuning(*results))
    printed = any(row["grouping"] == "media" and row["paper_te_mm"] is not None for row in rows)
    groupings = ("layers", "media") if printed else ("layers",)
    return [document.table(score_tables.lay_out_tuning(results, by), synthetic) for by in groupings if rows]


def _question_blocks(results: Results, synthetic: bool) -> list[Block]:
    return [
        document.heading("Question and data"),
        *([document.text(results.question)] if results.question else []),
        document.text(f"{results.dataset_title}. {sentences.describe_noise_floor(results)}"),
        *(document.text(note) for note in results.run.get("dataset", {}).get("notes", ())),
        document.table(score_tables.lay_out_design([results]), synthetic),
    ]


def _parameter_blocks(results: Results, figures: FigurePaths, synthetic: bool) -> list[Block]:
    directions = detail_tables.lay_out_directions(results)
    summary = [
        text for text in (sentences.describe_failures(results), sentences.describe_validity(results)) if text
    ]
    return [
        document.heading("Parameters"),
        document.text(sentences.describe_undetermined(results)),
        document.table(detail_tables.lay_out_parameters([results]), synthetic),
        document.table(directions, synthetic),
        *_posterior_blocks(results, figures, synthetic),
        *map(document.text, summary),
        *figure_blocks(figures, "waterfall", labels.WATERFALL_CAPTION, synthetic),
    ]


def _identifiability_blocks(results: Results, figures: FigurePaths, synthetic: bool) -> list[Block]:
    """Return what a fit was found to determine; a study's folds are not examined."""
    if results.identification.empty:
        return []
    return [
        document.heading("Identifiability"),
        document.bullets([insert_symbols(summary) for summary in describe_verdicts(results.identification)]),
        *figure_blocks(figures, "profiles", labels.PROFILES_CAPTION, synthetic),
        document.table(lay_out_identification(results.identification), synthetic),
    ]


def _posterior_blocks(results: Results, figures: FigurePaths, synthetic: bool) -> list[Block]:
    summary = [s for s in (describe_unconverged(results), describe_outside_fits(results)) if s]
    table = [document.table(lay_out_posterior(results), synthetic)] if results.posteriors else []
    drawn = f"{labels.CORNER_CAPTION} {describe_draws(results)}" if "corner" in figures else ""
    return [*map(document.text, summary), *table, *figure_blocks(figures, "corner", drawn, synthetic)]


def _error_blocks(results: Results, figures: FigurePaths, synthetic: bool) -> list[Block]:
    blocks = [document.heading("Errors")]
    if sentences.find_scored_role(results) == "validate":
        blocks += figure_blocks(figures, "boxplot", labels.BOXPLOT_CAPTION, synthetic)
        blocks.append(document.table(score_tables.lay_out_validation([results]), synthetic))
    if len(results.predictive):
        blocks.append(document.table(lay_out_coverage(results), synthetic))
        blocks += figure_blocks(figures, "predicted", labels.PREDICTIVE_CHECK_CAPTION, synthetic)
    return [*blocks, *tuning_blocks([results], synthetic)]


def _baseline_blocks(results: Results, figures: FigurePaths, synthetic: bool) -> list[Block]:
    role = sentences.find_scored_role(results)
    table = detail_tables.lay_out_baselines([results], role)
    if len(table.rows) < 2:
        return []
    return [
        document.heading("Baselines"),
        document.text(sentences.summarize_baselines(results)),
        document.table(table, synthetic),
        *figure_blocks(figures, "baselines", labels.BASELINES_CAPTION, synthetic),
    ]


def _insertion_blocks(results: Results, figures: FigurePaths, synthetic: bool) -> list[Block]:
    role = sentences.find_scored_role(results)
    if results.errors.empty:
        return []
    return [
        document.heading("Single insertions"),
        *figure_blocks(figures, "overlays", labels.OVERLAYS_CAPTION, synthetic),
        *figure_blocks(figures, "residuals", labels.RESIDUALS_CAPTION, synthetic),
        document.table(detail_tables.lay_out_insertions(results, role), synthetic),
    ]


def _count_failures(results: Results) -> int:
    errors = results.errors[results.errors["method"] == "fitted"]
    return int((~errors["converged"].astype(bool)).sum())


def compose_overview(
    results: Sequence[Results],
    tunings: Sequence[Results],
    figures: FigurePaths,
    appendix: Sequence[Block] = (),
) -> Document:
    """Return one report over all studies: errors, baselines, tuning, parameters, contradictions in the paper.

    `appendix` is what was asked besides, and answered.
    """
    synthetic = any(one.origin == "synthetic" for one in results)
    blocks = [
        *warning_blocks(list(results)),
        document.bullets([line for one in results for line in sentences.summarize_errors(one)]),
        document.heading("Errors on held-out insertions, beside the paper’s"),
        *figure_blocks(figures, "boxplot", labels.BOXPLOT_CAPTION, synthetic),
        document.table(score_tables.lay_out_validation(results), synthetic),
        *_overview_baselines(results, figures, synthetic),
        *_overview_predictions(results, figures, synthetic),
        *_overview_data(results, synthetic),
        *_overview_parameters(results, tunings, synthetic),
        *_overview_contradictions(synthetic=False),
        *appendix,
    ]
    data = "; ".join(dict.fromkeys(one.dataset_title for one in results))
    return Document("Validation studies, all in one", data, synthetic, tuple(blocks))


def _overview_predictions(results: Sequence[Results], figures: FigurePaths, synthetic: bool) -> list[Block]:
    predicted = [one for one in results if len(one.predictive)]
    if not predicted:
        return []
    return [
        document.heading("What was predicted of held-out needles"),
        *figure_blocks(figures, "predicted", labels.PREDICTIVE_CHECK_CAPTION, synthetic),
        document.table(_stack_coverage(predicted), synthetic),
    ]


def _stack_coverage(predicted: Sequence[Results]) -> TableLayout:
    """Return what was predicted in each study, one under the other."""
    tables = [lay_out_coverage(one) for one in predicted]
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for one, table in zip(predicted, tables, strict=True):
        breaks += [len(rows)] if rows else []
        names = (str(study_label(one)), *[""] * (len(table.rows) - 1))
        rows += [(name, *row) for name, row in zip(names, table.rows, strict=True)]
    notes = tuple(dict.fromkeys(note for table in tables for note in table.notes))
    columns = (text_column("Study"), *tables[0].columns)
    caption = "How well held-out needles were predicted."
    return TableLayout("coverage", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _overview_data(results: Sequence[Results], synthetic: bool) -> list[Block]:
    return [
        document.heading("Questions and data"),
        document.bullets([f"{one.title}: {one.question}".rstrip(": ") for one in results]),
        document.table(score_tables.lay_out_design(results), synthetic),
    ]


def _overview_baselines(results: Sequence[Results], figures: FigurePaths, synthetic: bool) -> list[Block]:
    held_out = [one for one in results if sentences.find_scored_role(one) == "validate"]
    return [
        document.heading("Baselines"),
        *figure_blocks(figures, "baselines", labels.BASELINES_CAPTION, synthetic),
        document.bullets([f"{one.name}: {sentences.summarize_baselines(one)}" for one in held_out]),
        document.table(detail_tables.lay_out_baselines(held_out, "validate"), synthetic),
    ]


def _overview_parameters(
    studies: Sequence[Results], tunings: Sequence[Results], synthetic: bool
) -> list[Block]:
    results = list({one.name: one for one in (*studies, *tunings)}.values())
    return [
        document.heading("Tuning and parameters"),
        *tuning_blocks(tunings, synthetic),
        document.bullets([f"{one.name}: {sentences.describe_undetermined(one)}" for one in results]),
        document.table(detail_tables.lay_out_free_parameters(results), synthetic),
    ]


def _overview_contradictions(synthetic: bool) -> list[Block]:
    found = paper.find_contradictions()
    return [
        document.heading("Where the paper contradicts itself"),
        document.text(
            "A cell of the paper can be held against ours no more closely than the paper agrees with itself."
        ),
        document.table(detail_tables.lay_out_contradictions(found), synthetic),
    ]
