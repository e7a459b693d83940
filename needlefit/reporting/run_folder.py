"""Write results as a folder of files; the folder is complete, or it is not created."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from needlefit.project.atomic_write import replace_folder
from needlefit.project.threads import one_thread
from needlefit.reporting import detail_tables, figures, score_tables
from needlefit.reporting.document import Document, compile_html, compile_pdf
from needlefit.reporting.figures.profiles import draw_profiles
from needlefit.reporting.identification_tables import tabulate_identification
from needlefit.reporting.latex import format_latex, format_macros
from needlefit.reporting.methods_paragraph import compose_methods, format_methods_latex, format_references
from needlefit.reporting.parameter_table import tabulate_parameters
from needlefit.reporting.posterior import list_free_parameters
from needlefit.reporting.sentences import find_scored_role
from needlefit.reporting.slicer import write_needles
from needlefit.reporting.study_report import compose_report
from needlefit.reporting.table_files import all_files, write_csv, write_json
from needlefit.reporting.table_layout import TableLayout
from needlefit.reporting.tables import tabulate_tuning, tabulate_validation
from needlefit.validation.results import Results
from needlefit.validation.stored import store_results

ExtraWriters = Mapping[str, Callable[[Path], object]]


@one_thread
def write(results: Results, folder: Path, extra: ExtraWriters | None = None) -> list[Path]:
    """Write one study or fit to `folder`, replacing an earlier result there; return the files.

    CSV and LaTeX tables, figures as PDF, the report as PDF and HTML, `slicer/` with every needle in its
    scan, `run.json`, `results.json.gz`, from which all of this can be made again, and `timing.json`, the only
    file that may differ between two runs of the same inputs. `extra` names further files and what writes
    each.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        _write_frames(results, new)
        write_tables([results], [results], new)
        drawn = _draw_figures(results, new)
        if results.needles:
            write_needles(results, new / "slicer")
        for name, save in (extra or {}).items():
            save(new / name)
        # The report reads the figures' files, so it is written after them.
        write_report(compose_report(results, drawn), new)
        write_for_papers([results], new)
        store_results(results, new)
        write_json(new / "run.json", results.run)
        write_json(new / "timing.json", results.timing)
    return all_files(folder)


def write_report(document: Document, folder: Path, name: str = "report") -> None:
    """Write a report as PDF and as HTML."""
    (folder / f"{name}.pdf").write_bytes(compile_pdf(document))
    (folder / f"{name}.html").write_bytes(compile_html(document))


def write_for_papers(results: Sequence[Results], folder: Path) -> None:
    """Write every number as a LaTeX macro, and for a single run its methods paragraph with its references."""
    (folder / "numbers.tex").write_text(format_macros(results), encoding="utf-8")
    if len(results) == 1 and compose_methods(results[0]):
        (folder / "methods.tex").write_text(format_methods_latex(results[0]), encoding="utf-8")
        (folder / "references.bib").write_text(format_references(results[0]), encoding="utf-8")


def _write_frames(results: Results, folder: Path) -> None:
    for name in ("design", "errors", "shapes", "starts", "directions"):
        write_csv(getattr(results, name).assign(origin=results.origin), folder / f"{name}.csv")
    if len(results.predictive):
        write_csv(results.predictive.assign(origin=results.origin), folder / "predictive.csv")
    if len(results.identification):
        write_csv(tabulate_identification(results.identification, results.origin), folder / "identify.csv")
    # With every digit: it is exactly these values that fail again.
    write_csv(results.failures.assign(origin=results.origin), folder / "failures.csv", digits=None)


def write_tables(studies: Sequence[Results], tunings: Sequence[Results], folder: Path) -> None:
    """Write the paper's tables with our rows beside its rows, as CSV and LaTeX."""
    synthetic = any(one.origin == "synthetic" for one in studies)
    for name, frame, table_layouts in _lay_out_tables(studies, tunings):
        if len(frame):
            write_csv(frame, folder / f"{name}.csv")
            pages = [format_latex(table, synthetic) for table in table_layouts if table.rows]
            (folder / f"{name}.tex").write_text("\n".join(pages), encoding="utf-8")


def _lay_out_tables(
    studies: Sequence[Results], tunings: Sequence[Results]
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


def _draw_figures(results: Results, folder: Path) -> dict[str, Path]:
    role = find_scored_role(results)
    drawn = {}
    if len(results.profiles):
        drawn["profiles"] = draw_profiles(
            results.identification, results.profiles, results.origin, folder / "profiles.pdf"
        )
    if _has_fitted(results.errors, role) and _has_fitted(results.shapes, role):
        drawn["overlays"] = figures.draw_overlays(results, folder / "overlays.pdf", role)
        drawn["residuals"] = figures.draw_residuals(results, folder / "residuals.pdf", role)
    if len(results.draws) and list_free_parameters(results):
        drawn["corner"] = figures.draw_corner(results, folder / "corner.pdf")
    if len(results.starts):
        drawn["waterfall"] = figures.draw_waterfall(results, folder / "waterfall.pdf")
    return drawn | draw_error_figures([results], folder)


def draw_error_figures(results: Sequence[Results], folder: Path) -> dict[str, Path]:
    """Draw the errors on held-out insertions, if there are any."""
    if tabulate_validation(*results).empty:
        return {}
    drawn = {
        "boxplot": figures.draw_boxplot(results, folder / "boxplot.pdf"),
        "baselines": figures.draw_baselines(results, folder / "baselines.pdf"),
    }
    if any(len(one.predictive) for one in results):
        drawn["predicted"] = figures.draw_predictive_check(results, folder / "predicted.pdf")
    return drawn


def _has_fitted(frame: pd.DataFrame, role: str) -> bool:
    return bool(((frame["role"] == role) & (frame["method"] == "fitted")).any())
