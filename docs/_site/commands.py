"""The command reference, read out of the very application that the command line runs."""

import re
from collections.abc import Iterator
from typing import Any

import typer
from pages import keep
from sphinx.application import Sphinx

from needlefit.cli.application import build
from needlefit.cli.exit_codes import EXIT_CODES

PAGE = "reference/commands.md"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    keep(app.srcdir / PAGE, "\n\n".join(_page()) + "\n")


def _page() -> Iterator[str]:
    group = typer.main.get_command(build())
    yield "# Commands"
    yield _prose(group.help)
    yield _prose((group.epilog or "").partition(" Exit codes:")[0])
    yield from _parameters(typer.Context(group, info_name="needlefit"))
    codes = [f"| {code} | {meaning} |" for code, meaning in EXIT_CODES.items()]
    yield "\n".join(["| exit code | meaning |", "|---|---|", *codes])
    yield from _commands(typer.Context(group, info_name="needlefit"))


def _commands(above: typer.Context) -> Iterator[str]:
    for name, command in above.command.commands.items():  # type: ignore[attr-defined]
        context = typer.Context(command, info_name=name, parent=above)
        if hasattr(command, "commands"):
            yield from _commands(context)
        else:
            yield from _command(context)


def _command(context: typer.Context) -> Iterator[str]:
    yield f"## needlefit {context.command_path.partition(' ')[2]}"
    usage = " ".join([context.command_path, *context.command.collect_usage_pieces(context)])
    yield f"```text\n{re.sub('[{}]', '', usage)}\n```"
    yield _prose(context.command.help)
    yield from _parameters(context)


def _parameters(context: typer.Context) -> Iterator[str]:
    """Yield arguments and options, each with what it does, what it takes and what it is by default."""
    for parameter in context.command.get_params(context):
        record: Any = parameter.get_help_record(context)
        if record and "--help" not in parameter.opts:
            names, text = record
            yield f"`{re.sub(' <(str|path|Path|float|int|int range)>', '', names)}`\n: {_prose(text)}"


def _prose(text: str | None) -> str:
    """Return text of the terminal as Markdown that shows it as it stands."""
    plain = " ".join((text or "").split()) if "\n\n" not in (text or "") else text or ""
    return re.sub(r"([<*_\[])", r"\\\1", plain)
