"""The whole twin: every planned insertion simulated, scanned and reconstructed; and apart the truth."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from needlefit.imaging.assemble import assemble
from needlefit.imaging.reconstruct import reconstruct
from needlefit.project.processes import in_order
from needlefit.project.records.reconstruction import ReconstructionRecord
from needlefit.project.threads import one_thread
from needlefit.project.watching import Progress, silent
from needlefit.synthetic.built import Built
from needlefit.synthetic.ct.setup import WHOLE
from needlefit.synthetic.design import Planned, insertions
from needlefit.synthetic.scans import recipe_of, render_insertion, write_layers
from needlefit.synthetic.statement import statement
from needlefit.synthetic.truth_file import write_truth
from needlefit.synthetic.twin import SEED


@one_thread
def build(
    folder: Path,
    seed: int = SEED,
    plan: Sequence[Planned] = insertions(),
    jobs: int = 1,
    progress: Progress = silent,
) -> Path:
    """Write the twin of `seed` into `folder`; return its `dataset.toml`. The same seed gives the same bytes.

    Parameters
    ----------
    plan : sequence of Planned
        The insertions; each comes out the same whatever the others are.
    jobs : int
        Processes; changes no byte.
    progress : callable
        Told what is being done, how many insertions are done, and of how many.
    """
    recipe, built = recipe_of([WHOLE]), list[Built]()
    with TemporaryDirectory() as scratch:
        write_layers(Path(scratch), plan)
        progress("reconstructing", 0, len(plan))
        for one in in_order(partial(_built, Path(scratch), seed, recipe), plan, jobs):
            built.append(one)
            progress(f"reconstructed {one.twin.planned.id}", len(built), len(plan))
        write_truth(folder / "truth.toml", seed, built)
        return assemble(folder, [one.reconstruction for one in built], recipe, statement(seed))


def _built(scratch: Path, seed: int, recipe: ReconstructionRecord, planned: Planned) -> Built:
    """Render an insertion, reconstruct it from what was written, and keep no volume."""
    scanned = render_insertion(scratch, planned, seed)
    reconstruction = reconstruct(scanned.scan, recipe)
    scanned.scan.volume.unlink()
    return Built(scanned.twin, scanned.exposure, reconstruction)
