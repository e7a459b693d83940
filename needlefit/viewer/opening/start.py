"""With which parameters the needle of an insertion begins, before a hand tunes them."""

from collections.abc import Mapping
from dataclasses import dataclass

from needlefit.datasets.insertion import Insertion
from needlefit.inference.parameters import Parameters
from needlefit.project.load import load
from needlefit.project.places import find, names
from needlefit.project.records.medium import MediumRecord, ParameterRecord
from needlefit.validation import paper
from needlefit.validation.job import hand_tuned_set

MU_PA, ALPHA, BEVEL_MM = 2e5, 1.0, 0.05
"""Of every layer of a medium that nobody described: the paper's softer material, about its bevel offset."""


@dataclass(frozen=True)
class Beginning:
    """A medium, a value of each of its parameters (Pa, mm), and in words where they come from."""

    medium: MediumRecord
    values: Mapping[str, float]
    said: str


def beginning(insertion: Insertion) -> Beginning:
    """Return the paper's hand-tuned set of the insertion's medium, else the middle of what is known of it.

    Media are described in configs/media by the name that the dataset gives them.
    """
    name, met = insertion.medium, max(insertion.sequence)
    medium = load(find("medium", name), MediumRecord) if name in names("medium") else None
    if medium is None or medium.layers < met:
        return _invented(name, met)
    parameters = Parameters.from_record(medium)
    if name in paper.hand_tuned_names():
        values = hand_tuned_set(name, parameters, name)
        return Beginning(medium, values, f"Parameters: the paper's hand-tuned set {name}.")
    said = f"Parameters: no fit, the middle of the priors and bounds of medium {name}."
    return Beginning(medium, _middle(parameters), said)


def _middle(parameters: Parameters) -> dict[str, float]:
    """Return the peak of the prior where one is stated, else the middle of the bounds, of every parameter."""
    theta = 0.5 * (parameters.lower + parameters.upper)
    for name, mean in zip(parameters.prior.names, parameters.prior.mean, strict=True):
        theta[parameters.free.index(name)] = mean
    return parameters.values(theta)


def _invented(name: str, layers: int) -> Beginning:
    numbers = range(1, layers + 1)
    values = {key: value for n in numbers for key, value in ((f"mu{n}_pa", MU_PA), (f"alpha{n}", ALPHA))}
    values["bevel_mm"] = BEVEL_MM
    medium = MediumRecord(
        schema_=1,
        title=name,
        layers=layers,
        parameters={key: ParameterRecord(fixed=value) for key, value in values.items()},
    )
    said = (
        f"Parameters: invented, because no medium {name} of {layers} layer{'s' if layers > 1 else ''} is "
        "described in configs/media."
    )
    return Beginning(medium, values, said)
