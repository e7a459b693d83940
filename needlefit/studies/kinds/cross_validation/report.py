"""Compose the report of one study or fit, the answer first, and the report of several studies."""

from collections.abc import Iterable, Sequence

from needlefit.reporting import document, labels
from needlefit.reporting.document import Block, Document
from needlefit.reporting.number_format import insert_symbols
from needlefit.studies import paper
from needlefit.studies.identification_tables import describe_verdicts
from needlefit.studies.kinds.cross_validation import detail_tables, score_tables, sentences
from needlefit.studies.kinds.cross_validation.differences import COMPARISONS
from needlefit.studies.kinds.cross_validation.explanation import explain
from needlefit.studies.kinds.cross_validation.explorer import collect_explorer
from needlefit.studies.kinds.cross_validation.figures.waterfall import describe_agreement
from needlefit.studies.kinds.cross_validation.files import (
    draw_figures,
    fit_to_json,
    lay_out_tables,
    tabulate_files,
    write_files,
)
from needlefit.studies.kinds.cross_validation.methods_paragraph import format_methods_text
from needlefit.studies.kinds.cross_validation.posterior import (
    describe_draws,
    describe_outside_fits,
    describe_unconverged,
    lay_out_posterior,
)
from needlefit.studies.kinds.cross_validation.score_tables import lay_out_coverage
from needlefit.studies.kinds.cross_validation.tables import (
    BY_LAYERS,
    BY_MEDIA,
    list_groups,
    list_held_out_groups,
    tabulate_tuning,
)
from needlefit.studies.kinds.cross_validation.verdict import (
    describe_evidence,
    judge,
)
from needlefit.studies.report import (
    FigurePaths,
    StudyReport,
    compose_warnings,
    list_run_warnings,
    state_blocks,
    verdict_blocks,
)
from needlefit.studies.run import Run
from needlefit.studies.verdict import headline_fault


def compose_sections(results: Run, figures: FigurePaths) -> list[Block]:
    """Return the report below its verdicts: evidence, schematic and errors in short; then errors and
    coverage, parameters, insertions, methods; diagnostics last.
    """
    return [
        document.text(describe_evidence(results)),
        *figure_blocks(figures, "schematic", _add_bands(results, labels.SCHEMATIC_CAPTION)),
        document.table(score_tables.lay_out_summary([results])),
        *_error_blocks(results, figures),
        *_parameter_blocks(results, figures),
        *_insertion_blocks(results, figures),
        *_methods_blocks(results),
        document.heading("Appendix: data and diagnostics"),
        *_data_blocks(results),
        *_diagnostic_blocks(results, figures),
    ]


def _add_bands(results: Run, caption: str) -> str:
    """Return the caption of a figure of needles with what there is to say of the bands of those held out."""
    if len(results.frames["bands"]):
        return f"{caption} {labels.BANDS_CAPTION}"
    uncertified = not results.frames["draws"]["certified"].astype(bool).all()
    held_out = sentences.find_scored_role(results) == "validate"
    return f"{caption} {labels.NO_BANDS_CAPTION}" if uncertified and held_out else caption


def figure_blocks(figures: FigurePaths, name: str, caption: str) -> list[Block]:
    """Return the block of a figure if it was drawn."""
    return [document.figure(figures[name], caption)] if name in figures else []


def _error_blocks(results: Run, figures: FigurePaths) -> list[Block]:
    role = sentences.find_scored_role(results)
    predicted = len(results.frames["predictive"]) > 0
    held_out = f"Errors{' and coverage' if predicted else ''} on held-out insertions"
    return [
        document.heading(held_out if role == "validate" else "Errors"),
        *_boxplot_blocks([results], figures),
        *figure_blocks(figures, "predicted", labels.PREDICTIVE_CHECK_CAPTION),
        *_baseline_table([results], role),
        *([document.table(lay_out_coverage(results))] if predicted else []),
    ]


def _boxplot_blocks(results: Sequence[Run], figures: FigurePaths) -> list[Block]:
    printed = any(group.printed for group in list_held_out_groups(*results))
    caption = f"{labels.BOXPLOT_CAPTION} {labels.PAPER_MEANS_CAPTION}" if printed else labels.BOXPLOT_CAPTION
    return figure_blocks(figures, "boxplot", caption)


def _baseline_table(results: Sequence[Run], role: str) -> list[Block]:
    table = detail_tables.lay_out_baselines(results, role)
    return [document.table(table)] if len(table.rows) > 1 else []


def _parameter_blocks(results: Run, figures: FigurePaths) -> list[Block]:
    drawn = f"{labels.CORNER_CAPTION} {describe_draws(results)}" if "corner" in figures else ""
    summary = (describe_unconverged(results), describe_outside_fits(results))
    return [
        document.heading("Parameters"),
        document.text(sentences.describe_undetermined(results)),
        *([document.text(used)] if (used := sentences.describe_prediction_set(results)) else []),
        document.table(detail_tables.lay_out_parameters([results])),
        *(document.text(words) for words in summary if words),
        *figure_blocks(figures, "corner", drawn),
    ]


def _insertion_blocks(results: Run, figures: FigurePaths) -> list[Block]:
    if results.frames["errors"].empty:
        return []
    return [
        document.heading("Single insertions"),
        *figure_blocks(figures, "overlays", _add_bands(results, labels.OVERLAYS_CAPTION)),
        document.table(detail_tables.lay_out_insertions(results, sentences.find_scored_role(results))),
    ]


def _methods_blocks(results: Run) -> list[Block]:
    summary = format_methods_text(results)
    if not summary:
        return []
    return [
        document.heading("Methods"),
        document.text(summary),
        document.note("As LaTeX, with the origin of the data and citations: methods.tex and references.bib."),
    ]


def tuning_blocks(results: Sequence[Run]) -> list[Block]:
    """Return the in-sample tables; by media only where the paper has a cell."""
    groups = list_groups(tabulate_tuning(*results))
    printed = any(group.head["grouping"] == BY_MEDIA and group.printed for group in groups)
    groupings = (BY_LAYERS, BY_MEDIA) if printed else (BY_LAYERS,)
    return [document.table(score_tables.lay_out_tuning(results, by)) for by in groupings if groups]


def _data_blocks(results: Run) -> list[Block]:
    notes = results.run.get("dataset", {}).get("notes", ())
    if results.synthetic:  # every page says it already
        notes = [
            f"{note[:1].upper()}{note[1:]}" for note in (one.removeprefix("Synthetic: ") for one in notes)
        ]
    title = "" if results.synthetic else f"{results.dataset_title}. "
    return [
        document.text(f"{title}{sentences.describe_noise_floor(results)}"),
        *(document.note(note) for note in notes),
        document.table(score_tables.lay_out_design([results])),
    ]


def _diagnostic_blocks(results: Run, figures: FigurePaths) -> list[Block]:
    summary = (
        sentences.describe_failures(results),
        sentences.describe_validity(results),
        describe_agreement(results),
    )
    return [
        document.table(score_tables.lay_out_all_errors(results)),
        *figure_blocks(figures, "residuals", _add_bands(results, labels.RESIDUALS_CAPTION)),
        document.table(detail_tables.lay_out_directions(results)),
        *([document.table(lay_out_posterior(results))] if results.posteriors else []),
        *_identifiability_blocks(results, figures),
        *(document.text(words) for words in summary if words),
        *figure_blocks(figures, "waterfall", labels.WATERFALL_CAPTION),
    ]


def _identifiability_blocks(results: Run, figures: FigurePaths) -> list[Block]:
    """Return the profiles, and what freeing the fixed parameters would change; the table of parameters has
    the verdicts on the free ones.
    """
    identification = results.frames["identification"]
    freed = describe_verdicts(identification[identification["status"] == "fixed"])
    return [
        *figure_blocks(figures, "profiles", labels.PROFILES_CAPTION),
        *([document.bullets([insert_symbols(summary) for summary in freed])] if freed else []),
    ]


def compose_overview(
    results: Sequence[Run],
    tunings: Sequence[Run],
    figures: FigurePaths,
    appendix: Sequence[Block] = (),
) -> Document:
    """Return one report over all studies: a matrix of verdicts first, then errors, parameters, the paper.

    `appendix` has the results of studies of other kinds.
    """
    synthetic = any(one.origin == "synthetic" for one in results)
    fits = list({one.name: one for one in (*results, *tunings)}.values())
    blocks = [
        *_join_equal(block for one in results for block in state_blocks(one)),
        document.table(score_tables.lay_out_matrix(results)),
        *(block for one in results for block in verdict_blocks(one, named=True)),
        *_overview_warnings(results),
        document.heading("Errors on held-out insertions"),
        *_boxplot_blocks(results, figures),
        *figure_blocks(figures, "baselines", labels.BASELINES_CAPTION),
        document.table(score_tables.lay_out_summary(results)),
        *_overview_predictions(results, figures),
        document.heading("Parameters"),
        document.table(detail_tables.lay_out_free_parameters(fits)),
        document.heading("Tuning"),
        *tuning_blocks(tunings),
        document.heading("Questions and data"),
        document.bullets([f"{one.title}: {one.question}".rstrip(": ") for one in results]),
        document.table(score_tables.lay_out_design(results)),
        *_overview_contradictions(),
        *appendix,
    ]
    data = "; ".join(dict.fromkeys(one.name if one.synthetic else one.dataset_title for one in results))
    return Document("Validation studies", data, synthetic, tuple(blocks))


def _join_equal(blocks: Iterable[Block]) -> list[Block]:
    """Return blocks without those that are there already."""
    found: list[Block] = []
    for block in blocks:
        found += [] if block in found else [block]
    return found


def _overview_warnings(results: Sequence[Run]) -> list[Block]:
    """Return what did not converge, and the warnings of all runs, each with the name of its run."""
    blocks = []
    for one in results:
        name = one.title.partition(":")[0]
        blocks += [document.warning(f"{name}: {headline_fault(fault)}: {fault}.") for fault in one.faults]
        blocks += compose_warnings(list_run_warnings(one), head=f"{name}: ")
    return [document.subheading("Warnings"), *blocks] if blocks else []


def _overview_predictions(results: Sequence[Run], figures: FigurePaths) -> list[Block]:
    predicted = [one for one in results if len(one.frames["predictive"])]
    if not predicted:
        return []
    return [
        document.heading("Coverage of the predictive intervals"),
        *figure_blocks(figures, "predicted", labels.PREDICTIVE_CHECK_CAPTION),
        document.table(lay_out_coverage(*predicted, named=True)),
    ]


def _overview_contradictions() -> list[Block]:
    return [
        document.heading("Where the paper contradicts itself"),
        document.text("Our numbers cannot agree with the paper more closely than it agrees with itself."),
        document.table(detail_tables.lay_out_contradictions(paper.find_contradictions())),
    ]


REPORT = StudyReport(
    summarize=sentences.summarize_errors,
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
        score_tables.lay_out_summary([results]),
        detail_tables.lay_out_values(results),
    ],
    explain=explain,
)
