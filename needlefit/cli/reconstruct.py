"""`needlefit reconstruct`: scans of inserted needles -> a checked dataset."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import (
    begin,
    open_pool,
    print_remark,
    show_advice,
    show_next_steps,
    show_progress,
)
from needlefit.cli.options import argument, option
from needlefit.cli.screen import print_warnings
from needlefit.errors import DataError
from needlefit.project.input_files import path_exists
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import WARNINGS_KEY, to_rows
from needlefit.schemas.scan_files import NO_FILES, ScanFiles, SurfaceFrame

if TYPE_CHECKING:
    from needlefit.cli.exit_codes import Invocation
    from needlefit.imaging.batch import ReconstructionFailure
    from needlefit.imaging.scans import Scan
    from needlefit.project.result_warnings import ResultWarning
    from needlefit.studies.run import Run


MAX_DEFAULT_JOBS = 2
"""Largest number of scans at once, unless stated: each takes several times the memory of its volume."""


def reconstruct(
    context: typer.Context,
    scans: Annotated[
        list[Path],
        argument(
            "SCAN",
            "DICOM folders, NRRD, NIfTI; or a table, a row a scan: scans.csv, or its bare name.",
        ),
    ],
    out: options.Out = None,
    markers: Annotated[
        Path | None, option("Known places of the markers in the world: .csv, .fcsv, .mrk.json.", "FILE")
    ] = None,
    fiducials: Annotated[
        Path | None, option("The markers as placed in the scan by hand (.fcsv, .mrk.json).", "FILE")
    ] = None,
    layers: Annotated[
        list[str] | None,
        option("STL, PLY, OBJ from the entry inwards, each with --layers; or a segmentation.", "FILE"),
    ] = None,
    layers_in: Annotated[SurfaceFrame, option("Frame of the surfaces.")] = NO_FILES.layers_in,
    mask: Annotated[Path | None, option("The needle's voxels, segmented elsewhere.", "FILE")] = None,
    series: Annotated[
        str | None, option("Which DICOM series, where a folder holds several.", "NUMBER|UID")
    ] = None,
    medium: Annotated[str, option("Name of what was punctured.")] = NO_FILES.medium,
    every: Annotated[
        bool,
        option(
            "Every needle of a scan is an insertion: ID-1, ID-2, ... to the left.",
            None,
            "--all",
        ),
    ] = False,
    recipe: Annotated[
        str,
        option("configs/reconstruction, or a path.", "RECIPE"),
    ] = "default",
    corrections: Annotated[
        list[Path] | None,
        option(
            "Control points moved in 3D Slicer: SCAN's slicer/ID.corrections.mrk.json. May be repeated.",
            "FILE",
        ),
    ] = None,
    confirm: Annotated[
        list[str] | None,
        option(
            "Number of the right answer, after a refusal that asks for the entry: entry=1; of several scans "
            "or needles with the ID of one. May be repeated.",
            "[ID:]entry=NUMBER",
        ),
    ] = None,
    title: Annotated[str, option("Title of the dataset.")] = "",
) -> None:
    """Reconstruct the needles in SCANs into a dataset.

    Finds needle, markers and tissue in each scan, and registers it to world coordinates with its markers.
    OUT, by default ./SCAN-dataset, takes the dataset, its tables, and for every scan a quality page
    (quality/) and files for 3D Slicer (slicer/). A scan that fails is reported with its fix (exit code 3);
    the others are written. Ctrl-C keeps finished scans and prints the command that continues.
    """
    invocation = context.find_root().obj
    with begin(context) as execution:
        from needlefit.datasets.read import inspect
        from needlefit.imaging.assembly import DatasetDescription
        from needlefit.imaging.batch import ReconstructionFailure, reconstruct_all
        from needlefit.imaging.corrections import correct_scans
        from needlefit.imaging.scans import scan_id
        from needlefit.project.checkpoint import (
            open_checkpoint,
            release_checkpoint,
            remove_checkpoint,
            require_own_checkpoint,
        )
        from needlefit.project.folders import remove_result, require_no_inputs_within, require_replaceable
        from needlefit.project.input_files import digest_values
        from needlefit.project.locate import find_file
        from needlefit.project.toml import load
        from needlefit.schemas.names import require_file_name
        from needlefit.schemas.reconstruction import ReconstructionRecord
        from needlefit.studies.kinds.reconstruction.report import (
            describe_work,
            write_reconstruction,
            write_refused,
        )
        from needlefit.studies.run import name_source, require_same_sources

        moved = corrections or []
        files = ScanFiles(
            markers=markers,
            fiducials=fiducials,
            layers=tuple(layers or ()),
            layers_in=layers_in,
            mask=mask,
            series=series,
            medium=medium,
        )
        wanted = correct_scans(_take_answers(_scans(scans, files), confirm or (), every), moved, every)
        named_by = scan_id(scans[0]) if len(wanted) == 1 or scans[0].suffix == ".csv" else "scans"
        out = out or Path(f"{named_by}-dataset")
        place = out.resolve()
        require_file_name(place.name, str(out))
        refused = place.with_name(f"{place.name}.refused")  # scans without a dataset
        partial = place.with_name(f"{place.name}.partial")
        for folder in (out, refused):
            require_replaceable(folder)
        require_own_checkpoint(partial)
        # the first names the folder; what is no path is a name
        sources = [name_source(scans[0]) if scans[0].exists() else str(scans[0])]
        require_same_sources(out, sources)
        require_no_inputs_within(out, [*scans, *moved, *(path for scan in wanted for path in scan.files)])
        record = load(find_file("reconstruction", recipe), ReconstructionRecord)

        def name_work(scan: "Scan") -> str:
            return digest_values(describe_work(scan, record, every))

        # a result is found by all that decides it: another answer, or another scan, leaves the rest
        checkpoint = open_checkpoint(partial, True, {"kind": "reconstruction"}, print_remark)
        with show_progress(invocation.quiet) as report:
            with open_pool(invocation, MAX_DEFAULT_JOBS) as pool:
                scanned = reconstruct_all(
                    wanted,
                    record,
                    every,
                    pool=pool,
                    progress=report,
                    stop=execution.stop,
                    checkpoint=checkpoint,
                    name_work=name_work,
                )
            if len(scanned) < len(wanted):
                raise execution.interrupted()
            results = [result for needles in scanned for result in needles]
            failed = [result for result in results if isinstance(result, ReconstructionFailure)]
            ones = [result for result in results if not isinstance(result, ReconstructionFailure)]
            written = None
            if ones:
                about = DatasetDescription(place.name, title)
                written, faulty = write_reconstruction(
                    out, ones, record, about, report, refused=failed, sources=sources
                )
                failed += faulty
            if failed and not written:
                write_refused(failed, refused)
            else:  # those of an earlier run would be taken for this one's
                remove_result(refused, print_remark)
            if failed and written:  # the next run, with an answer or a correction, goes on from there
                release_checkpoint(partial)
            else:
                remove_checkpoint(partial, print_remark)
    inspected = inspect(out) if written else None
    warnings = inspected.warnings if inspected else ()
    if written and not invocation.json:
        screen.print_text(f"{written.verdicts[0].sentence}.")
    _print_failures(invocation, written, failed, out if written else refused)
    print_warnings(invocation, warnings)
    invocation.warned |= any(needle.warnings for needle in ones)
    _show(out, written, failed, warnings if invocation.json else None)
    if inspected and inspected.dataset and not invocation.json:
        show_next_steps(inspected.dataset, out)
    if failed:
        raise typer.Exit(DataError.exit_code)


def _take_answers(scans: "Sequence[Scan]", confirmed: Sequence[str], every: bool) -> "list[Scan]":
    """Return scans with the answers about their entries; BadParameter unless each scan has one at most.

    `every`: whether each needle of a scan, `ID-1`, ..., is asked about.
    """
    from needlefit.imaging.scans import find_owner

    answers: dict[str, dict[str, int]] = {scan.id: {} for scan in scans}
    for text in confirmed:
        answer = re.fullmatch(r"(?:(.*):)?entry=(.*)", text)
        id_ = "" if answer is None else answer[1] or (scans[0].id if len(scans) == 1 else "")
        owner = find_owner(id_, answers, every)
        if answer is None or owner not in answers:
            problem = "names no answer of a scan"
        elif not re.fullmatch(r"[1-9]\d{0,3}", answer[2]):
            problem = f"`{answer[2]}` is not the number of an answer (1, 2, ...)"
        elif id_ in answers[owner]:
            problem = f"is a second answer for {id_}"
        else:
            answers[owner][id_] = int(answer[2])
            continue
        usual = name_answer(scans[0], len(scans))
        raise typer.BadParameter(
            f"{text}: {problem}; give one number for each scan: --confirm {usual}", param_hint="--confirm"
        )
    return [replace(scan, answers=answers[scan.id]) for scan in scans]


def name_answer(scan: "Scan", count: int) -> str:
    """Return what states answer 1 of a scan, or of a needle of one, of so many."""
    return "entry=1" if count == 1 else f"{scan.id}:entry=1"


def _repeat_with_answer(invocation: "Invocation", scan: "Scan", count: int) -> str:
    """Return the command line with answer 1 of a scan, one of so many, in place of any other answer of it."""
    wrong = rf"((?:--confirm=)?(?:{re.escape(scan.id)}:)?entry=)\d+"
    words = tuple(re.sub(f"^{wrong}$", r"\g<1>1", word) for word in invocation.words)
    more = () if scan.id in scan.answers else ("--confirm", name_answer(scan, count))
    return replace(invocation, words=words).repeat(*more)


def _scans(scans: list[Path], files: ScanFiles) -> "tuple[Scan, ...]":
    """Return the scans that the arguments mean: the rows of a table, or volumes that share what is named."""
    from needlefit.imaging.scans import make_scans, read_scans
    from needlefit.project.locate import find_file, list_names

    if len(scans) == 1 and not path_exists(scans[0]) and str(scans[0]) in list_names("scans"):
        scans = [find_file("scans", str(scans[0]))]
    if len(scans) == 1 and path_exists(table := scans[0] / "scans.csv"):
        scans = [table]
    if not any(path.suffix.lower() == ".csv" for path in scans):
        return make_scans(scans, files)
    if len(scans) > 1 or files != NO_FILES:
        raise typer.BadParameter("a table of scans stands alone: markers, layers, ... are its columns")
    return read_scans(scans[0])


def _show(
    out: Path,
    run: "Run | None",
    failed: "Sequence[ReconstructionFailure]",
    as_json: "Sequence[ResultWarning] | None",
) -> None:
    """Print what was found; with the warnings of the dataset, as JSON."""
    from needlefit.studies.kinds.reconstruction.report import REPORT

    if as_json is not None:
        rows = run.frames["reconstruction"].to_dict(orient="records") if run else []
        errors = [
            {"id": failure.scan.id, "scan": str(failure.scan.volume), "error": str(failure.error)}
            for failure in failed
        ]
        about: dict[str, Any] = {"dataset": str(out) if run else None, WARNINGS_KEY: to_rows(as_json)}
        screen.show_json({**about, "scans": rows, "failed": errors})
    elif run:
        screen.print_line()
        for table in run.first_page.tables:
            screen.show_display(table, notes=False)
        for remark in REPORT.summarize(run)[1:]:
            screen.print_text(remark)
        pictures = join_names([str(path) for path in sorted(out.glob("quality/*.pdf"))], 2)
        screen.print_written(out, f" (pictures: {pictures})")
        if (advice := run.first_page.advice) is not None:
            show_advice(advice, out.parent)


def _print_failures(
    invocation: "Invocation", run: "Run | None", failed: "Sequence[ReconstructionFailure]", out: Path
) -> None:
    """Print the error of each scan, and what to do about it."""
    from needlefit.imaging.entry import UncertainEntryError
    from needlefit.imaging.scans import scan_id

    count = len(failed) + (len(run.frames["reconstruction"]) if run else 0)
    for error in dict.fromkeys(
        failure.error for failure in failed
    ):  # one of the whole dataset is one of every scan
        ones = [failure for failure in failed if failure.error is error]
        ids, scan = join_names([failure.scan.id for failure in ones]), ones[0].scan
        named = error.where == str(scan.volume) and scan_id(scan.volume) == scan.id == ids
        screen.print_note(f"needlefit: {error if named else f'{ids}: {error}'}")
        for warning in ones[0].warnings:
            screen.print_note(f"needlefit: {ids}: {warning}")
    if any(failure.points for failure in failed):
        seen = f"needlefit: what was found is drawn in {out}/quality/"
        screen.print_note(f"{seen}; move it in 3D Slicer: {out}/slicer/, then --corrections")
    if asked := [failure.scan for failure in failed if isinstance(failure.error, UncertainEntryError)]:
        command = _repeat_with_answer(invocation, asked[0], count)
        screen.print_note(f"needlefit: with the number of the right answer: {command}")
    if failed and not run:
        screen.print_note(f"needlefit: no needle was reconstructed; the reasons: {out}/refused.csv")
    elif failed and run:
        screen.print_note(
            f"needlefit: {len(failed)} of {count} needles failed; the others are written, and kept in "
            f"{out}.partial for the next run"
        )
