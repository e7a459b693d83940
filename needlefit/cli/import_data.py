"""`needlefit import`: files of other programs become a dataset."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen

if TYPE_CHECKING:
    from needlefit.datasets.importing.decisions import Decisions, Question
    from needlefit.datasets.insertion import Dataset

Text = str | None


def import_data(
    context: typer.Context,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE_OR_FOLDER",
            help="Tables (.csv .tsv .txt .xlsx .xls .ods), .mat, Slicer markups (.mrk.json .fcsv), surfaces "
            "(.stl .ply .obj .vtk), Slicer scenes (.mrml .mrb).",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the dataset; it must not exist yet.")],
    units: Annotated[
        Text, typer.Option(help="Unit of coordinates that state none: mm, cm, m, um, in.")
    ] = None,
    columns: Annotated[
        Text, typer.Option(metavar="X,Y,Z", help="Headers or numbers of the columns of tables.")
    ] = None,
    frame: Annotated[Text, typer.Option(help="LPS or RAS, for curves that state neither.")] = None,
    surfaces_frame: Annotated[Text, typer.Option(help="LPS or RAS, for surfaces that state neither.")] = None,
    entry: Annotated[Text, typer.Option(help="first or last: which end of the curves is the entry.")] = None,
    tissue_surface: Annotated[
        Text, typer.Option(metavar="NAME", help="Surface where needles enter; none: there is none.")
    ] = None,
    pose: Annotated[Text, typer.Option(help="Entry direction: free, tangent, shaft, or X,Y,Z.")] = None,
    entry_point: Annotated[
        Text, typer.Option(help="Where the tips first touched the tissue: first (point), or X,Y,Z.")
    ] = None,
    pose_shift_sd: Annotated[
        Text, typer.Option(metavar="MM", help="Standard deviation of the entry point.")
    ] = None,
    pose_angle_sd: Annotated[
        Text, typer.Option(metavar="DEG", help="Standard deviation of the entry direction.")
    ] = None,
    bevel: Annotated[
        Text, typer.Option(help="Direction toward which bevels of side 1 deflect, X,Y,Z; or bend.")
    ] = None,
    boundaries: Annotated[
        Text, typer.Option(metavar="MM,MM", help="Depths of the boundaries between layers along the needle.")
    ] = None,
    boundary_sd: Annotated[
        Text, typer.Option(metavar="MM", help="Standard deviation of the depths of the boundaries.")
    ] = None,
    medium: Annotated[Text, typer.Option(help="Name of what was punctured.")] = None,
    specimen: Annotated[
        Text,
        typer.Option(help="Name of one specimen for all insertions; each: every insertion into its own."),
    ] = None,
    needle_length: Annotated[Text, typer.Option(metavar="MM", help="Length of the needle.")] = None,
    diameter: Annotated[Text, typer.Option(metavar="MM", help="Outer diameter, mm or gauge (18G).")] = None,
    inner_diameter: Annotated[Text, typer.Option(metavar="MM", help="Inner diameter; 0: solid.")] = None,
    modulus: Annotated[
        Text, typer.Option(metavar="GPA", help="Young's modulus, or steel, nitinol, titanium, peek.")
    ] = None,
    point_sd: Annotated[
        Text, typer.Option(metavar="MM", help="Standard deviation of a point across the needle.")
    ] = None,
    title: Annotated[Text, typer.Option(help="What was inserted into what.")] = None,
    source: Annotated[Text, typer.Option(help="Who measured this, when, how.")] = None,
    license_: Annotated[Text, typer.Option("--license", help="Terms of use.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing: take guesses and defaults.")] = False,
    strict: options.Strict = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
) -> None:
    """Make a dataset from files of other programs.

    In a terminal it asks for whatever the files do not state; options answer beforehand. Then it shows what
    it understood as a table and a picture (DIR/import.png), and lists every decision under [import] in
    DIR/dataset.toml.
    """
    from needlefit.datasets.importing.conversion import name_study_file, plan_import
    from needlefit.datasets.importing.decisions import Decisions
    from needlefit.datasets.read import check_all
    from needlefit.project.atomic_write import require_new
    from needlefit.project.outputs import require_no_inputs_within
    from needlefit.reporting.dataset_import import write_import
    from needlefit.schemas.names import require_file_name

    require_new(out)
    require_file_name(out.resolve().name, str(out))
    require_no_inputs_within(out, files)
    questions = {
        name.removesuffix("_").replace("_", " "): value
        for name, value in context.params.items()
        if isinstance(value, str) and name != "columns"
    }
    asks = not yes and not json and sys.stdin.isatty() and sys.stderr.isatty()
    decisions = Decisions(questions, _ask if asks else None)
    content, plan = plan_import(
        files, decisions, [name.strip() for name in columns.split(",")] if columns else ()
    )
    dataset = write_import(out, content, plan, decisions)
    warnings = check_all(out)[1]
    if json:
        _show_json(out, dataset, decisions, content.notes)
    else:
        _show(out, dataset, decisions, content.notes)
    screen.print_warnings(context.find_root().obj, warnings)
    path = str(out) if out.is_absolute() else f"./{out}"
    screen.print_note(f"look at {out}/import.png, then: {shlex.join(('needlefit', 'check', path))}")
    study_file = name_study_file(dataset.name)
    if (out / study_file).is_file():
        study = shlex.join(("needlefit", "validate", f"{path}/{study_file}"))
        screen.print_note(f"a first study, by cross-validation: {study}")


def _ask(question: "Question", guess: str, reason: str) -> str:
    """Ask on the terminal; an empty answer takes the guess."""
    if reason:
        screen.print_note(f"  ({reason})")
    choices = f" ({', '.join(question.choices)})" if 0 < len(question.choices) <= 6 else ""
    answer: str = typer.prompt(f"{question.text}{choices}", default=guess, err=True)
    return "" if answer == guess else answer


def _show(out: Path, dataset: "Dataset", decisions: "Decisions", notes: Sequence[str]) -> None:
    from needlefit.reporting.dataset_import import tabulate_decisions, tabulate_needles

    count = len(dataset.insertions)
    assumed = sum(one.source == "assumption" for one in decisions.made)
    what = f"{out}: {count} insertion{'s' * (count > 1)} imported; {assumed} values are assumptions"
    screen.print_line(what)
    screen.print_line()
    screen.show_frame(tabulate_needles(dataset), "Needles")
    screen.show_frame(tabulate_decisions(decisions), "Decisions")
    for note in notes:
        screen.print_note(note)


def _show_json(out: Path, dataset: "Dataset", decisions: "Decisions", notes: Sequence[str]) -> None:
    from needlefit.reporting.dataset_import import tabulate_needles

    screen.show_json(
        {
            "dataset": str(out / "dataset.toml"),
            "insertions": tabulate_needles(dataset).to_dict(orient="records"),
            "decisions": [one.model_dump() for one in decisions.made],
            "notes": list(notes),
        }
    )
