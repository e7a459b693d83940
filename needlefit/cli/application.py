"""The table of commands, and what every command has in common: how it fails."""

from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from needlefit.cli import exit_codes
from needlefit.cli.calibrate import calibrate
from needlefit.cli.check import check
from needlefit.cli.credibility import credibility
from needlefit.cli.diff import diff
from needlefit.cli.identify import identify
from needlefit.cli.material import material
from needlefit.cli.migrate import migrate
from needlefit.cli.paper import paper
from needlefit.cli.predict import predict
from needlefit.cli.reconstruct import MultiFileCommand, reconstruct
from needlefit.cli.report import report
from needlefit.cli.simulate import simulate
from needlefit.cli.start import init, new_dataset
from needlefit.cli.tune import tune
from needlefit.cli.twin import twin_build, twin_ct
from needlefit.cli.validate import validate
from needlefit.cli.verify import verify
from needlefit.cli.view import view

_COMMANDS: tuple[Callable[..., None], ...] = (
    *(simulate, view, check, tune, identify, calibrate, predict, validate, report, diff),
    *(verify, credibility, material, paper, init, migrate),
)

_EPILOG = (
    "A noun is a path (holds / or ends in .toml) or a bare name, looked up in the working folder's project, "
    "then in the shipped one. Results go to ./reports/. Exit codes: "
    + ", ".join(f"{code} {meaning}" for code, meaning in exit_codes.EXIT_CODES.items())
    + "."
)


class _Guarded(TyperGroup):
    """Turns what a command raises into a message and an exit code; usage errors stay typer's."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - as the base class takes it
        try:
            return super().make_context(*args, **kwargs)
        except Exception as error:
            exit_codes.make_printable(error)
            raise

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
    """Return the application with all its commands."""
    plain = {"rich_markup_mode": None, "no_args_is_help": True}
    app = typer.Typer(cls=_Guarded, pretty_exceptions_enable=False, epilog=_EPILOG, **plain)  # type: ignore[arg-type]
    app.callback()(_needlefit)
    for command in _COMMANDS:
        app.command()(command)
    app.command(cls=MultiFileCommand)(reconstruct)
    twin = typer.Typer(help="The synthetic dataset.", **plain)  # type: ignore[arg-type]
    twin.callback()(_group)
    twin.command("build")(twin_build)
    twin.command("ct")(twin_ct)
    new = typer.Typer(help="Templates of files.", **plain)  # type: ignore[arg-type]
    new.callback()(_group)
    new.command("dataset")(new_dataset)
    app.add_typer(twin, name="twin")
    app.add_typer(new, name="new")
    return app


def _version(wanted: bool) -> None:
    if wanted:
        from needlefit import __version__

        typer.echo(f"needlefit {__version__}")
        raise typer.Exit


def _needlefit(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Fit and cross-validate bevel-tip needle models on measured insertions."""


def _group() -> None:
    pass
