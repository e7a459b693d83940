"""Write a first study of an imported dataset, and the tissue model that it fits."""

from pathlib import Path

from needlefit.datasets.insertion import Dataset
from needlefit.project.load import check
from needlefit.project.toml_text import dumps
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.study import StudyRecord

TISSUE_FILE = "tissue.toml"

MODULUS_BOUNDS_PA, BEVEL_BOUNDS_MM = [1e3, 1e9], [1e-3, 1.0]

_NOTE = "# A start, made by `needlefit import`: {what} `needlefit explain {kind}` lists every key.\n"


def name_study_file(name: str) -> str:
    """Return the file of a dataset's first study; the folder of its results has this name, too."""
    return f"{name}_study.toml"


def write_starter_study(folder: Path, dataset: Dataset, home: str) -> bool:
    """Write a study and its `tissue.toml` into `folder`; return False if there are too few insertions.

    The study leaves out one specimen at a time, or, of a single specimen, one insertion. The tissue model has
    as many layers as the deepest insertion meets; the exponents alpha are fixed at 1, as shapes hardly depend
    on them.

    Parameters
    ----------
    home : str
        The folder as it will be named by the study, relative to the working folder.
    """
    if len(dataset.insertions) < 2:
        return False
    layers = max(max(one.sequence) for one in dataset.insertions)
    numbers = range(1, layers + 1)
    tissue = {
        "schema": 1,
        "title": f"Tissue of {dataset.name}",
        "layers": layers,
        "parameters": {
            **{f"mu{n}_pa": {"bounds": MODULUS_BOUNDS_PA} for n in numbers},
            **{f"alpha{n}": {"fixed": 1.0} for n in numbers},
            "bevel_mm": {"bounds": BEVEL_BOUNDS_MM},
        },
    }
    several = len({one.specimen for one in dataset.insertions}) > 1
    unit = "specimen" if several else "insertion"
    where = "those into a new specimen" if several else "another one into the same specimen"
    study = {
        "schema": 2,
        "title": f"{dataset.name}: leave one {unit} out",
        "question": f"Does a model fitted to all other insertions predict {where}?",
        "dataset": home,
        "medium": f"{home}/{TISSUE_FILE}",
        "recipe": "default",
        "leave_out": unit,
        **({} if several else {"same_specimen": True}),
    }
    check(tissue, MediumRecord, TISSUE_FILE)
    check(study, StudyRecord, name_study_file(dataset.name))
    _write(folder / TISSUE_FILE, tissue, "medium.toml", "the layers, and which parameters are fitted.")
    study_file = folder / name_study_file(dataset.name)
    _write(study_file, study, "study.toml", "what is fitted, and what is predicted.")
    return True


def _write(path: Path, tables: dict[str, object], kind: str, what: str) -> None:
    path.write_bytes((_NOTE.format(what=what, kind=kind) + dumps(tables)).encode("utf-8"))
