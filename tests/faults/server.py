"""Commands run in forks of a process that has imported everything: a second less each."""

import importlib
import multiprocessing
import os
import pkgutil
import sys
import tempfile
import traceback
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
    "PYTHONHASHSEED": "0",
    "MPLBACKEND": "agg",
}


class Server:
    """The warm process, seen from the one that asks."""

    def __enter__(self) -> "Server":
        self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
        with patch.dict(os.environ, ENVIRONMENT):
            self._pool.submit(warm).result()
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def run(
        self, words: tuple[str, ...], folder: Path, fault: tuple[str, int] | None = None
    ) -> dict[str, Any]:
        """Run `needlefit WORDS` in a folder, with a fault: its kind and the number of the step.

        Returns `code` (negative: the signal), `steps` (a list), `out` and `err`.
        """
        return self._pool.submit(_answer, words, folder, fault).result()


def warm() -> None:
    """Import what any command may."""
    import needlefit

    for module in pkgutil.walk_packages(needlefit.__path__, "needlefit."):
        if module.name != "needlefit.__main__":
            importlib.import_module(module.name)
    for name in ("matplotlib.pyplot", "typst", "h5netcdf", "xarray", "emcee", "nlopt", "trimesh", "jinja2"):
        importlib.import_module(name)
    _predict_by_few_draws()
    if not os.environ.get("NEEDLEFIT_FAULTS_DRAW"):
        _draw_nothing()


def _predict_by_few_draws() -> None:
    """Predict by few draws: it takes a third of a run, and writes nothing while it draws."""
    from needlefit.inference import predict
    from needlefit.studies import held_out_predictions

    held_out_predictions.PREDICTION_DRAWS = 50
    predict.CURVES = 100


def _draw_nothing() -> None:
    """Write figures and reports as stubs: drawing takes most of a run, and changes none of its steps."""
    import typst
    from matplotlib.figure import Figure

    def saved(_: Figure, file: Any, *args: object, **kwargs: object) -> None:
        if hasattr(file, "write"):
            file.write(b"<svg/>")
        else:
            Path(file).write_bytes(b"%figure")

    def compiled(_: str, **options: object) -> bytes:
        return _SVG if options.get("format") == "svg" else b"%report"

    Figure.savefig = saved  # type: ignore[method-assign]
    typst.compile = compiled  # type: ignore[assignment]


_SVG = b'<svg width="10pt"><image xlink:href="data:image/svg+xml;base64,PHN2Zy8+"/></svg>'


@cache
def _reconstruct_once() -> None:
    """Let `reconstruct` find what it found the first time: it writes nothing while it looks."""
    from faults.commands import SCANS
    from needlefit.imaging import batch
    from needlefit.imaging.scans import read_scans
    from needlefit.imaging.volume_files import read_volume
    from needlefit.project.locate import find_file
    from needlefit.project.toml import load
    from needlefit.schemas.reconstruction import ReconstructionRecord

    recipe = load(find_file("reconstruction", "default"), ReconstructionRecord)
    found = {
        scan.id: batch.examine(read_volume(scan.volume, scan.series), scan, recipe)
        for scan in read_scans(SCANS)
    }
    batch.examine = lambda volume, scan, recipe, search: found[scan.id]


def _child(
    words: tuple[str, ...], folder: Path, fault: tuple[str, int] | None, printed: Path, answer: int
) -> None:
    from faults.injection import Injector, install
    from needlefit.cli import main

    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(printed / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    os.chdir(folder)
    kind, at = fault or ("kill", 0)
    injector = Injector(folder.resolve(), at, kind)
    injector.steps = _ReportedSteps(answer)
    install(injector)
    _count_exchanges(injector)
    code = 0
    try:
        main(words)
    except SystemExit as ending:
        code = ending.code if isinstance(ending.code, int) else 1
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _count_exchanges(injector: Any) -> None:
    """Count the exchange of two folders, a call of the system's that Python does not have."""
    from needlefit.project import folders

    real = folders._try_exchange

    def exchanged(one: Path, other: Path) -> bool:
        injector.step("rename", other)
        return real(one, other)

    folders._try_exchange = exchanged


class _ReportedSteps(list):
    """Steps that the server hears of at once, since this process may be killed at any of them."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor, self._write = descriptor, os.write

    def append(self, step: str) -> None:
        super().append(step)
        self._write(self._descriptor, (step.replace("\n", " ") + "\n").encode())


def _answer(words: tuple[str, ...], folder: Path, fault: tuple[str, int] | None) -> dict[str, Any]:
    if words[0] == "reconstruct":
        _reconstruct_once()
    with tempfile.TemporaryFile() as steps, tempfile.TemporaryDirectory() as printed:
        process = os.fork()
        if process == 0:
            try:
                _child(words, folder, fault, Path(printed), steps.fileno())
            finally:
                os._exit(1)
        _, status = os.waitpid(process, 0)
        steps.seek(0)
        listed = steps.read().decode().splitlines()
        texts = {name: Path(printed, name).read_text(errors="replace") for name in ("out", "err")}
    return {"code": os.waitstatus_to_exitcode(status), "steps": listed, **texts}
