"""Names, bounds and ties of a medium's parameters, and the vector theta that is searched.

Moduli and lengths are searched in logarithms, because they are positive and known to orders of
magnitude at most; alpha is searched as it is.
"""

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError
from needlefit.inference.prior import Prior, make_prior
from needlefit.inference.ties import NOISE_SCALE, dimension, parse_tie, resolve_ties
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.medium import MediumRecord, ParameterRecord

Floats = NDArray[np.float64]
Theta = Sequence[float] | Floats
Status = Literal["free", "fixed", "tied"]


def is_logarithmic(name: str) -> bool:
    """Return whether theta holds the natural logarithm of this parameter."""
    return dimension(name) != "exponent"


NOISE_SCALE_BOUNDS = (0.1, 10.0)
"""Bounds of a noise scale that is estimated; its prior is flat in the logarithm."""


@dataclass(frozen=True)
class Parameters:
    """Which parameters are free, fixed and tied; every parameter is exactly one of these.

    Attributes
    ----------
    names : tuple of str
        All parameters in the order of layers: mu1_pa, alpha1, ..., bevel_mm, guide_distance_mm.
    bounds : mapping
        Low and high of each free parameter, in its own unit.
    fixed : mapping
        Value of each fixed parameter.
    ties : mapping
        Factor and source of each tied one; a source is free.
    prior : Prior
        What the medium states of some of them; flat within the bounds otherwise.
    """

    names: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]
    ties: Mapping[str, tuple[float, str]]
    prior: Prior = field(default=Prior())

    @classmethod
    def from_record(cls, record: MediumRecord) -> Self:
        """Return the parameters of a checked medium.

        Raises
        ------
        ConfigError
            If a name is unknown or missing, a tie leads nowhere, or a bound, value or prior cannot be.
        """
        table = record.parameters
        names = _ordered_names(record)
        ties = {name: parse_tie(name, p.tie) for name, p in table.items() if p.tie is not None}
        for name in names:
            _check_positive(name, table[name])
        fixed = {name: value for name in names if (value := table[name].fixed) is not None}
        ends = resolve_ties(ties, frozenset(names))
        return cls(
            names=names,
            bounds={name: bounds for name in names if (bounds := table[name].bounds) is not None},
            # what is tied to a fixed parameter is fixed too
            fixed=fixed | {name: factor * fixed[at] for name, (factor, at) in ends.items() if at in fixed},
            ties={name: tie for name, tie in ends.items() if tie[1] not in fixed},
            prior=make_prior({name: table[name] for name in names}),
        )

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of theta."""
        return tuple(name for name in self.names if name in self.bounds)

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return np.array([_to_coordinate(name, self.bounds[name][0]) for name in self.free])

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return np.array([_to_coordinate(name, self.bounds[name][1]) for name in self.free])

    @property
    def status(self) -> dict[str, Status]:
        """Whether each parameter is free, fixed or tied."""
        return {
            name: "free" if name in self.bounds else "fixed" if name in self.fixed else "tied"
            for name in self.names
        }

    def values(self, theta: Theta) -> dict[str, float]:
        """Return every parameter's value (Pa, mm), ties and fixed ones resolved, for `theta` (P,)."""
        if len(theta) != len(self.bounds):
            raise ValueError(f"theta has {len(theta)} entries, {len(self.bounds)} parameters are free")
        known = dict(self.fixed)
        for name, entry in zip(self.free, theta, strict=True):
            known[name] = math.exp(entry) if is_logarithmic(name) else float(entry)
        for name, (factor, source) in self.ties.items():
            known[name] = factor * known[source]
        return {name: known[name] for name in self.names}

    def slopes(self, values: Mapping[str, float]) -> dict[str, Floats]:
        """Return d value / d theta (P,) of every parameter, through logarithms and ties; 0 where fixed."""
        unit = dict(zip(self.free, np.eye(len(self.bounds)), strict=True))
        known = {n: (values[n] if is_logarithmic(n) else 1.0) * row for n, row in unit.items()}
        tied = {name: factor * known[source] for name, (factor, source) in self.ties.items()}
        held = {name: np.zeros(len(self.bounds)) for name in self.fixed}
        return held | known | tied

    def theta(self, values: Mapping[str, float]) -> Floats:
        """Return theta (P,) of the free parameters among `values` (Pa, mm)."""
        return np.array([_to_coordinate(name, values[name]) for name in self.free])

    def with_only(self, free: Sequence[str], values: Mapping[str, float]) -> Self:
        """Return parameters of which only `free` stay free, all others fixed at `values`.

        A tie to a parameter that stays free stays; a parameter with no entry in `values` keeps its own
        fixed value.
        """
        unknown = [name for name in free if name not in self.bounds]
        if unknown:
            raise ConfigError(
                f"cannot leave {', '.join(unknown)} free", expected=f"among {', '.join(self.free)}"
            )
        ties = {name: tie for name, tie in self.ties.items() if tie[1] in free}
        held = [name for name in self.names if name not in free and name not in ties]
        known = {**self.fixed, **values}
        missing = [name for name in held if name not in known]
        if missing:
            raise ConfigError(f"no value is given for {', '.join(missing)}", fix="give one, or leave it free")
        return replace(
            self,
            bounds={name: self.bounds[name] for name in self.free if name in free},
            fixed={name: float(known[name]) for name in held},
            ties=ties,
        )


def with_noise_scale(parameters: Parameters, largest: float = NOISE_SCALE_BOUNDS[1]) -> Parameters:
    """Return the parameters with a free noise scale, bounded by `largest`, as the last one."""
    names, bounds = (
        (*parameters.names, NOISE_SCALE),
        {**parameters.bounds, NOISE_SCALE: (NOISE_SCALE_BOUNDS[0], largest)},
    )
    return replace(parameters, names=names, bounds=bounds)


def make_tissue(
    values: Mapping[str, float], sequence: Sequence[int], boundaries: Floats, medium: MediumRecord
) -> Tissue:
    """Return the tissue that one insertion meets, in the units of the mechanics (MPa, mm).

    Parameters
    ----------
    values : mapping
        Every parameter (Pa).
    sequence : sequence of int
        Layer number, from 1, in each of the n intervals; a layer may be met again.
    boundaries : (n - 1,) array
        Depths between the intervals, mm.
    medium : MediumRecord
        For the law and the thickness compressed.
    """
    beyond = sorted({layer for layer in sequence if not 1 <= layer <= medium.layers})
    if beyond:
        raise ConfigError(
            f"an insertion meets layer {beyond[0]}, the medium `{medium.title}` has {medium.layers}",
            fix="use the configuration of the medium that the needle went into",
        )
    return Tissue(
        # Pa to MPa = N / mm^2
        mu=np.array([values[f"mu{layer}_pa"] * 1e-6 for layer in sequence]),
        alpha=np.array([values[f"alpha{layer}"] for layer in sequence]),
        boundaries=np.asarray(boundaries, dtype=np.float64),
        thickness=np.array([medium.thickness_mm]),
        law=medium.law,
    )


def _to_coordinate(name: str, value: float) -> float:
    return math.log(value) if is_logarithmic(name) else float(value)


def _ordered_names(record: MediumRecord) -> tuple[str, ...]:
    """Return the medium's parameter names in the order of layers; ConfigError unless they are complete."""
    layers = [f"{kind}{i}{unit}" for i in range(1, record.layers + 1) for kind, unit in _PER_LAYER]
    needed = [*layers, "bevel_mm"]
    missing = [name for name in needed if name not in record.parameters]
    extra = [name for name in record.parameters if name not in [*needed, "guide_distance_mm"]]
    if missing or extra:
        faults = [f"`{n}` is missing" for n in missing] + [f"`{n}` is unknown here" for n in extra]
        raise ConfigError(
            "; ".join(faults),
            key=f"parameters.{extra[0]}" if extra else "parameters",
            expected=f"{', '.join(needed)} ({record.layers} layers), and guide_distance_mm if wanted",
            fix=_suggest_fix(missing, extra, record.layers),
        )
    return (*needed, *(["guide_distance_mm"] if "guide_distance_mm" in record.parameters else []))


def _suggest_fix(missing: Sequence[str], extra: Sequence[str], layers: int) -> str:
    """Return what to do about missing and unknown parameters: one may be the other, mistyped."""
    remaining, fixes = list(missing), []
    for name in extra:
        near = difflib.get_close_matches(name, remaining, n=1)
        fixes.append(f"write `{near[0]}` for `{name}`" if near else f"remove `{name}`")
        remaining = [one for one in remaining if one not in near]
    fixes += [f"add `{name}`" for name in remaining]
    return f"{', '.join(fixes)}; or correct `layers = {layers}`"


_PER_LAYER = (("mu", "_pa"), ("alpha", ""))


def _check_positive(name: str, parameter: ParameterRecord) -> None:
    """Refuse what has no logarithm; a fixed bevel of 0, the symmetric tip, is allowed."""
    low = parameter.bounds[0] if parameter.bounds else parameter.fixed
    if low is None or not is_logarithmic(name):
        return
    if low < 0 or (low == 0 and not (name == "bevel_mm" and parameter.bounds is None)):
        raise ConfigError(
            f"{name} may be {low:g}, which is not above 0",
            key=f"parameters.{name}",
            expected="a positive number: it is searched in logarithms",
            fix="raise the lower bound, or the fixed value",
        )
