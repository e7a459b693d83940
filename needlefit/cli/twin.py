"""Commands that make the synthetic dataset: twin build, twin ct."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from needlefit.cli import screen
from needlefit.cli.execution import open_pool
from needlefit.cli.options import Insecure, Jobs, Out, Quiet, Scheduler, Seed, argument, option
from needlefit.cli.progress import show_progress


def build(
    context: typer.Context,
    seed: Seed = None,
    out: Out = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    insecure: Insecure = False,
    quiet: Quiet = False,
) -> None:
    """Build the synthetic dataset.

    It has as many insertions as the paper, 47, to the same depths. Each is simulated, rendered as a CT volume
    and reconstructed from it. The same seed gives the same bytes.

    OUT, by default data/twin, is replaced if it holds nothing but a synthetic dataset.
    """
    from needlefit.project.folders import replace_folder
    from needlefit.synthetic.build import build_dataset
    from needlefit.synthetic.insertion import TWIN_SEED

    seed, invocation = TWIN_SEED if seed is None else seed, context.find_root().obj
    out = out or Path("data/twin")
    with (
        replace_folder(out) as fresh,
        show_progress(invocation.quiet) as report,
        open_pool(invocation) as pool,
    ):
        build_dataset(fresh, seed, pool=pool, progress=report)
    screen.print_line(f"{out}: synthetic dataset, seed {seed}")


def render_ct(
    context: typer.Context,
    ids: Annotated[list[str] | None, argument("ID", "Insertions, or `sample` (default: all 47).")] = None,
    seed: Seed = None,
    form: Annotated[Literal["nrrd", "dicom"], option("A file, or a series.", None, "--format")] = "nrrd",
    out: Out = None,
    jobs: Jobs = None,
    quiet: Quiet = False,
) -> None:
    """Render insertions of the synthetic dataset as CT volumes.

    Writes volumes/ (20 MB each), markers/, layers/ and scans.csv, the input of `needlefit reconstruct`. The
    same seed gives the same bytes.

    OUT, by default twin_ct, is replaced if it holds nothing but such scans.
    """
    from needlefit.project.folders import replace_folder
    from needlefit.synthetic.design import select_designs
    from needlefit.synthetic.insertion import TWIN_SEED
    from needlefit.synthetic.scans import write_scans

    seed, plan = TWIN_SEED if seed is None else seed, select_designs(ids or ())
    out, asked = out or Path("twin_ct"), context.find_root().obj
    with replace_folder(out) as fresh, show_progress(asked.quiet) as report, open_pool(asked) as pool:
        write_scans(fresh, plan, seed, pool, report, form == "dicom")
    screen.print_line(f"{out}: {len(plan)} synthetic scan{'s' * (len(plan) > 1)}, seed {seed}")
