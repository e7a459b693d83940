"""`needlefit import`: files of other programs become a dataset."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from needlefit.cli import screen
from needlefit.cli.options import argument, flag, option, takes

if TYPE_CHECKING:
    from needlefit.datasets.importing.decisions import Question


@takes(
    "strict json verbose",
    files=argument(
        "FILE_OR_FOLDER",
        "Tables (.csv .tsv .txt .xlsx .xls .ods), .mat, Slicer markups (.mrk.json .fcsv), surfaces (.stl "
        ".ply .obj .vtk), Slicer scenes (.mrml .mrb).",
    ),
    out=option("Folder of the dataset; it must not exist yet.", "DIR"),
    units=option("Unit of coordinates that state none: mm, cm, m, um, in."),
    columns=option("Headers or numbers of the columns of tables.", "X,Y,Z"),
    frame=option("LPS or RAS, for curves that state neither."),
    surfaces_frame=option("LPS or RAS, for surfaces that state neither."),
    entry=option("first or last: which end of the curves is the entry."),
    tissue_surface=option("Surface where needles enter; none: there is none.", "NAME"),
    pose=option("Entry direction: free, tangent, shaft, or X,Y,Z."),
    entry_point=option("Where the tips first touched the tissue: first (point), or X,Y,Z."),
    pose_shift_sd=option("Standard deviation of the entry point.", "MM"),
    pose_angle_sd=option("Standard deviation of the entry direction.", "DEG"),
    bevel=option("Direction toward which bevels of side 1 deflect, X,Y,Z; or bend."),
    boundaries=option("Depths of the boundaries between layers along the needle.", "MM,MM"),
    boundary_sd=option("Standard deviation of the depths of the boundaries.", "MM"),
    medium=option("Name of what was punctured."),
    specimen=option("Name of one specimen for all insertions; each: every insertion into its own."),
    needle_length=option("Length of the needle.", "MM"),
    diameter=option("Outer diameter, mm or gauge (18G).", "MM"),
    inner_diameter=option("Inner diameter; 0: solid.", "MM"),
    modulus=option("Young's modulus, or steel, nitinol, titanium, peek.", "GPA"),
    point_sd=option("Standard deviation of a point across the needle.", "MM"),
    title=option("What was inserted into what."),
    source=option("Who measured this, when, how."),
    license=option("Terms of use."),
    yes=flag("Ask nothing: take guesses and defaults.", "--yes"),
)
def import_data(
    context: typer.Context,
    files: list[Path],
    out: Path,
    columns: str | None = None,
    yes: bool = False,
    **answers: str | None,
) -> None:
    """Make a dataset from files of other programs.

    In a terminal it asks for whatever the files do not state; options answer beforehand. Then it shows what
    it understood as a table and a picture (DIR/import.png), and lists every decision under [import] in
    DIR/dataset.toml.
    """
    from needlefit.datasets.importing.conversion import name_study_file, plan_import
    from needlefit.datasets.importing.decisions import Decisions
    from needlefit.datasets.read import check_all
    from needlefit.project.folders import require_new, require_no_inputs_within
    from needlefit.reporting.dataset_import import tabulate_decisions, tabulate_needles, write_import
    from needlefit.schemas.names import require_file_name

    require_new(out)
    require_file_name(out.resolve().name, str(out))
    require_no_inputs_within(out, files)
    invocation = context.find_root().obj
    questions = {name.replace("_", " "): value for name, value in answers.items() if value is not None}
    asks = not yes and not invocation.json and sys.stdin.isatty() and sys.stderr.isatty()
    decisions = Decisions(questions, _ask if asks else None)
    content, plan = plan_import(
        files, decisions, [name.strip() for name in columns.split(",")] if columns else ()
    )
    dataset = write_import(out, content, plan, decisions)
    warnings = check_all(out)[1]
    count, needles = len(dataset.insertions), tabulate_needles(dataset)
    if invocation.json:
        screen.show_json(
            {
                "dataset": str(out / "dataset.toml"),
                "insertions": needles.to_dict(orient="records"),
                "decisions": [one.model_dump() for one in decisions.made],
                "notes": list(content.notes),
            }
        )
    else:
        assumed = sum(one.source == "assumption" for one in decisions.made)
        imported = f"{count} insertion{'s' * (count > 1)} imported; {assumed} values are assumptions"
        screen.print_line(f"{out}: {imported}\n")
        screen.show_frame(needles, "Needles")
        screen.show_frame(tabulate_decisions(decisions), "Decisions")
        for note in content.notes:
            screen.print_note(note)
    screen.print_warnings(invocation, warnings)
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
