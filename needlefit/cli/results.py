"""Commands about results: report, diff, explain."""

import difflib
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import show_json_of, show_run
from needlefit.cli.options import argument, option

MAX_SHOWN_DIFFERENCES = 40  #: largest number of rows of the table of differences on the screen


def report(
    context: typer.Context,
    run: options.RunName,
    out: options.Out = None,
    paper: Annotated[
        Path | None,
        option("Also write figures 3.5 and 7.16 in wide, and LaTeX tables, to a new folder.", "DIR"),
    ] = None,
) -> None:
    """Write tables, figures and report of a RUN again, to its own folder or to OUT.

    Nothing is fitted: the files are made of the stored results, for instance after an update, or where files
    were lost. A file that does not agree with the manifest is an error: remove it, and it is written again.
    """
    from needlefit.project.locate import find_run
    from needlefit.studies.report import rebuild

    invocation = context.find_root().obj
    folder = find_run(run)
    written = folder if out is None else out
    done = rebuild(folder, written)
    if invocation.json:
        show_json_of([done])
    show_run(invocation, done, written, results=folder.parent)
    if paper is not None:
        from needlefit.studies.paper_folder import write_paper_folder

        write_paper_folder(done, written, paper)
        screen.print_note(f"written: {paper}")


def diff(
    context: typer.Context,
    run_a: Annotated[str, argument("RUN_A", "What RUN_B is compared with.")],
    run_b: Annotated[
        str,
        argument("RUN_B", "Another one."),
    ],
    csv: Annotated[Path | None, option("Write all rows of the printed table.", "FILE")] = None,
) -> None:
    """Compare two runs: inputs, states, every number.

    Prints the greatest change of each column, and how many rows differ; of different fits their verdicts.
    Runs with files that do not agree with their manifest are not compared.
    """
    from needlefit.project.folders import require_output_files
    from needlefit.project.locate import find_run
    from needlefit.reporting.table_files import to_records
    from needlefit.studies.run import restore_run
    from needlefit.studies.run_differences import IDENTITY, RUN_JSON, compare_runs

    folders = find_run(run_a), find_run(run_b)
    if csv is not None:
        require_output_files({"--csv": csv}, folders)
    differences = compare_runs(*folders)
    if csv is not None:
        differences.to_csv(csv, index=False)
    if context.find_root().obj.json:
        screen.show_json(to_records(differences))
        return
    identity = differences["column"] == IDENTITY
    changes, differences = differences.loc[identity, "row"], differences[~identity]
    tables = differences[differences["table"] != RUN_JSON]
    keys = len(differences) - len(tables)
    for changed in changes:
        screen.print_text(f"The runs are of different fits; changed: {changed}.")
        for folder in folders:
            screen.print_text(f"{folder}: {restore_run(folder).first_page.answer}")
    screen.print_text(f"{tables['rows'].sum()} values of tables and {keys} keys of {RUN_JSON} differ.")
    if len(differences) and changes.empty:
        shown = differences.head(MAX_SHOWN_DIFFERENCES)
        screen.show_frame(shown, "\nThe greatest change of each column, from RUN_A to RUN_B")
        if more := len(differences) - len(shown):
            screen.print_line(f"{more} more rows: --csv FILE writes all of them")
    if csv is not None:
        screen.print_note(f"written: {csv}")


def explain(
    context: typer.Context,
    key: Annotated[
        list[str] | None,
        argument("NAME", "A word of a page (coverage), a column (te_mm), a file (study), a key (leave_out)."),
    ] = None,
) -> None:
    """Explain a word, a warning, a column, or a key of a file.

    Without a NAME all are listed.
    """
    from needlefit.studies.explanations import find_topics, list_topics

    name, groups = " ".join(key or ()), list_topics()
    topics = [topic for group in groups.values() for topic in group]
    chosen = find_topics(name) if name else topics
    if not chosen:
        near = difflib.get_close_matches(name, [topic.key for topic in topics], n=3)
        raise typer.BadParameter(
            f"`{name}` is no warning, term, column or key"
            + (f"; did you mean {' or '.join(dict.fromkeys(near))}?" if near else "")
        )
    if context.find_root().obj.json:
        screen.show_json([asdict(topic) for topic in chosen])
    elif name:
        for topic in chosen:
            screen.print_text("\n".join([topic.title, *topic.paragraphs]))
    else:
        for group, members in groups.items():
            screen.print_line(f"\n{group}")
            for topic in members:
                screen.print_line(f"  {topic.key:32}{topic.title}")
