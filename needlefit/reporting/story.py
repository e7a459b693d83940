"""The report of one study or fit, block by block."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from needlefit.reporting import captions, contest, details, document, layouts, sentences
from needlefit.reporting.comparability import SYNTHETIC
from needlefit.reporting.display import Display, text
from needlefit.reporting.document import Block, Document
from needlefit.reporting.foretold import foretold_layout
from needlefit.reporting.identification_layout import identification_layout
from needlefit.reporting.identification_said import verdict_said
from needlefit.reporting.methods import plain_methods
from needlefit.reporting.numbers import in_symbols
from needlefit.reporting.posterior import outside_said, posterior_layout, unconverged_said
from needlefit.reporting.ridge import draws_said
from needlefit.reporting.tables import records, tuning_table
from needlefit.validation.results import Results

Figures = Mapping[str, Path]


def story(results: Results, figures: Figures) -> Document:
    """Return the report: question, data, parameters, errors beside the paper's, rivals, figures, run."""
    synthetic = results.origin == "synthetic"
    blocks = [
        *cautions([results]),
        document.bullets(sentences.in_short(results)),
        *_question(results, synthetic),
        *_parameters(results, figures, synthetic),
        *_identifiability(results, figures, synthetic),
        *_errors(results, figures, synthetic),
        *_rivals(results, figures, synthetic),
        *_insertions(results, figures, synthetic),
        *run_blocks(results, synthetic),
    ]
    subtitle = f"{results.name} · {results.dataset_title}"
    return Document(results.title or results.name, subtitle, synthetic, tuple(blocks))


def cautions(results: list[Results]) -> list[Block]:
    """Return what a reader must know before any number."""
    said = []
    if any(one.origin == "synthetic" for one in results):
        said.append(
            document.warning(f"SYNTHETIC DATA. {SYNTHETIC.removeprefix('Synthetic data: ').capitalize()}")
        )
    stopped = [one.name for one in results if one.interrupted]
    if stopped:
        said.append(
            document.warning(
                f"INTERRUPTED: {', '.join(stopped)}. The search was stopped; this is its best so far."
            )
        )
    failed = [(one.name, _failures(one)) for one in results]
    said += [
        document.warning(
            f"NOT CONVERGED: {name}, {count} scored simulations of the fitted model. They have no errors and "
            "are missing from every mean."
        )
        for name, count in failed
        if count
    ]
    said += [
        document.warning(f"NOT CONVERGED: {one.name}: {'; '.join(faults)}.")
        for one in results
        if (faults := [fault for found in one.run.get("search_faults", {}).values() for fault in found])
    ]
    return said + [block for one in results for block in document.warnings_in(one.run, one.name)]


def figure_of(figures: Figures, name: str, caption: str, synthetic: bool) -> list[Block]:
    """Return the block of a figure that was drawn, or none."""
    return [document.figure(figures[name], caption, synthetic)] if name in figures else []


def run_blocks(results: Results, synthetic: bool) -> list[Block]:
    """Return what the run was."""
    rows = tuple(sentences.run_said(results.run))
    if not rows:
        return []
    table = Display(
        "run", f"What {results.name} was computed with.", (text("What"), text("Value", wide=True)), rows
    )
    return [
        *_methods(results),
        document.heading("Run"),
        document.text("The file run.json holds all of this in full; the same inputs give the same bytes."),
        document.table(table, synthetic),
    ]


def _methods(results: Results) -> list[Block]:
    said = plain_methods(results)
    if not said:
        return []
    return [
        document.heading("Methods"),
        document.text(said),
        document.text("The same as LaTeX, with citations: methods.tex and references.bib."),
    ]


def tuning_blocks(results: Sequence[Results], synthetic: bool) -> list[Block]:
    """Return the in-sample tables; by media only where the paper has a cell, else it says nothing new."""
    rows = records(tuning_table(*results))
    printed = any(row["grouping"] == "media" and row["paper_te_mm"] is not None for row in rows)
    ways = ("layers", "media") if printed else ("layers",)
    return [document.table(layouts.tuning_layout(results, by), synthetic) for by in ways if rows]


def _question(results: Results, synthetic: bool) -> list[Block]:
    return [
        document.heading("Question and data"),
        *([document.text(results.question)] if results.question else []),
        document.text(f"{results.dataset_title}. {sentences.floor_said(results)}"),
        *(document.text(note) for note in results.run.get("dataset", {}).get("notes", ())),
        document.table(layouts.design_layout([results]), synthetic),
    ]


def _parameters(results: Results, figures: Figures, synthetic: bool) -> list[Block]:
    directions = details.directions_layout(results)
    said = [text for text in (sentences.failures_said(results), sentences.validity_said(results)) if text]
    return [
        document.heading("Parameters"),
        document.text(sentences.undetermined_said(results)),
        document.table(details.parameters_layout([results]), synthetic),
        document.table(directions, synthetic),
        *_posterior(results, figures, synthetic),
        *map(document.text, said),
        *figure_of(figures, "waterfall", captions.WATERFALL, synthetic),
    ]


def _identifiability(results: Results, figures: Figures, synthetic: bool) -> list[Block]:
    """Return what a fit was found to determine; a study's folds are not examined."""
    if results.identification.empty:
        return []
    return [
        document.heading("Identifiability"),
        document.bullets([in_symbols(said) for said in verdict_said(results.identification)]),
        *figure_of(figures, "profiles", captions.PROFILES, synthetic),
        document.table(identification_layout(results.identification), synthetic),
    ]


def _posterior(results: Results, figures: Figures, synthetic: bool) -> list[Block]:
    said = [s for s in (unconverged_said(results), outside_said(results)) if s]
    table = [document.table(posterior_layout(results), synthetic)] if results.posteriors else []
    drawn = f"{captions.CORNER} {draws_said(results)}" if "corner" in figures else ""
    return [*map(document.text, said), *table, *figure_of(figures, "corner", drawn, synthetic)]


def _errors(results: Results, figures: Figures, synthetic: bool) -> list[Block]:
    blocks = [document.heading("Errors")]
    if contest.scored_role(results) == "validate":
        blocks += figure_of(figures, "boxplot", captions.BOXPLOT, synthetic)
        blocks.append(document.table(layouts.validation_layout([results]), synthetic))
    if len(results.predictive):
        blocks.append(document.table(foretold_layout(results), synthetic))
        blocks += figure_of(figures, "foretold", captions.FORETOLD, synthetic)
    return [*blocks, *tuning_blocks([results], synthetic)]


def _rivals(results: Results, figures: Figures, synthetic: bool) -> list[Block]:
    role = contest.scored_role(results)
    table = details.rivals_layout([results], role)
    if len(table.rows) < 2:
        return []
    return [
        document.heading("What it has to beat"),
        document.text(contest.rivals_said(results)),
        document.table(table, synthetic),
        *figure_of(figures, "rivals", captions.RIVALS, synthetic),
    ]


def _insertions(results: Results, figures: Figures, synthetic: bool) -> list[Block]:
    role = contest.scored_role(results)
    if results.errors.empty:
        return []
    return [
        document.heading("Single insertions"),
        *figure_of(figures, "overlays", captions.OVERLAYS, synthetic),
        *figure_of(figures, "residuals", captions.RESIDUALS, synthetic),
        document.table(details.insertions_layout(results, role), synthetic),
    ]


def _failures(results: Results) -> int:
    errors = results.errors[results.errors["method"] == "fitted"]
    return int((~errors["converged"].astype(bool)).sum())
