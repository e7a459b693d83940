"""The command that makes a synthetic dataset: twin build."""

from pathlib import Path

from needlefit.cli import screen
from needlefit.cli.options import Out, Quiet, Seed


def build(seed: Seed = None, out: Out = None, quiet: Quiet = False) -> None:
    """Build a synthetic dataset.

    It has as many insertions as the paper, 47, to the same depths. Each is simulated, and read off with the
    errors that scans leave. The same seed gives the same bytes.

    OUT, by default synthetic, is replaced if it holds nothing but a synthetic dataset.
    """
    from needlefit.project.folders import replace_folder
    from needlefit.synthetic.build import build_dataset
    from needlefit.synthetic.insertion import TWIN_SEED

    seed, out = TWIN_SEED if seed is None else seed, out or Path("synthetic")
    with replace_folder(out) as fresh:
        build_dataset(fresh, seed)
    screen.print_line(f"{out}: synthetic dataset, seed {seed}")
