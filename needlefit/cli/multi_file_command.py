"""`--layers FILES...`: an option that takes all words up to the next option."""

import typer
from typer.core import TyperCommand

LAYERS_OPTION = "--layers"

NO_SCAN_MESSAGE = (
    "no SCAN is left: --layers takes every word up to the next option as a file; put SCAN first, "
    "before the options"
)


class MultiFileCommand(TyperCommand):
    """A command whose `--layers` takes all words up to the next option."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Repeat `--layers` before each of its files, as typer wants it."""
        if not ctx.resilient_parsing and _names_no_file(args):  # a shell may complete half a line
            raise typer.BadParameter("--layers names no file: FILES... follow it, or leave it out")
        try:
            return super().parse_args(ctx, repeat_option(args))
        except Exception as error:
            missing = getattr(getattr(error, "param", None), "name", "")
            if missing == "scans" and any(map(_is_layers_option, args)):
                raise typer.BadParameter(NO_SCAN_MESSAGE) from None
            raise


def repeat_option(args: list[str]) -> list[str]:
    """Return the words of a command with `--layers` before each of the files that follow it."""
    words, files = list[str](), False
    for word in args:
        if word.startswith("-"):
            files = _is_layers_option(word)
            words += [] if word == LAYERS_OPTION else [word]
        else:
            words += [LAYERS_OPTION, word] if files else [word]
    return words


def _is_layers_option(word: str) -> bool:
    """Whether files of layers follow a word."""
    return word == LAYERS_OPTION or word.startswith(f"{LAYERS_OPTION}=")


def _names_no_file(args: list[str]) -> bool:
    return any(
        word == LAYERS_OPTION and after.startswith("-")
        for word, after in zip(args, [*args[1:], "--"], strict=True)
    )
