"""`needlefit twin build`: the synthetic dataset, made anew."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.progress import progress


def twin_build(
    context: typer.Context,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed (default: the shipped twin's).")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the dataset.")] = Path("data/twin"),
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Build the synthetic dataset.

    Its insertions have the numbers and depths of the paper's 47.

    The same seed gives the same bytes. DIR is replaced only if it holds a twin, and
    nothing else.
    """
    from needlefit.synthetic.build import SEED, build
    from needlefit.synthetic.replace import replacing_twin

    seed = SEED if seed is None else seed
    if not quiet:
        screen.note_compiling()
    with replacing_twin(out) as fresh, progress(context.find_root().obj.quiet) as report:
        build(fresh, seed, report)
    screen.say(f"{out}: synthetic dataset, seed {seed}")
