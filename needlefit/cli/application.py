"""The commands; their files import what they need where it is used, so that none waits for the others."""

from collections.abc import Callable
from typing import Annotated, Any

import typer

from needlefit.cli import data, exit_codes, pages, reconstruct, results, simulate, studies
from needlefit.cli.options import option, take_options

_STUDY_OPTIONS = ("resume", "strict", "explain", "json", "quiet", "plugins")
COMMANDS: tuple[tuple[str, Callable[..., None], str, tuple[str, ...]], ...] = (
    ("import", data.import_data, "curves.xlsx --out ./mydata", ("strict", "json", "plugins")),
    ("check", data.check, "./mydata", ("strict", "json", "plugins")),
    ("tune", studies.tune, "phantom1", ("seed", "jobs", "out", *_STUDY_OPTIONS)),
    (
        "validate",
        studies.validate,
        "study3",
        ("seed", "jobs", "scheduler", "insecure", "out", "reference", *_STUDY_OPTIONS),
    ),
    ("predict", studies.predict, "study3 --scene study3", ("seed", "jobs", "out", *_STUDY_OPTIONS)),
    ("simulate", simulate.simulate, "phantom1 --depth 60", ("strict", "json", "plugins")),
    ("view", pages.view, "figure1", ("out", "quiet", "plugins")),
    (
        "plan",
        pages.plan,
        "phantom2 --target 45,2 --obstacle 25,3,1",
        ("out", "jobs", "json", "quiet", "plugins"),
    ),
    ("explain", results.explain, "coverage", ("json", "plugins")),
    ("report", results.report, "study3 --explain", ("explain", "strict", "json", "quiet", "plugins")),
    ("diff", results.diff, "reports/study3 old/study3", ("json", "plugins")),
    (
        "reconstruct",
        reconstruct.reconstruct,
        "scans.csv --out data/mine",
        ("jobs", "scheduler", "insecure", "strict", "json", "quiet", "plugins"),
    ),
    ("new project", data.new_project, "myproject", ()),
    ("new workbook", data.new_workbook, "needles.xlsx", ()),
)
"""Name, function, words of an example, and further options; those most used come first."""

_GROUPS = {
    "new": "Write files to edit: a project, or a workbook.",
}

_STYLE: dict[str, Any] = {"rich_markup_mode": None, "no_args_is_help": True}
_EPILOG = (
    "TARGET, STUDY, SCENE and DATASET are paths (with / or .toml) or names, which are looked up in the "
    "project of the working folder, then in the shipped one. Results go to ./reports/. Exit codes: "
    + ", ".join(f"{code} {meaning}" for code, meaning in exit_codes.EXIT_CODES.items())
    + "."
)


def build() -> typer.Typer:
    """Return the application."""
    app = typer.Typer(pretty_exceptions_enable=False, epilog=_EPILOG, **_STYLE)
    app.callback()(_needlefit)
    groups = {name: typer.Typer(name=name, help=text, **_STYLE) for name, text in _GROUPS.items()}
    for name, function, example, kept in COMMANDS:
        *group, word = name.split()
        holder = groups[group[0]] if group else app
        epilog = f"Example: needlefit {name} {example}".rstrip()
        holder.command(word, epilog=epilog)(take_options(function, kept))
    for subgroup in groups.values():
        app.add_typer(subgroup)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        from needlefit import __version__

        typer.echo(f"needlefit {__version__}")
        raise typer.Exit


def _needlefit(
    context: typer.Context,
    verbose: Annotated[bool, option("Tracebacks of errors.", None, "--verbose", "-v")] = False,
    version: Annotated[
        bool,
        option("Show the version and exit.", None, "--version", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    """Fit and cross-validate bevel-tip needle models on measured insertions."""
    context.obj.verbose = verbose
