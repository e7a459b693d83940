"""`needlefit credibility`: what speaks for a run's credibility, in one document, gaps left empty."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.completion import runs

if TYPE_CHECKING:
    from needlefit.reporting.credibility.case import Case
    from needlefit.reporting.credibility.entries import Entry


def credibility(
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN", autocompletion=runs, help="A folder of results, or its bare name in reports/."
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
    about: Annotated[
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
    from needlefit.project.load import load
    from needlefit.project.ownership import require_replaceable
    from needlefit.project.places import find_run
    from needlefit.project.reading import stored_values
    from needlefit.project.records.about import AboutRecord
    from needlefit.reporting.credibility.case import NOBODY, case
    from needlefit.reporting.credibility.entries import entries
    from needlefit.reporting.credibility.write import as_json, write_bundle

    folder = find_run(run)
    stated = NOBODY if about is None else load(about, AboutRecord)
    with stored_values(folder):
        found = case(folder, evidence or (), stated, "" if about is None else about.name)
        target = out / f"credibility-{found.name}"
        require_replaceable(target)
        every = entries(found)
        write_bundle(found, every, folder.resolve(), target)
    for fault in found.damaged:
        screen.note(f"needlefit: damaged, and not used: {fault}")
    if json:
        screen.show_json(as_json(found, every))
        return
    _show(found, every)
    screen.say(f"written: {target}/")


def _show(found: "Case", every: "list[Entry]") -> None:
    from needlefit.reporting.credibility.origins import evidence_layout
    from needlefit.reporting.credibility.page import DISCLAIMER, overview

    screen.show_display(overview(every))
    if found.evidence:
        screen.show_display(evidence_layout(found.evidence))
    open_keys = [one.factor.key for one in every if one.factor.by_people and one.factor.mend in one.gaps]
    if open_keys:
        screen.say(
            "Not for a program to say: a TOML file with `schema = 1` and texts for any of these keys, given "
            f"by --about FILE, fills their boxes: {', '.join(open_keys)}."
        )
    screen.say(DISCLAIMER)
