"""The true parameters of a fit to a twin: means over what the fit learns from."""

import math
from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.parameter_names import dimension
from needlefit.inference.parameters import Parameters
from needlefit.studies.run import Run
from synthetic.design import POPULATION, bevel_offset, draw_deviations, draw_specimen, list_designs


def find_truth(run: Run, seed: int, population: bool = False) -> dict[str, float]:
    """Return the true parameters (Pa, mm) of a run with one fit to the twin of a seed.

    Those that its dataset states, else those that the twin has: no hyperparameters, no angle of a cut; no
    exponents of a `population`.
    """
    if stated := dict(run.metadata.truth):
        return stated
    (fold,) = run.metadata.folds
    parameters = Parameters.from_record(run.metadata.medium)
    values = {
        name: find_true_value(fold.tune, parameters, name, seed, population) for name in parameters.names
    }
    return {name: value for name, value in values.items() if math.isfinite(value)}


def find_true_value(
    tuned: Sequence[str], parameters: Parameters, name: str, seed: int, drawn: bool = False
) -> float:
    """Return the mean of a parameter over the specimens, layers and bevels of insertions that are fitted to.

    The geometric mean, of exponents the arithmetic one. NaN for what the truth has not.
    """
    population = POPULATION if drawn else None
    planned = {design.id: design for design in list_designs()}
    designs = [planned[insertion] for insertion in tuned]
    specimens = [draw_specimen(seed, design.medium, design.specimen, population) for design in designs]
    if name == "bevel_mm":
        pairs = zip(specimens, designs, strict=True)
        offsets = [
            bevel_offset(specimen, design, draw_deviations(seed, design)) for specimen, design in pairs
        ]
        return float(np.exp(np.mean(np.log(offsets))))
    same = [name, *(tied for tied, (_, source) in parameters.ties.items() if source == name)]
    quantity = dimension(name)
    if quantity == "modulus":
        values = _list_true(same, "mu", [specimen.mu for specimen in specimens])
        return float(1e6 * np.exp(np.mean(np.log(values)))) if values else math.nan
    if quantity == "alpha" and population is None:
        values = _list_true(same, "alpha", [specimen.alpha for specimen in specimens])
        return float(np.mean(values)) if values else math.nan
    return math.nan


def _list_true(names: Sequence[str], prefix: str, specimens: Sequence[Floats]) -> list[float]:
    """Return the true values of the layers that `names` name, of all specimens (layers,)."""
    layers = [int(name.removeprefix(prefix).removesuffix("_pa")) - 1 for name in names]
    return [float(specimen[layer]) for specimen in specimens for layer in layers if layer < len(specimen)]
