"""Commands that make and check data: new, import, check."""

import math
import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import show_next_steps
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import argument, option, split_pair
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import PROJECT_FOLDERS, format_path, shipped_folder
from needlefit.project.result_warnings import WARNINGS_KEY, ResultWarning, to_rows
from needlefit.schemas.origin import ORIGIN_MARKS

if TYPE_CHECKING:
    from needlefit.datasets.importing.prepare import PreparedImport
    from needlefit.datasets.importing.stated import Question


def new_project(
    folder: Annotated[Path, argument("DIR", "A new or empty folder.")],
) -> None:
    """Write an editable copy of the project to DIR.

    That is data/, configs/ and studies/; in DIR the program then uses those.
    """
    from needlefit.project.folders import replace_folder

    ignored = shutil.ignore_patterns(".*", "__pycache__", "*.partial")
    with replace_folder(folder, is_result=False) as fresh:
        for part in PROJECT_FOLDERS:
            shutil.copytree(shipped_folder() / part, fresh / part, ignore=ignored)
    screen.print_written(folder)
    enter = "" if folder == Path() else f"{shlex.join(('cd', str(folder)))} && "
    screen.print_note(f"edit them, then: {enter}needlefit validate study3")


def new_workbook(
    file: Annotated[Path, argument("FILE", "A workbook (.xlsx) that does not exist yet.")],
) -> None:
    """Write a workbook to fill in with your needles, beside filled examples.

    `needlefit import` reads it; while it is not filled in, the examples.
    """
    from needlefit.datasets.importing.prepare import WORKBOOK_FILE
    from needlefit.project.folders import replace_file

    if file.suffix.lower() != ".xlsx" or file.exists():
        problem = "exists already" if file.exists() else f"has the ending {file.suffix!r}"
        raise ConfigError(problem, expected="a new .xlsx", fix="choose another name", where=file)
    with replace_file(file) as fresh:
        shutil.copyfile(WORKBOOK_FILE, fresh)
    screen.print_line(str(file))
    path = format_path(file)
    screen.print_note(f"fill it in, then: {shlex.join(('needlefit', 'import', path, '--out', file.stem))}")


# ---- import


def import_data(
    context: typer.Context,
    files: Annotated[
        list[Path],
        argument(
            "FILE_OR_FOLDER",
            "Tables (.csv .tsv .txt .xlsx .xls .ods), .mat, .h5, .npz, .npy, RT structure sets (.dcm), "
            "Slicer markups (.mrk.json .fcsv), surfaces (.stl .ply .obj).",
        ),
    ],
    out: options.Out = None,
    mapping: Annotated[
        Path | None, option("Read the files by this mapping.toml, of an earlier import.", "FILE")
    ] = None,
    set_: Annotated[
        list[str] | None,
        option(
            "State a key of the mapping: pose=1,0,0; unit=cm. May be repeated (needlefit explain mapping).",
            "KEY=VALUE",
            "--set",
        ),
    ] = None,
    yes: Annotated[bool, option("Ask nothing: take what is proposed, or stop.", None, "--yes")] = False,
    overwrite: Annotated[
        bool, option("Replace OUT, if it is an earlier import.", None, "--overwrite")
    ] = False,
) -> None:
    """Make a dataset from files of other programs.

    It proposes what each column means, in a mapping, and reads only by that: OUT/mapping.toml. In a terminal
    it asks for what is open and shows the mapping, to be changed or taken; --yes takes what is proposed. OUT
    also gets a picture, a first study and a scene. The default is ./FILE-dataset.
    """
    from needlefit.datasets.importing.prepare import UnreadError, prepare_import
    from needlefit.datasets.importing.writing import write_mapping
    from needlefit.project.folders import (
        replace_file,
        require_new,
        require_no_inputs_within,
        require_replaceable,
    )
    from needlefit.reporting.dataset_import import (
        PICTURE_FILE,
        explain_unclear,
        find_not_imported,
        tabulate_needles,
        write_import,
    )
    from needlefit.schemas.names import require_file_name

    out = out or Path(f"{files[0].resolve().name.partition('.')[0]}-dataset")
    if overwrite:
        require_replaceable(out, find_not_imported)
    else:
        require_new(out)
    require_file_name(out.resolve().name, str(out))
    require_no_inputs_within(out, files)
    invocation = context.find_root().obj
    asks = not yes and not invocation.json and sys.stdin.isatty() and sys.stderr.isatty()
    assignments = [split_pair(text) for text in set_ or []]
    prompt, review = (_ask, _review) if asks else (None, None)
    try:
        prepared = prepare_import(files, assignments, mapping, prompt, review)
    except UnreadError as error:
        draft = out.resolve().with_name(f"{out.resolve().name}_mapping.toml")
        if draft.exists():  # it may have been corrected
            raise error.error from None
        with replace_file(draft) as fresh:
            write_mapping(fresh, error.mapping)
        name = shlex.quote(format_path(draft))
        raise error.error.replace(fix=f"{error.fix}; or correct {name}, and add --mapping {name}") from None
    dataset = write_import(out, prepared, overwrite)
    needles = tabulate_needles(dataset)
    if invocation.json:
        rows, record = needles.to_dict(orient="records"), prepared.mapping.model_dump(mode="json")
        shown = {"dataset": str(out / "dataset.toml"), "origin": dataset.origin}
        screen.show_json(shown | {"insertions": rows, "mapping": record})
    else:
        count, assumed = len(dataset.insertions), len(prepared.mapping.assumed)
        imported = f"{count} insertion{'s' * (count > 1)} imported; "
        holes = Counter(insertion.hole or insertion.id for insertion in dataset.insertions)
        if len(holes) < count:  # several depths of one needle
            sizes = {*holes.values()}
            depths = f"{count} depths" if len(sizes) > 1 else f"{sizes.pop()} depths each"
            imported = f"{len(holes)} needle{'s' * (len(holes) > 1)}, {depths}, imported; "
        imported += f"{assumed} value{'s are assumptions' if assumed != 1 else ' is an assumption'}"
        marked = f"{mark}. " if (mark := ORIGIN_MARKS[dataset.origin]) else ""
        screen.print_line(f"{marked}{out}: {imported}\n")
        screen.show_frame(needles, "Needles")
        if unclear := explain_unclear(dataset):
            screen.print_text(unclear)
        _show_mapping(prepared)
    screen.print_warnings(invocation, dataset.warnings)
    path = format_path(out)
    look = f"look at {out / PICTURE_FILE}, " if (out / PICTURE_FILE).is_file() else ""
    screen.print_note(f"{look}then: {shlex.join(('needlefit', 'check', path))}")
    show_next_steps(dataset, out)


def _show_mapping(prepared: "PreparedImport") -> None:
    from needlefit.reporting.dataset_import import join_unused, tabulate_columns, tabulate_values

    screen.show_frame(tabulate_columns(prepared), "Columns")
    screen.show_frame(tabulate_values(prepared), "Values of all needles")
    screen.print_text(join_unused(prepared.unused))


def _review(prepared: "PreparedImport", problem: str) -> str:
    """Show what each column means and what is assumed; return a change, or an empty text."""
    if problem:
        screen.print_note(problem)
    _show_mapping(prepared)
    answer: str = typer.prompt(
        "Enter if this is right; else KEY=VALUE, as unit=cm, pose=1,0,0 or y.column=HEADER",
        default="",
        show_default=False,
        err=True,
    )
    return answer


def _ask(question: "Question", problem: str) -> str:
    """Ask on the terminal; an answer is a number of the list, if there is one."""
    answers = [f"{n}: {answer}" for n, answer in enumerate(question.choices, 1)]
    screen.print_note("\n".join(filter(None, (problem, question.text, *answers))))
    answer: str = typer.prompt(question.key or "answer", err=True)
    return answer


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
) -> None:
    """Check a dataset or study: list faults, fixes and warnings.

    For a dataset it checks files, ids, units, centrelines, surfaces, bevel sides and checksums; for a study
    its keys and all files that it names, and by a quick fit whether the needles predict each other: those
    that they do not are drawn to NAME_odd_needles.pdf. Every fit makes the same checks. Exit code 3: there is
    a fault; with --strict, 5: there is a warning.
    """
    from needlefit.project.locate import find_dataset_or_study
    from needlefit.project.processes import leave_out_help_texts

    leave_out_help_texts()
    kind, path = find_dataset_or_study(name)
    invocation = context.find_root().obj
    if kind == "dataset":
        _check_dataset(invocation, path)
    else:
        _check_study(invocation, kind, name, path)


def _judge(warnings: Sequence[ResultWarning]) -> str:
    count = len(warnings)
    return f"No faults, {count} warning{'s' * (count > 1)}" if count else "No faults"


def _check_study(invocation: Invocation, kind: Literal["study", "fit"], name: str, path: Path) -> None:
    from needlefit.project.locate import file_label
    from needlefit.studies.load import check_study_file

    faults = check_study_file(kind, path)
    if invocation.json:
        folds = [{"tune": tune, "validate": held_out} for tune, held_out in faults.folds]
        rows = to_rows(faults.warnings)
        screen.show_json(
            {"study": str(path), "ok": True, "kind": faults.kind, "folds": folds, WARNINGS_KEY: rows}
        )
    else:
        sizes = [f"{tune} fitted, {held_out} held out" for tune, held_out in dict.fromkeys(faults.folds)]
        folds_text = f": {'; '.join(sizes)}; {len(faults.folds)} folds" if sizes else ""
        screen.print_text(f"{_judge(faults.warnings)}: {file_label(path)}, {faults.kind}{folds_text}.")
    screen.print_warnings(invocation, faults.warnings)
    if not invocation.json:
        if faults.doubts.odd_needles:
            from needlefit.studies.fit_figures import draw_odd_needles

            picture = draw_odd_needles(faults.doubts.odd_needles)
            screen.print_note(f"written: {picture.save(Path(f'{path.stem}_odd_needles.pdf'), faults.origin)}")
        if faults.doubts.unjudged:
            from needlefit.studies.first_page import CHECKS

            screen.print_note(CHECKS.sentence("unjudged", faults.doubts._asdict()))
        command = "tune" if kind == "fit" else "validate"
        screen.print_note(f"next: {shlex.join(('needlefit', command, name))}")


FAULT_PARTS = ("where", "what", "expected", "fix")  # keys of a fault in JSON


def _check_dataset(invocation: Invocation, path: Path) -> None:
    from needlefit.datasets.faults import merge_like
    from needlefit.datasets.needles import describe_needles, summarize_needles
    from needlefit.datasets.planes import measure_out_of_plane
    from needlefit.datasets.read import inspect
    from needlefit.datasets.sections import describe_measurement
    from needlefit.datasets.select import find_hole_source, name_holes

    inspection = inspect(path)
    faults, dataset, planes, measured, holes = inspection.faults, inspection.dataset, [], "", dict[str, str]()
    needles = {} if dataset is None else summarize_needles(dataset)
    if dataset is not None:
        planes, measured = measure_out_of_plane(dataset), describe_measurement(dataset)
        holes = name_holes(dataset)
    if invocation.json:
        screen.show_json(
            {
                "dataset": str(path),
                "ok": not faults,
                "measurement": measured,
                "needles": {name: needle.model_dump() for name, needle in needles.items()},
                "holes": holes,
                "out_of_plane": [{"id": name, "tip_mm": mm, "tip_sds": sds} for name, mm, sds in planes],
                "faults": [{key: getattr(fault, key) for key in FAULT_PARTS} for fault in faults],
                WARNINGS_KEY: to_rows(inspection.warnings),
            }
        )
    else:
        count = len(faults) if dataset is None else len(dataset.insertions)
        counted = f"{count} {'fault' if dataset is None else 'insertion'}{'s' * (count != 1)} in {path}"
        screen.print_text(f"{counted}:" if dataset is None else f"{_judge(inspection.warnings)}: {counted}.")
        for fault in merge_like(faults):
            screen.print_line(str(fault))
    screen.print_warnings(invocation, inspection.warnings, in_full=True)
    if dataset is not None and not invocation.json:
        origin = ORIGIN_MARKS[dataset.origin] or "Measured data"
        screen.print_text(f"{origin}: {dataset.title}. Measurement: {measured}.")
        screen.print_text(describe_needles(needles))
        table = dataset.to_frame().assign(hole=list(holes.values()))
        table["holes by"] = [find_hole_source(dataset, medium) for medium in table["medium"]]
        groups = table.groupby(["medium", "layers", "holes by"], sort=False)
        shown = groups["insertion"].size().to_frame("insertions").assign(holes=groups["hole"].nunique())
        for column, label in (("depth_mm", "depth, mm"), ("deflection_mm", "tip deflection, mm")):
            ends = groups[column].agg(["min", "max"]).map("{:.2f}".format).to_numpy()
            shown[label] = [" to ".join(dict.fromkeys(pair)) for pair in ends]
        screen.show_frame(shown.reset_index(), "")
        if planes:
            _, off_mm, sds = max(planes, key=lambda plane: plane[1])
            ratio = "" if math.isnan(sds) else f" ({sds:.1f} SD)"
            screen.print_text(f"Out of the planes of their bevels: at most {off_mm:.2f} mm{ratio}.")
    if faults:
        raise typer.Exit(DataError.exit_code)
