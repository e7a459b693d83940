"""`needlefit reconstruct`: scans of inserted needles -> a checked dataset."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from needlefit.cli import failure, options, screen
from needlefit.cli.completion import reconstructions
from needlefit.cli.completion import scans as complete_scans
from needlefit.cli.execution import cores, remark
from needlefit.cli.interruption import stopping
from needlefit.cli.progress import progress
from needlefit.cli.warn import warn
from needlefit.errors import DataError
from needlefit.project.reading import is_there
from needlefit.project.result_warnings import KEY, as_rows

if TYPE_CHECKING:
    from needlefit.imaging.batch import Failure
    from needlefit.imaging.reconstruction import Reconstruction
    from needlefit.imaging.scan import Scan
    from needlefit.project.result_warnings import ResultWarning

MOST_JOBS = 2
"""Scans at once unless somebody wants more: each takes several times the memory of its volume."""

EACH_ITS_OWN = "each file"
"""In the stamp of the checkpoint: each reconstruction in it has a stamp of what decided it."""


def reconstruct(
    context: typer.Context,
    scans: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCAN...",
            autocompletion=complete_scans,
            help="DICOM folders, NRRD, NIfTI; or a table, a row a scan: scans.csv, or its bare name.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DATASET", help="Folder of the dataset.")],
    markers: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Known places of the markers in the world: .csv, .fcsv, .mrk.json."
        ),
    ] = None,
    fiducials: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The markers as placed in the scan by hand (.fcsv, .mrk.json)."),
    ] = None,
    layers: Annotated[
        list[str] | None,
        typer.Option(metavar="FILES...", help="STL, PLY or OBJ, from the entry inwards; or a segmentation."),
    ] = None,
    layers_in: Annotated[
        Literal["world", "scan"] | None, typer.Option(help="Frame of the surfaces (default: world).")
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The needle's voxels, segmented elsewhere.")
    ] = None,
    series: Annotated[
        str | None,
        typer.Option(metavar="NUMBER|UID", help="Which DICOM series, where a folder holds several."),
    ] = None,
    medium: Annotated[str | None, typer.Option(help="Name of what was punctured (default: medium).")] = None,
    recipe: Annotated[
        str,
        typer.Option(
            metavar="RECIPE", autocompletion=reconstructions, help="configs/reconstruction, or a path."
        ),
    ] = "default",
    title: Annotated[str, typer.Option(help="Title of the dataset.")] = "",
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Scans at once (default: 2); changes no result.")
    ] = None,
    resume: options.Resume = False,
    strict: options.Strict = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Reconstruct the needles in SCANs into a dataset.

    Needle, markers and tissue are found in each scan; its markers lay it on the world. DATASET takes the
    dataset, tables of what was found, and for every scan a quality page (quality/) and files for 3D Slicer
    (slicer/). A scan that fails is named, with what would mend it (exit code 3), and the others are written.
    """
    named = {
        "markers": markers,
        "fiducials": fiducials,
        "layers": layers,
        "surfaces_in": layers_in,
        "mask": mask,
        "series": series,
        "medium": medium,
    }
    invocation = context.find_root().obj
    with stopping() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.imaging.assemble import About
        from needlefit.imaging.batch import Batch, Failure, reconstruct_all
        from needlefit.project.load import load
        from needlefit.project.names import require_file_name
        from needlefit.project.outputs import require_no_inputs_within
        from needlefit.project.ownership import require_own_checkpoint, require_replaceable
        from needlefit.project.partial import claim, forget
        from needlefit.project.places import find
        from needlefit.project.records.reconstruction import ReconstructionRecord
        from needlefit.reporting.reconstructed import write_reconstructed

        require_file_name(out.resolve().name, str(out))
        require_replaceable(out)
        keep = out.resolve().with_name(f"{out.resolve().name}.partial")
        require_own_checkpoint(keep)
        wanted = _scans(scans, {name: value for name, value in named.items() if value not in (None, [])})
        require_no_inputs_within(out, [*scans, *(path for one in wanted for path in one.files)])
        record = load(find("reconstruction", recipe), ReconstructionRecord)
        lock = claim(keep, EACH_ITS_OWN, resume, remark)
        with progress(invocation.quiet) as report:
            found = reconstruct_all(
                wanted, record, Batch(jobs or min(MOST_JOBS, cores()), keep, resume, report, stop, remark)
            )
            if len(found) < len(wanted):
                screen.note(f"needlefit: interrupted; to go on: {invocation.resuming()}")
                raise typer.Exit(failure.INTERRUPTED)
            failed = [one for one in found if isinstance(one, Failure)]
            ones = [one for one in found if not isinstance(one, Failure)]
            if ones:
                about = About(out.resolve().name, title)
                kept, faulty = write_reconstructed(out, ones, record, about, report)
                ones, failed = list(kept), [*failed, *faulty]
    warnings = warnings_in(out) if ones else []
    _show(out, ones, failed, warnings if json else None)
    warn(invocation, warnings)
    if failed and ones:
        screen.note(f"needlefit: what is finished is kept in {keep}; to go on: {invocation.resuming()}")
    else:
        forget(keep, remark)
    if lock is not None:
        lock.release()
    if failed:
        raise typer.Exit(DataError.exit_code)


def _scans(scans: list[Path], named: dict[str, Any]) -> "tuple[Scan, ...]":
    """Return the scans that the arguments mean: the rows of a table, or volumes that share what is named."""
    from needlefit.imaging.scans import read_scans, scans_of
    from needlefit.project.places import find, names

    if len(scans) == 1 and not is_there(scans[0]) and str(scans[0]) in names("scans"):
        scans = [find("scans", str(scans[0]))]
    if not any(path.suffix.lower() == ".csv" for path in scans):
        return scans_of(scans, **named)
    if len(scans) > 1 or named:
        raise typer.BadParameter(
            "a table of scans stands alone: markers, fiducials, layers, masks, series, media are its columns"
        )
    return read_scans(scans[0])


def warnings_in(dataset: Path) -> "list[ResultWarning]":
    """Return the warnings about the dataset that was written."""
    from needlefit.datasets.check import check_all

    return check_all(dataset)[1]


def _show(
    out: Path,
    ones: "Sequence[Reconstruction]",
    failed: "Sequence[Failure]",
    as_json: "list[ResultWarning] | None",
) -> None:
    """Print what was found; with the warnings of the dataset, as JSON."""
    from needlefit.reporting.reconstructions import reconstruction_table, reconstructions_layout

    if as_json is not None:
        rows = reconstruction_table(ones).to_dict(orient="records") if ones else []
        errors = [
            {"id": one.scan.id, "scan": str(one.scan.volume), "error": str(one.error)} for one in failed
        ]
        about = {"dataset": str(out) if ones else None, KEY: as_rows(as_json)}
        screen.show_json({**about, "scans": rows, "failed": errors})
    elif ones:
        screen.show_display(reconstructions_layout(ones))
        screen.say(f"written: {out}/")
    for one in failed:
        screen.note(f"needlefit: {_told(one)}")
    if failed and len(ones):
        screen.note(
            f"needlefit: {len(failed)} of {len(failed) + len(ones)} scans failed; the others are written"
        )


def _told(failure: "Failure") -> str:
    """Return the error of a scan, behind its id unless the error begins with the volume of that name."""
    from needlefit.imaging.scans import id_of

    error, scan = failure.error, failure.scan
    named = error.where == str(scan.volume) and id_of(scan.volume) == scan.id
    return str(error) if named else f"{scan.id}: {error}"
