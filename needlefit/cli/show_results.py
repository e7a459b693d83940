"""Print a result: verdicts, warnings, one table, parameters, files; with `--explain` all tables and notes."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from needlefit.cli import screen
from needlefit.cli.exit_codes import Invocation

if TYPE_CHECKING:
    from needlefit.studies.run import Run


def show_run(invocation: Invocation, result: "Run", folder: Path, named: bool = False) -> None:
    """Print the result of a study of any kind; `named`: before each verdict stands the name of the run."""
    from needlefit.studies.kind import find_kind
    from needlefit.studies.verdict import judge_run

    for one in judge_run(result):
        screen.print_text(f"{result.name}: {one.sentence}." if named else f"{one.sentence}.")
    show_warnings(invocation, result)
    screen.print_line()
    screen.print_text(_describe_data(result))
    report = find_kind(result.kind).report
    tables, sentences = report.explain(result) if invocation.explain else (report.lay_out_first(result), [])
    for table in tables:
        screen.show_display(table, notes=invocation.explain)
    for sentence in sentences:
        screen.print_text(sentence)
    _show_files(invocation, folder)


def show_result(invocation: Invocation, result: "Run", folder: Path, json: bool) -> None:
    """Print the result of a command that runs one study: in words, or as JSON with the warnings on stderr."""
    if not json:
        show_run(invocation, result, folder)
        return
    from needlefit.studies.report import run_to_json

    screen.show_json(run_to_json(result))
    show_warnings(invocation, result)


def show_warnings(invocation: Invocation, result: "Run") -> None:
    """Print the warnings of a run to stderr, with the paths of the files that they are about."""
    from needlefit.studies.report import list_run_warnings

    data = Path(result.timing.get("dataset", "")).parent
    screen.print_warnings(invocation, [screen.locate_warning(one, data) for one in list_run_warnings(result)])


def _describe_data(result: "Run") -> str:
    """Return the run's title and its data; on synthetic data in letters that a reader cannot miss."""
    title = result.name if result.title in ("", result.name) else f"{result.name}: {result.title}"
    origins = {"synthetic": "SYNTHETIC data", "measured": "Measured data"}
    return title if result.origin == "none" else f"{title}\n{origins[result.origin]}: {result.dataset_title}"


def _show_files(invocation: Invocation, folder: Path) -> None:
    documents = [str(folder / name) for name in ("report.pdf", "report.html") if (folder / name).is_file()]
    if documents:
        screen.print_line(f"Report: {', '.join(documents)}")
    if not invocation.explain:
        screen.print_line(f"Explained: {shlex.join(('needlefit', 'report', str(folder), '--explain'))}")
    screen.print_line(f"written: {folder}/")
