"""An option that takes several files: `--layers FILES...`."""

import typer
from typer.core import TyperCommand

OPTION = "--layers"

SWALLOWED = (
    "no SCAN is left: --layers takes every word up to the next option as a file; put SCAN first, "
    "before the options"
)


class SeveralLayers(TyperCommand):
    """A command whose `--layers` takes all words up to the next option."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Repeat `--layers` before each of its files, as typer wants it."""
        if not ctx.resilient_parsing and _names_no_file(args):  # a shell may complete half a line
            raise typer.BadParameter("--layers names no file: FILES... follow it, or leave it out")
        try:
            return super().parse_args(ctx, repeated(args))
        except Exception as error:
            missing = getattr(getattr(error, "param", None), "name", "")
            if missing == "scans" and any(map(_begins, args)):
                raise typer.BadParameter(SWALLOWED) from None
            raise


def repeated(args: list[str]) -> list[str]:
    """Return the words of a command with `--layers` before each of the files that follow it."""
    words, files = list[str](), False
    for word in args:
        if word.startswith("-"):
            files = _begins(word)
            words += [] if word == OPTION else [word]
        else:
            words += [OPTION, word] if files else [word]
    return words


def _begins(word: str) -> bool:
    """Whether files of layers follow a word."""
    return word == OPTION or word.startswith(f"{OPTION}=")


def _names_no_file(args: list[str]) -> bool:
    return any(
        word == OPTION and after.startswith("-") for word, after in zip(args, [*args[1:], "--"], strict=True)
    )
