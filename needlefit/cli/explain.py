"""`needlefit explain`: what a warning means, and what to do."""

import difflib
from dataclasses import asdict
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.project.troubleshooting import read_sections


def _complete_keys(start: str) -> list[str]:
    return [key for key in read_sections() if key.startswith(start)]


def explain(
    key: Annotated[
        str,
        typer.Argument(
            metavar="[KEY]",
            autocompletion=_complete_keys,
            help="As printed behind the warning, such as coverage.",
        ),
    ] = "",
    json: options.Json = False,
) -> None:
    """Explain a warning: what it means, and what to do. Without KEY: list all of them."""
    sections = read_sections()
    if key and key not in sections:
        near = difflib.get_close_matches(key, sections, n=1)
        raise typer.BadParameter(
            f"`{key}` is no key of a warning" + (f"; did you mean {near[0]}?" if near else "")
        )
    chosen = [sections[key]] if key else list(sections.values())
    if json:
        screen.show_json([asdict(one) for one in chosen])
    elif key:
        screen.print_text("\n".join([chosen[0].title, *chosen[0].paragraphs]))
    else:
        for one in chosen:
            screen.print_line(f"{one.key:20}{one.title}")
