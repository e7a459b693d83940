"""The command reference, read out of the very application that the command line runs."""

from collections.abc import Iterator
from typing import Any

import typer
from sphinx.application import Sphinx

from needlefit.cli.application import build
from needlefit.cli.failure import EXIT_CODES

PAGE = "reference/commands.md"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    page = app.srcdir / PAGE
    page.parent.mkdir(exist_ok=True)
    text = "\n\n".join(_page()) + "\n"
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")


def _page() -> Iterator[str]:
    group = typer.main.get_command(build())
    yield "# Commands"
    yield _prose(group.help)
    yield _prose(group.epilog)
    yield from _parameters(typer.Context(group, info_name="needlefit"))
    yield "| exit code | meaning |\n|---|---|\n" + "\n".join(f"| {c} | {why} |" for c, why in EXIT_CODES.items())
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
    yield f"```text\n{' '.join([context.command_path, *context.command.collect_usage_pieces(context)])}\n```"
    yield _prose(context.command.help)
    yield from _parameters(context)


def _parameters(context: typer.Context) -> Iterator[str]:
    """Yield arguments and options, each with what it does, what it takes and what it is by default."""
    for parameter in context.command.get_params(context):
        record: Any = parameter.get_help_record(context)
        if record and "--help" not in parameter.opts:
            names, text = record
            yield f"`{names}`\n: {_prose(text)}"


def _prose(text: str | None) -> str:
    """Return text of the terminal as Markdown that shows it as it stands."""
    plain = " ".join((text or "").split()) if "\n\n" not in (text or "") else text or ""
    return plain.replace("<", r"\<").replace("*", r"\*").replace("_", r"\_").replace("[", r"\[")
