"""Results -> a folder of files, complete or not there at all."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from needlefit.project.atomic_write import replace_folder
from needlefit.project.threads import one_thread
from needlefit.reporting import details, figures, layouts
from needlefit.reporting.contest import scored_role
from needlefit.reporting.display import Display
from needlefit.reporting.document import Document, compile_pdf
from needlefit.reporting.figures.profiles import draw_profiles
from needlefit.reporting.files import all_files, write_csv, write_json
from needlefit.reporting.identification_layout import identification_table
from needlefit.reporting.latex import latex
from needlefit.reporting.macros import macros
from needlefit.reporting.methods import latex_methods, methods, references
from needlefit.reporting.page import compile_html
from needlefit.reporting.parameters import parameters_table
from needlefit.reporting.ridge import free
from needlefit.reporting.slicer import write_needles
from needlefit.reporting.story import story
from needlefit.reporting.tables import tuning_table, validation_table
from needlefit.validation.results import Results
from needlefit.validation.stored import store_results

Also = Mapping[str, Callable[[Path], object]]


@one_thread
def write(results: Results, folder: Path, also: Also | None = None) -> list[Path]:
    """Write one study or fit to `folder`, replacing an earlier result there; return the files.

    CSV and LaTeX tables, figures as PDF, the report as PDF and HTML, `slicer/` with every needle in its
    scan, `run.json`, `results.json.gz`, from which all of this can be made again, and `timing.json`, the only
    file that may differ between two runs of the same inputs. `also` names further files and what writes each.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        _frames(results, new)
        write_tables([results], [results], new)
        drawn = _draw(results, new)
        if results.needles:
            write_needles(results, new / "slicer")
        for name, save in (also or {}).items():
            save(new / name)
        write_report(story(results, drawn), new)
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
    """Write every number as a macro, and for a single run its methods paragraph with what that cites."""
    (folder / "numbers.tex").write_text(macros(results), encoding="utf-8")
    if len(results) == 1 and methods(results[0]):
        (folder / "methods.tex").write_text(latex_methods(results[0]), encoding="utf-8")
        (folder / "references.bib").write_text(references(results[0]), encoding="utf-8")


def _frames(results: Results, folder: Path) -> None:
    for name in ("design", "errors", "shapes", "starts", "directions"):
        write_csv(getattr(results, name).assign(origin=results.origin), folder / f"{name}.csv")
    if len(results.predictive):
        write_csv(results.predictive.assign(origin=results.origin), folder / "predictive.csv")
    if len(results.identification):
        write_csv(identification_table(results.identification, results.origin), folder / "identify.csv")
    # With every digit: it is exactly these values that fail again.
    write_csv(results.failures.assign(origin=results.origin), folder / "failures.csv", digits=None)


def write_tables(studies: Sequence[Results], tunings: Sequence[Results], folder: Path) -> None:
    """Write the paper's tables with our rows beside its own, as CSV for machines and LaTeX for papers."""
    synthetic = any(one.origin == "synthetic" for one in studies)
    for name, frame, set_as in _laid_out(studies, tunings):
        if len(frame):
            write_csv(frame, folder / f"{name}.csv")
            pages = [latex(table, synthetic) for table in set_as if table.rows]
            (folder / f"{name}.tex").write_text("\n".join(pages), encoding="utf-8")


def _laid_out(
    studies: Sequence[Results], tunings: Sequence[Results]
) -> Iterator[tuple[str, pd.DataFrame, list[Display]]]:
    every = list({one.name: one for one in (*studies, *tunings)}.values())
    yield "validation", validation_table(*studies, both=True), [layouts.validation_layout(studies)]
    tuned = [layouts.tuning_layout(tunings, by) for by in ("layers", "media")]
    yield "tuning", tuning_table(*tunings, both=True), tuned
    yield "parameters", parameters_table(*every), [details.parameters_layout(every)]


def _draw(results: Results, folder: Path) -> dict[str, Path]:
    role = scored_role(results)
    drawn = {}
    if len(results.profiles):
        drawn["profiles"] = draw_profiles(
            results.identification, results.profiles, results.origin, folder / "profiles.pdf"
        )
    if _has(results.errors, role) and _has(results.shapes, role):
        drawn["overlays"] = figures.overlays(results, folder / "overlays.pdf", role)
        drawn["residuals"] = figures.residuals(results, folder / "residuals.pdf", role)
    if len(results.draws) and free(results):
        drawn["corner"] = figures.corner(results, folder / "corner.pdf")
    if len(results.starts):
        drawn["waterfall"] = figures.waterfall(results, folder / "waterfall.pdf")
    return drawn | draw_scores([results], folder)


def draw_scores(results: Sequence[Results], folder: Path) -> dict[str, Path]:
    """Draw the errors on held-out insertions, if any were scored."""
    if validation_table(*results).empty:
        return {}
    drawn = {
        "boxplot": figures.boxplot(results, folder / "boxplot.pdf"),
        "rivals": figures.rivals(results, folder / "rivals.pdf"),
    }
    if any(len(one.predictive) for one in results):
        drawn["foretold"] = figures.foretold(results, folder / "foretold.pdf")
    return drawn


def _has(frame: pd.DataFrame, role: str) -> bool:
    return bool(((frame["role"] == role) & (frame["method"] == "fitted")).any())
