"""`needlefit twin`: the synthetic dataset made anew, and its scans."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import open_pool
from needlefit.cli.progress import show_progress
from needlefit.project.processes import count_cores

Jobs = Annotated[
    int | None, typer.Option(min=1, help="Processes (default: all cores); they do not change the result.")
]


def twin_build(
    context: typer.Context,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed (default: the shipped twin's).")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the dataset.")] = Path("data/twin"),
    jobs: Jobs = None,
    scheduler: options.Scheduler = None,
    insecure: options.Insecure = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Build the synthetic dataset.

    It has as many insertions as the paper, 47, to the same depths. Each is simulated, rendered as a CT volume
    and reconstructed from it. The same seed gives the same bytes.

    DIR is replaced if it holds nothing but a synthetic dataset.
    """
    from needlefit.project.atomic_write import replace_folder
    from needlefit.synthetic.build import build_dataset
    from needlefit.synthetic.insertion import TWIN_SEED

    seed = TWIN_SEED if seed is None else seed
    with (
        replace_folder(out) as fresh,
        show_progress(context.find_root().obj.quiet) as report,
        open_pool(jobs, scheduler, insecure) as pool,
    ):
        build_dataset(fresh, seed, pool=pool, progress=report)
    screen.print_line(f"{out}: synthetic dataset, seed {seed}")


def twin_ct(
    context: typer.Context,
    ids: Annotated[
        list[str] | None, typer.Argument(metavar="[ID]...", help="Insertions, or `sample` (default: all 47).")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed (default: the shipped twin's).")] = None,
    form: Annotated[Literal["nrrd", "dicom"], typer.Option("--format", help="A file, or a series.")] = "nrrd",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the scans.")] = Path("twin_ct"),
    jobs: Jobs = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Render insertions of the synthetic dataset as CT volumes.

    Writes volumes/ (20 MB each), markers/, layers/ and scans.csv, the input of `needlefit reconstruct`. The
    same seed gives the same bytes.

    DIR is replaced if it holds nothing but such scans.
    """
    from needlefit.project.atomic_write import replace_folder
    from needlefit.project.tasks import LocalPool
    from needlefit.synthetic.design import select_planned_insertions
    from needlefit.synthetic.insertion import TWIN_SEED
    from needlefit.synthetic.scans import write_scans

    seed, plan = TWIN_SEED if seed is None else seed, select_planned_insertions(ids or ())
    with replace_folder(out) as fresh, show_progress(context.find_root().obj.quiet) as report:
        write_scans(fresh, plan, seed, form, LocalPool(jobs or count_cores()), report)
    screen.print_line(f"{out}: {len(plan)} synthetic scan{'s' * (len(plan) > 1)}, seed {seed}")
