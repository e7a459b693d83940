"""Commands about results: report, diff, explain, paper."""

import difflib
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import show_run
from needlefit.cli.options import argument, option
from needlefit.project.help_pages import Topic, read_input_columns, read_sections, read_terms

if TYPE_CHECKING:
    from needlefit.studies.toml_reference import FileKind


def report(
    context: typer.Context,
    run: options.RunName,
    out: Annotated[Path | None, option("Write to this folder; the run's own by default.", "DIR")] = None,
    paper: Annotated[
        Path | None,
        option("Also write figures 3.5 and 7.16 in wide, LaTeX files and an example to a new folder.", "DIR"),
    ] = None,
    unverified: options.Unverified = False,
    explain: options.Explain = False,
    strict: options.Strict = False,
    quiet: options.Quiet = False,
    plugins: options.Plugins = None,
) -> None:
    """Write tables, figures and report of a RUN again, and print it, without fitting anything.

    From the stored results, exact to the last digit: as after an update that draws figures differently, or
    where files were lost. Files that do not agree with the manifest are named, and not reported on: remove
    them, and they are made again. `all` is made again from the runs beside it.
    """
    from needlefit.project.locate import find_run
    from needlefit.studies.combined_report import rebuild

    folder = find_run(run)
    written = folder if out is None else out
    runs = rebuild(folder, written, unverified)
    several = len(runs) > 1
    for one in runs:
        show_run(context.find_root().obj, one, written, named=several)
    if paper is not None:
        from needlefit.studies.paper_folder import write_paper_folder

        for one in runs:
            stored, to = (folder.parent / one.name, paper / one.name) if several else (written, paper)
            write_paper_folder(one, stored, to)
        screen.print_line(f"written: {paper}")


def diff(
    context: typer.Context,
    run_a: Annotated[str, argument("RUN_A", "What RUN_B is compared with.")],
    run_b: Annotated[
        str,
        argument("RUN_B", "A folder of results, or its bare name in reports/."),
    ],
    unverified: options.Unverified = False,
    json: options.Json = False,
    plugins: options.Plugins = None,
) -> None:
    """Compare RUN_B with RUN_A: inputs, states, and every number of their tables.

    Prints the greatest change of each column, and how many rows differ. Runs with files that do not agree
    with their manifest are not compared.
    """
    from needlefit.project.locate import find_run
    from needlefit.studies.run_differences import (
        compare_runs,
        differences_to_json,
        lay_out_differences,
        summarize_differences,
    )

    found = compare_runs(find_run(run_a), find_run(run_b), unverified)
    if context.find_root().obj.json:
        screen.show_json(differences_to_json(found))
        return
    screen.print_text(summarize_differences(found))
    if found:
        screen.print_line()
        screen.show_display(lay_out_differences(found))


def _list_topics() -> dict[str, list[Topic]]:
    from needlefit.mechanics.laws import LAWS
    from needlefit.reporting.columns import list_columns
    from needlefit.studies.toml_reference import list_files

    laws = []
    for law in LAWS.values():
        shape = [
            f"{one.name} ({one.symbol}{one.unit and f', {one.unit}'}): {one.explanation}; "
            f"{one.bounds[0]:g} to {one.bounds[1]:g}, usually {one.usual[0]:g} to {one.usual[1]:g}"
            for one in law.parameters
        ]
        laws.append(Topic(law.name, law.label, tuple(shape) or ("No shape parameters.",)))
    tables = [
        Topic(
            table,
            f"Columns of {table}",
            tuple(f"{one.column}: {one.meaning} ({one.default})" for one in columns),
        )
        for table, columns in groupby(read_input_columns(), lambda one: one.table)
    ]
    return {
        "Warnings": [*read_sections().values()],
        "Files": [*(Topic(f"{one.name}.toml", one.title) for one in list_files()), *tables],
        "Terms": read_terms(),
        "Tissue laws": laws,
        "Columns of tables": [
            Topic(one.key, f"{one.label} ({one.unit})" if one.unit else one.label, (one.explanation,))
            for one in list_columns().values()
        ],
    }


def explain(
    context: typer.Context,
    key: Annotated[
        list[str] | None,
        argument("NAME", "A warning as printed (coverage), a term, a law, a file, or a column (te_mm)."),
    ] = None,
    json: options.Json = False,
    plugins: options.Plugins = None,
) -> None:
    """Explain a warning, file, term, law or column (none: list all)."""
    from needlefit.reporting.columns import find_column
    from needlefit.studies.toml_reference import list_files

    groups, name = _list_topics(), " ".join(key or ())
    topics = [one for group in groups.values() for one in group]
    found = [one for one in topics if name in (one.key, one.symbol)] if name else topics
    if not found and (column := find_column(name)).explanation:  # its name has a number, such as mu3_pa
        found = [Topic(name, column.label, (column.explanation,))]
    if not found:
        near = difflib.get_close_matches(name, [one.key for one in topics], n=3)
        raise typer.BadParameter(
            f"`{name}` is no warning, file, term, tissue law or column"
            + (f"; did you mean {' or '.join(near)}?" if near else "")
        )
    if name:
        files = {f"{one.name}.toml": one for one in list_files()}
        found = [
            replace(one, paragraphs=_list_keys(files[one.key])) if one.key in files else one for one in found
        ]
    if context.find_root().obj.json:
        screen.show_json([asdict(one) for one in found])
        return
    if name:
        for one in found:
            screen.print_text("\n".join([one.title, *one.paragraphs]))
        return
    for group, members in groups.items():
        screen.print_line(f"\n{group}")
        width = max(len(one.key) for one in members) + 2
        for one in members:
            screen.print_line(f"  {one.key:{width}}{one.title}")


def _list_keys(file: "FileKind") -> tuple[str, ...]:
    """Return the paragraphs about a file: its tables, and their keys."""
    from needlefit.studies.toml_reference import describe_files

    lines: list[str] = []
    for number, table in enumerate(describe_files([file])[0][1]):
        lines.append(f"\n{table.title}\n{table.summary}" if number else table.summary)
        for one in table.keys:
            lines.append(f"\n  {one.key}: {one.value.replace('**', '').replace('`', '')}")
            lines.append(f"      {one.meaning}" + (f" Keys: {one.described_in}." if one.described_in else ""))
    return tuple(lines)


def paper(context: typer.Context, json: options.Json = False) -> None:
    """Print the paper's tables."""
    from needlefit.studies import paper as published

    if context.find_root().obj.json:
        tables = published.TABLE_TITLES
        rows: dict[str, object] = {
            name: published.read_published_table(name).to_dict("records") for name in tables
        }
        screen.show_json(rows)
        return
    for name, title in published.TABLE_TITLES.items():
        screen.show_frame(published.read_printed_table(name), title)
