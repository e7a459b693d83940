"""`needlefit credibility`: collect the credibility evidence of a run in one document."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import Execution
from needlefit.cli.show_results import show_result
from needlefit.project.progress import never_stop


def credibility(
    context: typer.Context,
    run: options.RunFolder,
    evidence: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DIR",
            help="A folder of verify, calibrate, identify or a sensitivity study (several times), instead of "
            "those of its kind beside RUN.",
        ),
    ] = None,
    statements: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="TOML with what only people can state: question, context, risk."),
    ] = None,
    out: options.Out = Path("reports"),
    explain: options.Explain = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Collect the credibility evidence of a RUN, in the order of ASME V&V 40-2018.

    Verification, calibration, sensitivity, uncertainty and provenance, from the files of this run and of
    other runs in the same folder. Missing evidence is listed as missing. Evidence of another version or
    dataset is not counted. Nothing is graded. Results go to OUT/credibility-RUN/.
    """
    from needlefit.project.load import load
    from needlefit.project.locate import find_run
    from needlefit.project.manifest import require_replaceable
    from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
    from needlefit.studies.kind import find_kind
    from needlefit.studies.kinds.credibility.report import list_open_statements

    options_: dict[str, object] = {"run": run, "evidence": [str(folder) for folder in evidence or ()]}
    if statements is not None:
        options_["statements"] = load(statements, CredibilityStatementsRecord)
        options_["statements_file"] = statements.name
    name = f"credibility-{find_run(run).resolve().name}"
    execution = Execution(context.find_root().obj, out, None, None, False, never_stop)
    require_replaceable(execution.folder(name))
    found = execution.run_and_write(name, find_kind("credibility").make_record(**options_))
    for fault in found.run["damaged"]:
        screen.print_note(f"needlefit: damaged and not used: {fault}")
    show_result(execution.invocation, found, execution.folder(name), json)
    if not json and (missing := list_open_statements(found)):
        screen.print_text(
            "Statements that only people can make are missing. Write them as texts in a TOML file with "
            f"`schema = 1`, given by --statements FILE: {', '.join(missing)}."
        )
