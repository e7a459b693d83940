"""The report of several studies together."""

from collections.abc import Sequence

from needlefit.reporting import captions, contest, details, document, layouts, sentences
from needlefit.reporting.display import Display, text
from needlefit.reporting.document import Block, Document
from needlefit.reporting.foretold import foretold_layout
from needlefit.reporting.story import Figures, cautions, figure_of, tuning_blocks
from needlefit.reporting.tables import study_label
from needlefit.validation import paper
from needlefit.validation.results import Results


def overview(
    results: Sequence[Results], tunings: Sequence[Results], figures: Figures, beyond: Sequence[Block] = ()
) -> Document:
    """Return one report over all studies: errors, rivals, tuning, parameters, the paper's contradictions.

    `beyond` is what was asked besides, and answered.
    """
    synthetic = any(one.origin == "synthetic" for one in results)
    blocks = [
        *cautions(list(results)),
        document.bullets([line for one in results for line in sentences.in_short(one)]),
        document.heading("Errors on held-out insertions, beside the paper’s"),
        *figure_of(figures, "boxplot", captions.BOXPLOT, synthetic),
        document.table(layouts.validation_layout(results), synthetic),
        *_rivals(results, figures, synthetic),
        *_foretold(results, figures, synthetic),
        *_data(results, synthetic),
        *_parameters(results, tunings, synthetic),
        *_contradictions(synthetic=False),
        *beyond,
    ]
    data = "; ".join(dict.fromkeys(one.dataset_title for one in results))
    return Document("Validation studies, all in one", data, synthetic, tuple(blocks))


def _foretold(results: Sequence[Results], figures: Figures, synthetic: bool) -> list[Block]:
    told = [one for one in results if len(one.predictive)]
    if not told:
        return []
    return [
        document.heading("What was foretold of held-out needles"),
        *figure_of(figures, "foretold", captions.FORETOLD, synthetic),
        document.table(_one_table(told), synthetic),
    ]


def _one_table(told: Sequence[Results]) -> Display:
    """Return what was foretold in each study, one under the other."""
    tables = [foretold_layout(one) for one in told]
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for one, table in zip(told, tables, strict=True):
        breaks += [len(rows)] if rows else []
        names = (str(study_label(one)), *[""] * (len(table.rows) - 1))
        rows += [(name, *row) for name, row in zip(names, table.rows, strict=True)]
    notes = tuple(dict.fromkeys(note for table in tables for note in table.notes))
    columns = (text("Study"), *tables[0].columns)
    caption = "How well held-out needles were foretold."
    return Display("foretold", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _data(results: Sequence[Results], synthetic: bool) -> list[Block]:
    return [
        document.heading("Questions and data"),
        document.bullets([f"{one.title}: {one.question}".rstrip(": ") for one in results]),
        document.table(layouts.design_layout(results), synthetic),
    ]


def _rivals(results: Sequence[Results], figures: Figures, synthetic: bool) -> list[Block]:
    held_out = [one for one in results if contest.scored_role(one) == "validate"]
    return [
        document.heading("What the model has to beat"),
        *figure_of(figures, "rivals", captions.RIVALS, synthetic),
        document.bullets([f"{one.name}: {contest.rivals_said(one)}" for one in held_out]),
        document.table(details.rivals_layout(held_out, "validate"), synthetic),
    ]


def _parameters(studies: Sequence[Results], tunings: Sequence[Results], synthetic: bool) -> list[Block]:
    results = list({one.name: one for one in (*studies, *tunings)}.values())
    return [
        document.heading("Tuning and parameters"),
        *tuning_blocks(tunings, synthetic),
        document.bullets([f"{one.name}: {sentences.undetermined_said(one)}" for one in results]),
        document.table(details.free_parameters_layout(results), synthetic),
    ]


def _contradictions(synthetic: bool) -> list[Block]:
    found = paper.find_contradictions()
    return [
        document.heading("Where the paper contradicts itself"),
        document.text(
            "A cell of the paper can be held against ours no more closely than the paper agrees with itself."
        ),
        document.table(details.contradictions_layout(found), synthetic),
    ]
