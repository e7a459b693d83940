"""`needlefit twin`: the synthetic dataset made anew, and its scans."""

from pathlib import Path
from typing import Literal

import typer

from needlefit.cli import screen
from needlefit.cli.execution import open_pool
from needlefit.cli.options import argument, option, takes
from needlefit.cli.progress import show_progress
from needlefit.project.processes import count_cores

_SEED = option("Seed (default: the shipped twin's).", min=0)
_JOBS = option("Processes (default: all cores); they do not change the result.", min=1)


@takes(
    "scheduler insecure quiet verbose", seed=_SEED, out=option("Folder of the dataset.", "DIR"), jobs=_JOBS
)
def twin_build(
    context: typer.Context, seed: int | None = None, out: Path = Path("data/twin"), jobs: int | None = None
) -> None:
    """Build the synthetic dataset.

    It has as many insertions as the paper, 47, to the same depths. Each is simulated, rendered as a CT volume
    and reconstructed from it. The same seed gives the same bytes.

    DIR is replaced if it holds nothing but a synthetic dataset.
    """
    from needlefit.project.folders import replace_folder
    from needlefit.synthetic.build import build_dataset
    from needlefit.synthetic.insertion import TWIN_SEED

    seed, invocation = TWIN_SEED if seed is None else seed, context.find_root().obj
    with (
        replace_folder(out) as fresh,
        show_progress(invocation.quiet) as report,
        open_pool(jobs, invocation.scheduler, invocation.insecure) as pool,
    ):
        build_dataset(fresh, seed, pool=pool, progress=report)
    screen.print_line(f"{out}: synthetic dataset, seed {seed}")


@takes(
    "quiet verbose",
    ids=argument("ID", "Insertions, or `sample` (default: all 47)."),
    seed=_SEED,
    form=option("A file, or a series.", None, "--format"),
    out=option("Folder of the scans.", "DIR"),
    jobs=_JOBS,
)
def twin_ct(
    context: typer.Context,
    ids: list[str] | None = None,
    seed: int | None = None,
    form: Literal["nrrd", "dicom"] = "nrrd",
    out: Path = Path("twin_ct"),
    jobs: int | None = None,
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
