"""The table of commands, and what every command has in common: how it fails.

A command is imported when it is run or its help is printed, so that none waits for the others.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from needlefit.cli import exit_codes, options

_COMMANDS: Mapping[str, Mapping[str, str]] = {
    "Commands": {
        "import": "curves.xlsx --out ./mydata",
        "check": "./mydata",
        "tune": "phantom1",
        "validate": "study3",
        "predict": "study3 --scene study3",
        "simulate": "figure1 --depth 60",
        "view": "figure1",
        "plan": "phantom2 --target 45,2 --obstacle 25,0.5,1",
        "explain": "coverage",
    },
    "data": {
        "new project": "myproject",
        "new dataset": "data/mine",
        "new workbook": "needles.xlsx",
        "reconstruct": "scans.csv --out data/mine",
        "twin build": "--out data/twin2 --seed 2",
        "twin ct": "phantom2-14 --out twin_ct",
    },
    "evidence": {
        "calibrate": "phantom1 --replicates 100",
        "paper": "",
    },
    "results": {
        "report": "study3 --explain",
        "diff": "reports/study3 old/study3",
    },
}
"""By heading of `--help`: commands, each with the words of an example; those most used come first."""

_GROUPS = {
    "new": "Write files to edit: a project, a dataset, or a workbook.",
    "twin": "Build the synthetic dataset, or render its CT volumes.",
}
"""First words of commands that form a group, with its help."""

_DATA = ("new project", "new dataset", "new workbook", "check", "twin build", "twin ct")
_STUDIES = ("tune", "calibrate", "validate", "predict")

_MODULES = {
    "import": "data.import_data",
    **{name: f"data.{name.replace(' ', '_')}" for name in _DATA},
    **{name: f"studies.{name}" for name in _STUDIES},
    **{name: f"results.{name}" for name in ("report", "explain", "diff", "paper")},
}
"""The module of a command in `needlefit.cli`, where it has not its name, and its function likewise."""

LAYERS_OPTION = "--layers"

_MULTI_FILE_COMMANDS = ("reconstruct", "view")
"""Commands whose `--layers` takes all words up to the next option."""

NO_SCAN_MESSAGE = (
    "no SCAN is left: --layers takes every word up to the next option as a file; put SCAN first, "
    "before the options"
)

_STYLE: Mapping[str, Any] = {"rich_markup_mode": None, "no_args_is_help": True}

_EPILOG = (
    "TARGET, STUDY, SCENE and DATASET are paths (with / or .toml) or names, which are looked up in the "
    "project of the working folder, then in the shipped one. Results go to ./reports/. Exit codes: "
    + ", ".join(f"{code} {meaning}" for code, meaning in exit_codes.EXIT_CODES.items())
    + "."
)


class _Commands(Mapping[str, Any]):
    """The commands whose names begin with `prefix`, by the next word; each is built when it is looked up."""

    def __init__(self, prefix: str) -> None:
        names = [name for words in _COMMANDS.values() for name in words if name.startswith(prefix)]
        words = [name.removeprefix(prefix).split()[0] for name in names]
        self._names = {word: f"{prefix}{word}" for word in words}

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, word: str) -> Any:  # noqa: ANN401 - a command of typer's own click
        return _build_command(self._names[word])


class _Group(TyperGroup):
    """A group of commands."""

    def __init__(self, **kwargs: Any) -> None:  # noqa: ANN401 - as the base class takes it
        super().__init__(**kwargs)
        self.commands = _Commands(f"{self.name} " if self.name else "")  # type: ignore[assignment]


class _Guarded(_Group):
    """Turns what a command raises into a message and an exit code; usage errors stay typer's."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - as the base class takes it
        try:
            return super().make_context(*args, **kwargs)
        except Exception as error:
            exit_codes.make_printable(error)
            raise

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - as the base class takes it
        """Write the commands most used, each with its help, and the names of the others by heading."""
        (first, commands), *more = _COMMANDS.items()
        with formatter.section(first):
            limit = formatter.width - 6 - max(map(len, commands))
            formatter.write_dl([(one, self.commands[one].get_short_help_str(limit)) for one in commands])
        with formatter.section("More (needlefit COMMAND --help)"):
            names = {head: dict.fromkeys(one.split()[0] for one in members) for head, members in more}
            formatter.write_dl([(head, ", ".join(words)) for head, words in names.items()])

    def invoke(self, ctx: typer.Context) -> object:  # type: ignore[override]
        try:
            result = super().invoke(ctx)
        except BaseException as error:
            code = exit_codes.report_error(error, ctx.find_root().obj)
            if code is None:
                exit_codes.make_printable(error)
                raise
            raise typer.Exit(code) from None
        invocation = ctx.find_root().obj
        if invocation.strict and invocation.warned:
            raise typer.Exit(exit_codes.NOT_CONVERGED)
        return result


def build() -> typer.Typer:
    app = typer.Typer(cls=_Guarded, pretty_exceptions_enable=False, epilog=_EPILOG, **_STYLE)
    app.callback()(_needlefit)
    return app


@cache
def _build_command(name: str) -> Any:  # noqa: ANN401 - a command of typer's own click
    if name in _GROUPS:
        first = next(one for words in _COMMANDS.values() for one in words if one.startswith(f"{name} "))
        group = typer.Typer(
            name=name, cls=_Group, help=_GROUPS[name], epilog=_example(first), add_completion=False, **_STYLE
        )
        group.callback()(_no_options)
        return typer.main.get_command(group)
    module, _, function = _MODULES.get(name, name).partition(".")
    app = typer.Typer(rich_markup_mode=None, add_completion=False)
    form = MultiFileCommand if name in _MULTI_FILE_COMMANDS else None
    command = getattr(import_module(f"needlefit.cli.{module}"), function or name)
    app.command(name.split()[-1], cls=form, epilog=_example(name))(command)
    built: Any = typer.main.get_command(app)
    for one in built.params:
        if one.param_type_name == "argument":  # its name is enough, without the type in Python
            one.display_type_rich = lambda ctx: None
    return built


class MultiFileCommand(TyperCommand):
    """A command whose `--layers` takes all words up to the next option."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Repeat `--layers` before each of its files, as typer wants it."""
        nameless = any(
            word == LAYERS_OPTION and after.startswith("-")
            for word, after in zip(args, [*args[1:], "--"], strict=True)
        )
        if nameless and not ctx.resilient_parsing:  # a shell may complete half a line
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


def _example(name: str) -> str:
    words = next(found[name] for found in _COMMANDS.values() if name in found)
    return f"Example: needlefit {name} {words}".rstrip()


def _version(wanted: bool) -> None:
    if wanted:
        from needlefit import __version__

        typer.echo(f"needlefit {__version__}")
        raise typer.Exit


@options.takes(
    "",
    version=options.flag("Show the version and exit.", "--version", callback=_version, is_eager=True),
)
def _needlefit(version: bool = False) -> None:
    """Fit and cross-validate bevel-tip needle models on measured insertions."""


def _no_options() -> None:
    """Read the options of a group: it has none."""
