"""Commands about results: report, explain."""

import difflib
from dataclasses import asdict
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import show_json_of, show_run, show_warnings
from needlefit.cli.options import argument


def report(
    context: typer.Context,
    run: options.RunName,
    out: options.Out = None,
    explain: options.Explain = False,
    strict: options.Strict = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    plugins: options.Plugins = None,
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
        show_warnings(invocation, done)
    else:
        show_run(invocation, done, written)


def explain(
    context: typer.Context,
    key: Annotated[
        list[str] | None,
        argument("NAME", "A word of a page (coverage), a column (te_mm), a file (study), a key (leave_out)."),
    ] = None,
    json: options.Json = False,
    plugins: options.Plugins = None,
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
