"""The tables, figures and further files of a fit or cross-validation."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.reporting.figures.profiles import draw_profiles
from needlefit.reporting.latex import format_latex
from needlefit.reporting.table_files import to_records, write_csv
from needlefit.reporting.table_layout import TableLayout
from needlefit.reporting.tidy import to_tidy
from needlefit.studies.identification_tables import tabulate_identification
from needlefit.studies.kinds.cross_validation import detail_tables, figures, score_tables
from needlefit.studies.kinds.cross_validation.figures.waterfall import describe_agreement
from needlefit.studies.kinds.cross_validation.macros import format_macros
from needlefit.studies.kinds.cross_validation.methods_paragraph import (
    compose_methods,
    format_methods_latex,
    format_references,
)
from needlefit.studies.kinds.cross_validation.parameter_table import tabulate_parameters
from needlefit.studies.kinds.cross_validation.posterior import list_free_parameters, tabulate_percentiles
from needlefit.studies.kinds.cross_validation.sentences import find_scored_role
from needlefit.studies.kinds.cross_validation.tables import tabulate_tuning, tabulate_validation
from needlefit.studies.run import Run
from needlefit.studies.slicer import write_needles


def tabulate_files(result: Run) -> dict[str, pd.DataFrame]:
    """Return the tables that are written as CSV, by name."""
    names = ("design", "errors", "shapes", "starts", "failures", "directions")
    frames = {name: result.frames[name] for name in names}
    predictions = [result.frames[name] for name in ("predictive", "predictive_training")]
    if any(map(len, predictions)):
        frames["predictive"] = pd.concat([frame for frame in predictions if len(frame)])
    frames |= {name: frame for name, frame, _ in _lay_out_tables([result], [result]) if len(frame)}
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


def write_files(result: Run, folder: Path) -> None:
    """Write the numbers and methods for a paper, and every needle in its scan."""
    # With every digit: it is exactly these values that fail again.
    write_csv(result.frames["failures"].assign(origin=result.origin), folder / "failures.csv", digits=None)
    if len(result.frames["needles"]):
        write_needles(result, folder / "slicer")
    write_for_papers([result], folder)


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the tables of errors and parameters beside the paper's."""
    found = [table for _, _, layouts in _lay_out_tables([result], [result]) for table in layouts]
    return [table for table in found if table.rows]


def write_for_papers(results: Sequence[Run], folder: Path) -> None:
    """Write every number as a LaTeX macro, and for a single run its methods paragraph with its references."""
    (folder / "numbers.tex").write_text(format_macros(results), encoding="utf-8")
    if len(results) == 1 and compose_methods(results[0]):
        (folder / "methods.tex").write_text(format_methods_latex(results[0]), encoding="utf-8")
        (folder / "references.bib").write_text(format_references(results[0]), encoding="utf-8")


def write_tables(studies: Sequence[Run], tunings: Sequence[Run], folder: Path) -> None:
    """Write the paper's tables with our rows beside its rows, as CSV and LaTeX."""
    synthetic = any(one.origin == "synthetic" for one in studies)
    for name, frame, table_layouts in _lay_out_tables(studies, tunings):
        if len(frame):
            write_csv(frame, folder / f"{name}.csv")
            pages = [format_latex(table, synthetic) for table in table_layouts if table.rows]
            (folder / f"{name}.tex").write_text("\n".join(pages), encoding="utf-8")


def _lay_out_tables(
    studies: Sequence[Run], tunings: Sequence[Run]
) -> Iterator[tuple[str, pd.DataFrame, list[TableLayout]]]:
    every = list({one.name: one for one in (*studies, *tunings)}.values())
    yield (
        "validation",
        tabulate_validation(*studies, with_alternate=True),
        [score_tables.lay_out_validation(studies)],
    )
    layouts_of_tuning = [score_tables.lay_out_tuning(tunings, by) for by in ("layers", "media")]
    yield "tuning", tabulate_tuning(*tunings, with_alternate=True), layouts_of_tuning
    yield "parameters", tabulate_parameters(*every), [detail_tables.lay_out_parameters(every)]


def draw_figures(results: Run, folder: Path) -> dict[str, Path]:
    role = find_scored_role(results)
    drawn = {}
    if len(results.frames["profiles"]):
        drawn["profiles"] = draw_profiles(
            results.frames["identification"],
            results.frames["profiles"],
            results.origin,
            folder / "profiles.pdf",
        )
    if _has_fitted(results.frames["errors"], role) and _has_fitted(results.frames["shapes"], role):
        drawn["schematic"] = figures.draw_schematic(results, folder / "schematic.pdf", role)
        drawn["overlays"] = figures.draw_overlays(results, folder / "overlays.pdf", role)
        drawn["residuals"] = figures.draw_residuals(results, folder / "residuals.pdf", role)
    if len(results.frames["draws"]) and list_free_parameters(results):
        drawn["corner"] = figures.draw_corner(results, folder / "corner.pdf")
    if len(results.frames["starts"]) and not describe_agreement(results):
        drawn["waterfall"] = figures.draw_waterfall(results, folder / "waterfall.pdf")
    return drawn | draw_error_figures([results], folder)


def draw_error_figures(results: Sequence[Run], folder: Path) -> dict[str, Path]:
    """Draw the errors on held-out insertions, if there are any."""
    if tabulate_validation(*results).empty:
        return {}
    drawn = {
        "boxplot": figures.draw_boxplot(results, folder / "boxplot.pdf"),
    }
    if len(results) > 1:  # of one study the table of methods has these numbers
        drawn["baselines"] = figures.draw_baselines(results, folder / "baselines.pdf")
    if any(len(one.frames["predictive"]) for one in results):
        drawn["predicted"] = figures.draw_predictive_check(results, folder / "predicted.pdf")
    return drawn


def _has_fitted(frame: pd.DataFrame, role: str) -> bool:
    return bool(((frame["role"] == role) & (frame["method"] == "fitted")).any())
