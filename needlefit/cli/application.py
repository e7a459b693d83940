"""The table of commands, and what every command has in common: how it fails."""

import inspect
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from needlefit.cli import exit_codes, options
from needlefit.cli.calibrate import calibrate
from needlefit.cli.check import check
from needlefit.cli.credibility import credibility
from needlefit.cli.diff import diff
from needlefit.cli.explain import explain
from needlefit.cli.identify import identify
from needlefit.cli.import_data import import_data
from needlefit.cli.material import material
from needlefit.cli.paper import paper
from needlefit.cli.plan import plan
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

_NEW, _TWIN = "new", "twin"

_COMMANDS: Mapping[str, Mapping[Callable[..., None] | str, str]] = {
    "Data": {
        init: "init myproject",
        _NEW: "new dataset data/mine --from curves.csv",
        import_data: "import curves.xlsx --out data/mine",
        check: "check data/mine/dataset.toml",
        reconstruct: "reconstruct scans.csv --out data/mine",
        material: "material compression.csv --foundation 4 1.5",
        _TWIN: "twin build --out data/twin2 --seed 2",
    },
    "Simulate": {
        simulate: "simulate figure1 --depth 60",
        view: "view figure1",
        plan: "plan phantom2 --target 45,2 --obstacle 25,0.5,1",
    },
    "Fit": {
        tune: "tune phantom1",
        identify: "identify study3 --fit",
        calibrate: "calibrate phantom1 --replicates 100",
    },
    "Validate": {
        validate: "validate study3",
        predict: "predict study3 --scene study3",
        verify: "verify",
        credibility: "credibility study3",
    },
    "Report": {
        report: "report study3 --explain",
        explain: "explain coverage",
        diff: "diff reports/study3 old/study3",
        paper: "paper",
    },
}
"""By heading of `--help`: commands in the order of the work, each with an example."""

_EPILOG = (
    "TARGET, STUDY, SCENE and DATASET are paths (with / or .toml) or names, which are looked up in the "
    "project of the working folder, then in the shipped one. Results go to ./reports/. Exit codes: "
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

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - as the base class takes it
        """Write the commands below the headings of `_COMMANDS`."""
        for heading, members in _COMMANDS.items():
            names = [_name(one) for one in members]
            with formatter.section(heading):
                limit = formatter.width - 6 - max(map(len, self.commands))
                formatter.write_dl([(name, self.commands[name].get_short_help_str(limit)) for name in names])

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
    for command, example in (pair for group in _COMMANDS.values() for pair in group.items()):
        if not isinstance(command, str):
            form = MultiFileCommand if command in (reconstruct, view) else None
            epilog = f"Example: needlefit {example}"
            app.command(_name(command), cls=form, epilog=epilog)(_with_plugins(command))
    about = "Build the synthetic dataset, or render its CT volumes."
    twin = typer.Typer(help=about, epilog=_example(_TWIN), **plain)  # type: ignore[arg-type]
    twin.callback()(_group)
    twin.command("build", epilog=_example(_TWIN))(_with_plugins(twin_build))
    twin.command("ct", epilog="Example: needlefit twin ct phantom2-14 --out twin_ct")(_with_plugins(twin_ct))
    new = typer.Typer(help="Write example files to edit.", epilog=_example(_NEW), **plain)  # type: ignore[arg-type]
    new.callback()(_group)
    new.command("dataset", epilog=_example(_NEW))(_with_plugins(new_dataset))
    app.add_typer(twin, name=_TWIN)
    app.add_typer(new, name=_NEW)
    return app


def _name(command: Callable[..., None] | str) -> str:
    """Return the name of a command; `import` is a word of Python's."""
    return command if isinstance(command, str) else command.__name__.removesuffix("_data")


def _example(group: str) -> str:
    return f"Example: needlefit {next(found[group] for found in _COMMANDS.values() if group in found)}"


def _with_plugins(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that also takes `--plugins`, which acts while the command line is read."""

    @wraps(command)
    def run(*args: Any, plugins: options.Plugins = None, **kwargs: Any) -> None:  # noqa: ANN401
        command(*args, **kwargs)

    option = inspect.Parameter(
        "plugins", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=options.Plugins
    )
    signature = inspect.signature(command)
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*signature.parameters.values(), option]
    )
    run.__annotations__ = {**command.__annotations__, "plugins": options.Plugins}
    return run


def _version(wanted: bool) -> None:
    if wanted:
        from needlefit import __version__

        typer.echo(f"needlefit {__version__}")
        raise typer.Exit


def _needlefit(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    plugins: options.Plugins = None,
) -> None:
    """Fit and cross-validate bevel-tip needle models on measured insertions."""


def _group() -> None:
    pass
