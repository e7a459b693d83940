"""`needlefit credibility`: collect the credibility evidence of a run in one document."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import complete_runs

if TYPE_CHECKING:
    from needlefit.reporting.credibility.case import CredibilityCase
    from needlefit.reporting.credibility.factors import FactorEntry


def credibility(
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            autocompletion=complete_runs,
            help="A folder of results, or its bare name in reports/.",
        ),
    ],
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
        typer.Option(metavar="FILE", help="TOML with what only people can say: question, context, risk."),
    ] = None,
    out: options.Out = Path("reports"),
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Collect what speaks for the credibility of a RUN, in the order of ASME V&V 40-2018.

    Verification, calibration, sensitivity, uncertainty and provenance, from this run's files and from what
    other commands left beside it. What is missing stays visibly empty, what is of another version or dataset
    is not counted; nothing is graded. Results go to OUT/credibility-RUN/.
    """
    from needlefit.project.input_files import convert_stored_errors
    from needlefit.project.load import load
    from needlefit.project.locate import find_run
    from needlefit.project.ownership import require_replaceable
    from needlefit.reporting.credibility.bundle import bundle_to_json, write_bundle
    from needlefit.reporting.credibility.case import NO_STATEMENTS, load_case
    from needlefit.reporting.credibility.factors import collect_entries
    from needlefit.schemas.credibility_statements import CredibilityStatementsRecord

    folder = find_run(run)
    stated = NO_STATEMENTS if statements is None else load(statements, CredibilityStatementsRecord)
    with convert_stored_errors(folder):
        found = load_case(folder, evidence or (), stated, "" if statements is None else statements.name)
        target = out / f"credibility-{found.name}"
        require_replaceable(target)
        every = collect_entries(found)
        write_bundle(found, every, folder.resolve(), target)
    for fault in found.damaged:
        screen.print_note(f"needlefit: damaged, and not used: {fault}")
    if json:
        screen.show_json(bundle_to_json(found, every))
        return
    _show(found, every)
    screen.print_line(f"written: {target}/")


def _show(found: "CredibilityCase", every: "list[FactorEntry]") -> None:
    from needlefit.reporting.credibility.document import DISCLAIMER, lay_out_evidence, lay_out_overview

    screen.show_display(lay_out_overview(every))
    if found.evidence:
        screen.show_display(lay_out_evidence(found.evidence))
    open_keys = [one.factor.key for one in every if one.factor.needs_statement and one.factor.fix in one.gaps]
    if open_keys:
        screen.print_line(
            "Not for a program to say: a TOML file with `schema = 1` and texts for any of these keys, given "
            f"by --statements FILE, fills their boxes: {', '.join(open_keys)}."
        )
    screen.print_line(DISCLAIMER)
