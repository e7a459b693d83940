"""Commands that make and check data: new, import, check, twin."""

import shlex
import shutil
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from needlefit.cli import screen
from needlefit.cli.execution import open_pool
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import (
    Insecure,
    Jobs,
    Json,
    Plugins,
    Quiet,
    Scheduler,
    Strict,
    argument,
    option,
)
from needlefit.cli.progress import show_progress
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import PROJECT_FOLDERS, join_names, shipped_folder
from needlefit.project.processes import count_cores
from needlefit.project.result_warnings import WARNINGS_KEY, to_rows

if TYPE_CHECKING:
    from needlefit.datasets.importing.answers import Answers
    from needlefit.datasets.insertion import Dataset


def new_project(
    folder: Annotated[Path, argument("DIR", "A folder; it is made if it is missing.")],
) -> None:
    """Write an editable copy of the project to DIR.

    That is data/, configs/ and studies/; in DIR the program then uses those.
    """
    for written in copy_project(folder):
        screen.print_line(str(written))
    screen.print_note(f"edit them, then: {shlex.join(('cd', str(folder)))} && needlefit validate study3")


def new_dataset(folder: Annotated[Path, argument("DIR", "A folder that does not exist yet.")]) -> None:
    """Write an example dataset to DIR, to be filled with your own measurements.

    It passes `needlefit check`; what you must fill in is marked TO FILL IN.
    """
    from needlefit.datasets.template import write_template

    screen.print_line(str(write_template(folder)))
    path = str(folder) if folder.is_absolute() else f"./{folder}"
    screen.print_note(f"fill it in, then: {shlex.join(('needlefit', 'check', path))}")


def new_workbook(
    file: Annotated[Path, argument("FILE", "A workbook (.xlsx) that does not exist yet.")],
) -> None:
    """Write a workbook to fill in with your needles, beside filled examples.

    `needlefit import` reads it; while it is not filled in, the examples.
    """
    from needlefit.datasets.importing.files import WORKBOOK_FILE
    from needlefit.project.folders import replace_file

    if file.suffix.lower() != ".xlsx" or file.exists():
        what = "exists already" if file.exists() else f"has the ending {file.suffix!r}"
        raise ConfigError(what, where=str(file), expected="a new .xlsx", fix="choose another name")
    with replace_file(file) as fresh:
        shutil.copyfile(WORKBOOK_FILE, fresh)
    screen.print_line(str(file))
    path = str(file) if file.is_absolute() else f"./{file}"
    screen.print_note(f"fill it in, then: {shlex.join(('needlefit', 'import', path, '--out', file.stem))}")


MAX_LISTED_NAMES = 5  # files that a message names
_IGNORED = shutil.ignore_patterns(".*", "__pycache__", "*.partial")


def copy_project(folder: Path) -> list[Path]:
    """Copy the shipped `data/ configs/ studies/` into `folder`, which is made if it is missing.

    Hidden entries of `folder`, such as `.git`, stay beside them.

    ConfigError if `folder` is a file, the root or the user's home, or holds anything that is not hidden.
    """
    from needlefit.project.folders import create_folder, require_writable

    targets = [folder / part for part in PROJECT_FOLDERS]
    require_writable(folder)
    _require_unused(folder)
    for part, target in zip(PROJECT_FOLDERS, targets, strict=True):
        with create_folder(target) as fresh:
            shutil.copytree(shipped_folder() / part, fresh, ignore=_IGNORED, dirs_exist_ok=True)
    return targets


def _require_unused(folder: Path) -> None:
    """See that a project scatters no files among others: the folder is missing, empty, or a repository."""
    place, home = folder.resolve(), None
    with suppress(RuntimeError):  # the user may have none
        home = Path.home().resolve()
    if folder.exists() and not folder.is_dir():
        what = "exists already, and is a file"
    elif place == home:
        what = "is your home folder"
    else:
        held = sorted(folder.iterdir()) if folder.is_dir() else []
        shown = [str(path) for path in held if not path.name.startswith(".")]
        if not shown:
            return
        what = f"exists already, and holds {join_names(shown, MAX_LISTED_NAMES)}"
    raise ConfigError(
        what,
        where=str(folder),
        expected="a new folder, or an empty one",
        fix="choose another folder: nothing is overwritten",
    )


# ---- import


def import_data(
    context: typer.Context,
    files: Annotated[
        list[Path],
        argument(
            "FILE_OR_FOLDER",
            "Tables (.csv .tsv .txt .xlsx .xls .ods), .mat, RT structure sets (.dcm), Slicer markups "
            "(.mrk.json .fcsv), surfaces (.stl .ply .obj .vtk).",
        ),
    ],
    out: Annotated[Path, option("Folder of the dataset; it must not exist yet.", "DIR")],
    columns: Annotated[
        str | None,
        option("Columns of tables by header or number: X,Y,Z, or MEANING=HEADER,...", "X,Y,Z"),
    ] = None,
    observable: Annotated[
        str | None, option("What the points are: shapes of needles, or tracks of a tip on its way.")
    ] = None,
    units: Annotated[
        str | None, option("Unit of coordinates that state none, or a wrong one: mm, cm, m, um, in.")
    ] = None,
    frame: Annotated[str | None, option("LPS or RAS, for files that state neither.")] = None,
    entry: Annotated[str | None, option("first or last: which end of the curves is the entry.")] = None,
    tissue_surface: Annotated[
        str | None, option("Surface where needles enter; none: there is none.", "NAME")
    ] = None,
    pose: Annotated[
        str | None, option("Entry direction: X,Y,Z; shaft: of the points before the entry; free: unknown.")
    ] = None,
    entry_point: Annotated[
        str | None,
        option("Where the tips touched the tissue: first point, stated depth from the tip, or X,Y,Z."),
    ] = None,
    pose_shift_sd: Annotated[str | None, option("Standard deviation of the entry point.", "MM")] = None,
    pose_angle_sd: Annotated[str | None, option("Standard deviation of the entry direction.", "DEG")] = None,
    bevel: Annotated[
        str | None, option("Direction toward which bevels of side 1 deflect, X,Y,Z; or bend.")
    ] = None,
    bevel_side: Annotated[
        str | None, option("Sides that bevels face: 1 or -1 of all, or NAME=1,NAME=-1.")
    ] = None,
    boundaries: Annotated[
        str | None, option("Depths of the boundaries between layers along the needle.", "MM,MM")
    ] = None,
    boundary_sd: Annotated[
        str | None, option("Standard deviation of the depths of the boundaries.", "MM")
    ] = None,
    medium: Annotated[str | None, option("Name of what was punctured.")] = None,
    specimen: Annotated[
        str | None, option("Name of one specimen for all insertions; each: every insertion into its own.")
    ] = None,
    needle_length: Annotated[str | None, option("Length of the needle.", "MM")] = None,
    diameter: Annotated[str | None, option("Outer diameter, mm or gauge (18G).", "MM")] = None,
    inner_diameter: Annotated[str | None, option("Inner diameter; 0: solid.", "MM")] = None,
    modulus: Annotated[
        str | None, option("Young's modulus, or steel, nitinol, titanium, peek.", "GPA")
    ] = None,
    point_sd: Annotated[str | None, option("Standard deviation of a point across the needle.", "MM")] = None,
    title: Annotated[str | None, option("What was inserted into what.")] = None,
    source: Annotated[str | None, option("Who measured this, when, how.")] = None,
    license: Annotated[str | None, option("Terms of use.")] = None,
    yes: Annotated[
        bool, option("Ask nothing: take defaults, and stop where there is none.", None, "--yes")
    ] = False,
    strict: Strict = False,
    json: Json = False,
    plugins: Plugins = None,
) -> None:
    """Make a dataset from files of other programs.

    Columns are known by their names in five languages; others are named with --columns. In a terminal it asks
    for whatever the files do not state, one question at a time, and shows a picture before it writes; options
    answer beforehand. DIR/dataset.toml lists every decision under [import], with all columns, rows, fields
    and sheets that are not used. DIR also gets a first study and a scene.
    """
    from needlefit.datasets.importing.answers import QUESTIONS, Answers
    from needlefit.datasets.importing.files import read_content
    from needlefit.datasets.importing.planning import Planner
    from needlefit.datasets.importing.tables import UnclearColumnsError
    from needlefit.datasets.read import check_all
    from needlefit.datasets.template import SCENE_FILE, name_study_file
    from needlefit.project.folders import require_new, require_no_inputs_within
    from needlefit.reporting.dataset_import import (
        PICTURE_FILE,
        tabulate_decisions,
        tabulate_needles,
        write_import,
    )
    from needlefit.schemas.names import require_file_name

    require_new(out)
    require_file_name(out.resolve().name, str(out))
    require_no_inputs_within(out, files)
    invocation = context.find_root().obj
    asks = not yes and not invocation.json and sys.stdin.isatty() and sys.stderr.isatty()
    try:
        content = read_content(files, columns or "")
    except UnclearColumnsError as error:
        if not asks or columns:
            raise
        content = read_content(files, _ask("columns", "", f"{error.where}: {error.what}"))
    named = {name.replace("_", " "): value for name, value in context.params.items() if value is not None}
    settled = Answers({what: named[what] for what in QUESTIONS if what in named}, _ask if asks else None)
    plan = Planner(content, settled).make_plan()
    for line in _list_decisions(settled, "not used", "assumption"):
        screen.print_note(line)
    if asks:
        with tempfile.TemporaryDirectory(prefix="needlefit-import-") as drafts:
            folder = Path(drafts, out.name)
            screen.show_frame(tabulate_needles(write_import(folder, content, plan, settled)), "Needles")
            screen.print_note(f"look at {folder / PICTURE_FILE}")
            if not typer.confirm(f"Write {out}", default=True, err=True):
                screen.print_note("nothing is written")
                raise typer.Exit
    dataset = write_import(out, content, plan, settled)
    warnings = check_all(out)[1]
    needles = tabulate_needles(dataset)
    if invocation.json:
        decisions, notes = [one.model_dump() for one in settled.made], list(content.notes)
        rows = needles.to_dict(orient="records")
        file = str(out / "dataset.toml")
        screen.show_json({"dataset": file, "insertions": rows, "decisions": decisions, "notes": notes})
    else:
        count, assumed = len(dataset.insertions), len(_list_decisions(settled, "", "assumption"))
        imported = f"{count} insertion{'s' * (count > 1)} imported; {assumed} values are assumptions"
        screen.print_line(f"{out}: {imported}\n")
        screen.show_frame(needles, "Needles")
        screen.show_frame(tabulate_decisions(settled), "Decisions")
        for note in content.notes:
            screen.print_note(note)
    screen.print_warnings(invocation, warnings)
    path = str(out) if out.is_absolute() else f"./{out}"
    look = f"look at {out / PICTURE_FILE}, then: " if (out / PICTURE_FILE).is_file() else "then: "
    screen.print_note(look + shlex.join(("needlefit", "check", path)))
    study_file = name_study_file(dataset.name)
    if (out / study_file).is_file():
        study = shlex.join(("needlefit", "validate", f"{path}/{study_file}"))
        screen.print_note(f"a first study, by cross-validation: {study}")
        predict = ("needlefit", "predict", f"{path}/{study_file}", "--scene", f"{path}/{SCENE_FILE}")
        screen.print_note(f"then a prediction: {shlex.join(predict)}")


def _list_decisions(answers: "Answers", what: str, source: str) -> list[str]:
    """Return the decisions of this name or from this source, as lines."""
    shown = {"assumption": "assumed", "not used": "not used"}
    return [
        f"{shown[source] if one.source == source else shown[what]}: "
        + (
            f"{one.value} ({one.reason})"
            if one.what == "not used"
            else f"{one.what} = {one.value} ({one.reason})"
        )
        for one in answers.made
        if one.what == what or one.source == source
    ]


def _ask(what: str, guess: str, reason: str) -> str:
    """Ask on the terminal; an empty answer takes the guess."""
    from needlefit.datasets.importing.answers import QUESTIONS

    if reason:
        screen.print_note(f"  ({reason})")
    text = (
        QUESTIONS[what].text
        if what in QUESTIONS
        else "Headers or numbers of x, y and z, or MEANING=HEADER,..."
    )
    answer: str = typer.prompt(text, default=guess, err=True)
    return "" if answer == guess else answer


# ---- check


def check(
    context: typer.Context,
    name: Annotated[
        str,
        argument(
            "DATASET|STUDY",
            "data/<name>/dataset.toml, studies/<name>.toml, configs/fits/<name>.toml, or a path.",
        ),
    ],
    strict: Strict = False,
    json: Json = False,
    plugins: Plugins = None,
) -> None:
    """Check a dataset or study: list faults, fixes and warnings.

    For a dataset it checks files, ids, units, centrelines, surfaces, bevel sides and checksums; for a study
    its keys and all files that it names. Every fit makes the same checks. Exit code 3: there is a fault; with
    --strict, 5: there is a warning.
    """
    from needlefit.project.locate import find_dataset_or_study

    kind, path = find_dataset_or_study(name)
    invocation = context.find_root().obj
    if kind == "dataset":
        _check_dataset(invocation, path)
    else:
        _check_study(invocation, kind, name, path)


def _check_study(invocation: Invocation, kind: Literal["study", "fit"], name: str, path: Path) -> None:
    from needlefit.project.locate import file_label
    from needlefit.studies.study_files import check_study_file

    found = check_study_file(kind, path)
    if invocation.json:
        folds = [{"tune": tune, "validate": held_out} for tune, held_out in found.folds]
        rows = to_rows(found.warnings)
        screen.show_json(
            {"study": str(path), "ok": True, "kind": found.kind, "folds": folds, WARNINGS_KEY: rows}
        )
    else:
        screen.print_text(f"No faults: {file_label(path)}, {found.kind}{_describe_folds(found.folds)}.")
    screen.print_warnings(invocation, found.warnings)
    if not invocation.json:
        command = "tune" if kind == "fit" else "validate"
        screen.print_note(f"next: {shlex.join(('needlefit', command, name))}")


def _describe_folds(folds: Sequence[tuple[int, int]]) -> str:
    if not folds:
        return ""
    tune, held_out = (sorted(set(counts)) for counts in zip(*folds, strict=True))
    counts = f": n = {_join_range(tune)} fitted"
    if any(held_out):
        counts += f", {_join_range(held_out)} held out"
    return counts if len(folds) == 1 else f"{counts}, in each of {len(folds)} folds"


def _join_range(counts: Sequence[int]) -> str:
    return f"{counts[0]}" if len(counts) == 1 else f"{min(counts)} to {max(counts)}"


def _check_dataset(invocation: Invocation, path: Path) -> None:
    from needlefit.datasets.read import inspect
    from needlefit.datasets.sections import describe_measurement
    from needlefit.datasets.select import describe_holes

    found = inspect(path)
    faults, warnings = found.faults, found.warnings
    measured = "" if found.dataset is None else describe_measurement(found.dataset)
    holes = "" if found.dataset is None else describe_holes(found.dataset)
    if invocation.json:
        keys = ("where", "what", "expected", "fix")
        rows = [{key: str(getattr(fault, key)) for key in keys} for fault in faults]
        screen.show_json(
            {
                "dataset": str(path),
                "ok": not faults,
                "measurement": measured,
                "holes": holes,
                "faults": rows,
                WARNINGS_KEY: to_rows(warnings),
            }
        )
    else:
        count = 0 if found.dataset is None else len(found.dataset.insertions)
        sound = f"No faults: {count} insertion{'' if count == 1 else 's'} in {path}."
        unsound = f"{len(faults)} fault{'' if len(faults) == 1 else 's'} in {path}:"
        screen.print_text(unsound if faults or found.dataset is None else sound)
        for fault in faults:
            error = DataError(fault.what, where=fault.where, expected=fault.expected, fix=fault.fix)
            screen.print_line(str(error))
    screen.print_warnings(invocation, warnings, in_full=True)
    if found.dataset is not None and not faults and not invocation.json:
        _show(found.dataset, measured, holes)
    if faults:
        raise typer.Exit(DataError.exit_code)


def _show(dataset: "Dataset", measured: str, holes: str) -> None:
    """Print a row per medium and number of layers: insertions, specimens, depths and deflections."""
    import pandas as pd

    from needlefit.reporting.table import Table
    from needlefit.reporting.table_files import to_records

    names = ("medium", "layers", "specimen", "depth", "deflection")
    frame = pd.DataFrame([{name: getattr(one, name) for name in names} for one in dataset.insertions])
    rows = frame.groupby(["medium", "layers"], sort=False, as_index=False).agg(
        insertions=("depth", "size"),
        specimen_count=("specimen", "nunique"),
        **{f"{name}_{end}_mm": (name, end) for name in ("depth", "deflection") for end in ("min", "max")},
    )
    columns = ("medium", "layers", "insertions", "specimen_count", "depth_range_mm", "deflection_range_mm")
    table = Table("dataset", to_records(rows), columns, caption="Insertions.").lay_out()
    origin = "SYNTHETIC data" if dataset.origin == "synthetic" else "Measured data"
    screen.print_line()
    screen.print_text(f"{origin}: {dataset.title}")
    screen.show_display(table, notes=False)
    screen.print_text(f"Measurement: {measured}.")
    if holes:
        screen.print_text(f"Holes: {holes}.")


# ---- twin

TwinSeed = Annotated[int | None, option("Seed (default: the shipped twin's).", min=0)]


def twin_build(
    context: typer.Context,
    seed: TwinSeed = None,
    population: Annotated[
        bool, option("Draw moduli, bevel offsets and friction as `calibrate --truth synthetic` does.")
    ] = False,
    out: Annotated[Path, option("Folder of the dataset.", "DIR")] = Path("data/twin"),
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    insecure: Insecure = False,
    quiet: Quiet = False,
) -> None:
    """Build the synthetic dataset.

    It has as many insertions as the paper, 47, to the same depths. Each is simulated, rendered as a CT volume
    and reconstructed from it. The same seed gives the same bytes.

    DIR is replaced if it holds nothing but a synthetic dataset.
    """
    from needlefit.project.folders import replace_folder
    from needlefit.synthetic.build import build_dataset
    from needlefit.synthetic.design import POPULATION
    from needlefit.synthetic.insertion import TWIN_SEED

    seed, invocation = TWIN_SEED if seed is None else seed, context.find_root().obj
    with (
        replace_folder(out) as fresh,
        show_progress(invocation.quiet) as report,
        open_pool(invocation.jobs, invocation.scheduler, invocation.insecure) as pool,
    ):
        drawn = POPULATION if population else None
        build_dataset(fresh, seed, pool=pool, progress=report, population=drawn)
    screen.print_line(f"{out}: synthetic dataset, seed {seed}")


def twin_ct(
    context: typer.Context,
    ids: Annotated[list[str] | None, argument("ID", "Insertions, or `sample` (default: all 47).")] = None,
    seed: TwinSeed = None,
    form: Annotated[Literal["nrrd", "dicom"], option("A file, or a series.", None, "--format")] = "nrrd",
    out: Annotated[Path, option("Folder of the scans.", "DIR")] = Path("twin_ct"),
    jobs: Jobs = None,
    quiet: Quiet = False,
) -> None:
    """Render insertions of the synthetic dataset as CT volumes.

    Writes volumes/ (20 MB each), markers/, layers/ and scans.csv, the input of `needlefit reconstruct`. The
    same seed gives the same bytes.

    DIR is replaced if it holds nothing but such scans.
    """
    from needlefit.project.folders import replace_folder
    from needlefit.project.tasks import LocalPool
    from needlefit.synthetic.design import select_planned_insertions
    from needlefit.synthetic.insertion import TWIN_SEED
    from needlefit.synthetic.scans import write_scans

    seed, plan = TWIN_SEED if seed is None else seed, select_planned_insertions(ids or ())
    with replace_folder(out) as fresh, show_progress(context.find_root().obj.quiet) as report:
        write_scans(fresh, plan, seed, form, LocalPool(jobs or count_cores()), report)
    screen.print_line(f"{out}: {len(plan)} synthetic scan{'s' * (len(plan) > 1)}, seed {seed}")
