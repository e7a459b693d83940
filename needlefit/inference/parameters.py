"""Which parameters of a medium are free, fixed and tied, and the vector theta of the free ones.

A tie is a factor and the parameter it refers to ("10 * mu1_pa"); one with a spread is a part of the stated
prior, a Gaussian in theta within the flat bounds.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.errors import ConfigError
from needlefit.inference.parameter_names import (
    BEVEL_PARAMETERS,
    BEVEL_SPREAD,
    BEVEL_SPREAD_BOUNDS,
    HYPERPARAMETERS,
    NOISE_SCALE,
    NOISE_SCALE_BOUNDS,
    dimension,
    is_logarithmic,
    is_shape_parameter,
    to_coordinate,
)
from needlefit.inference.prior import Prior, SoftTie, add_ties, alpha_of, make_half_normal, make_prior
from needlefit.mechanics.laws import LAWS, ShapeParameter
from needlefit.mechanics.tissue import MAX_MU_MPA, Tissue
from needlefit.project.toml import add_key_context
from needlefit.schemas.medium import MediumRecord, ParameterRecord, PriorRecord
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.schemas.scene import CUT_ANGLE_LIMIT_DEG

Theta = Sequence[float] | Floats
Values = Mapping[str, float]  #: of every parameter (Pa, mm)
Status = Literal["free", "prior", "fixed", "tied"]

#: factor, one standard deviation, by which moduli tied as one material differ where the tie states none; the
#: layers of the synthetic dataset had no part in it: casts of one recipe differ by 10 to 20 % in stiffness
MATERIAL_SPREAD = 1.2
MAX_TISSUE_MU_PA = MAX_MU_MPA * 1e6  #: largest modulus that is simulated (Pa)
MAX_TIE_SDS = 6.0  #: number of standard deviations of a tie beyond which a tied parameter is not searched

_TIE = re.compile(r"\s*(?:(?P<factor>[^*\s]+)\s*\*\s*)?(?P<name>[A-Za-z_]\w*)\s*")


def parse_tie(name: str, tie: str) -> tuple[float, str]:
    """Return (factor, source) of the tie that the parameter `name` states.

    Raises ConfigError if the tie cannot be read, joins different quantities, or its factor cannot be.
    """
    match = _TIE.fullmatch(tie)
    if match is None:
        raise _tie_error(name, tie, "cannot be read")
    try:
        factor = float(match["factor"] or 1.0)
    except ValueError:
        raise _tie_error(name, tie, f"has the factor `{match['factor']}`, which is no number") from None
    with add_key_context(f"parameters.{name}.tie"):
        source = dimension(match["name"])
    if source != dimension(name):
        raise _tie_error(name, tie, f"joins different quantities, {dimension(name)} and {source}")
    positive = not is_shape_parameter(name)
    if not math.isfinite(factor) or (positive and factor <= 0):
        raise _tie_error(name, tie, f"has the factor {factor:g}; moduli and lengths stay positive")
    return factor, match["name"]


def resolve_ties(
    ties: Mapping[str, tuple[float, str]], names_of_parameters: frozenset[str]
) -> dict[str, tuple[float, str]]:
    """Return each tied parameter's (factor, source) with a source that is itself not tied.

    Raises ConfigError if a tie leads to no parameter of the medium, or in a circle.
    """
    ends = {}
    for name in ties:
        factor, source, visited, key = 1.0, name, [name], f"parameters.{name}.tie"
        while source in ties:
            step, source = ties[source]
            factor *= step
            if source in visited:
                raise ConfigError(
                    f"ties run in a circle: {' -> '.join([*visited, source])}",
                    fix="leave one of them free or fixed",
                    key=key,
                )
            if source not in names_of_parameters:
                raise ConfigError(
                    f"`{visited[-1]}` is tied to `{source}`, which is no parameter of this tissue model",
                    expected=f"one of {', '.join(sorted(names_of_parameters - set(visited)))}",
                    fix="tie it to one of these, or give it bounds",
                    key=key,
                )
            visited.append(source)
        ends[name] = factor, source
    return ends


def _tie_error(name: str, tie: str, fault: str) -> ConfigError:
    return ConfigError(
        f"the tie `{tie}` {fault}",
        key=f"parameters.{name}.tie",
        expected='a parameter of the same kind, as "mu1_pa" or "10 * mu1_pa"',
        fix="correct the tie, or give the parameter bounds",
    )


@dataclass(frozen=True)
class Parameters:
    """Which parameters are free, fixed and tied; every parameter is exactly one of these."""

    #: all parameters in the order of layers: mu1_pa, alpha1, ..., bevel_mm or cut_angle_deg,
    #: guide_distance_mm
    names: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]  #: low and high of each free parameter, in its own unit
    fixed: Mapping[str, float]  #: value of each fixed parameter
    ties: Mapping[str, tuple[float, str]]  #: factor and source of each that is tied exactly; a source is free
    #: what the medium states of some of them, ties with a spread among it; flat within the bounds otherwise
    prior: Prior = field(default=Prior())
    #: free ones that searches hold at the centre of their prior, which is then their posterior
    held: tuple[str, ...] = ()

    @classmethod
    def from_record(cls, record: MediumRecord) -> Self:
        """Return the parameters of a checked medium.

        Raises ConfigError if a name is unknown or missing, a tie leads nowhere, or a bound, value or prior
        cannot be.
        """
        if record.law not in LAWS:
            raise LAWS.unknown_name_error(record.law, key="law")
        names = _ordered_names(record)
        table = state_usual_bounds(record) | record.parameters
        stated_ties = {name: parse_tie(name, p.tie) for name, p in table.items() if p.tie is not None}
        resolve_ties(stated_ties, frozenset(names))  # checks those with a spread too
        soft = {name: spread for name in stated_ties if (spread := find_tie_spread(name, table[name])) > 1}
        for name in names:
            check_values(name, table[name], record.law)
        fixed = {name: value for name in names if (value := table[name].fixed) is not None}
        exact = {name: tie for name, tie in stated_ties.items() if name not in soft}
        ends = resolve_ties(exact, frozenset(names))
        # what is tied to a fixed parameter is fixed too
        fixed |= {name: factor * fixed[source] for name, (factor, source) in ends.items() if source in fixed}
        faults = []
        for name, (factor, source) in ((name, stated_ties[name]) for name in names if name in soft):
            more, source = ends.get(source, (1.0, source))
            faults.append(SoftTie(name, source, factor * more, soft[name]))
        ties: list[SoftTie] = []
        while faults:  # each behind that of its source
            ties += [tie for tie in faults if tie.source not in {other.name for other in faults}]
            faults = [tie for tie in faults if tie not in ties]
        bounds = {name: bounds for name in names if (bounds := table[name].bounds) is not None}
        for tie in ties:
            bounds[tie.name] = _find_tied_bounds(tie, bounds, fixed)
        return cls(
            names=names,
            bounds=bounds,
            fixed=fixed,
            ties={name: tie for name, tie in ends.items() if tie[1] not in fixed},
            prior=make_prior({name: table[name] for name in names}, ties),
            held=tuple(name for name in names if _has_own_prior(name, table)),
        )

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of theta."""
        return tuple(name for name in self.names if name in self.bounds)

    @cached_property
    def _coordinates(self) -> list[tuple[str, bool]]:
        """The free parameters, and whether theta has their logarithm: looked up once for many thetas."""
        return [(name, is_logarithmic(name)) for name in self.free]

    @cached_property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return np.array([to_coordinate(name, self.bounds[name][0]) for name in self.free])

    @cached_property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return np.array([to_coordinate(name, self.bounds[name][1]) for name in self.free])

    @property
    def status(self) -> dict[str, Status]:
        """Whether each parameter is free, its prior alone is known, or it is fixed or tied."""
        statuses: dict[str, Status] = {}
        for name in self.names:
            statuses[name] = "free" if name in self.bounds else "fixed" if name in self.fixed else "tied"
        tied = [name for name, (_, source) in self.ties.items() if source in self.held]
        return statuses | dict.fromkeys([*self.held, *tied], "prior")

    def holding(self, names: Collection[str]) -> Self:
        """Return the parameters of which only `names` are held, among those that are."""
        return replace(self, held=tuple(name for name in self.held if name in names))

    @property
    def searched(self) -> Self:
        """The parameters that are searched: those held are fixed at the centre of their prior."""
        if not self.held:
            return self
        free = [name for name in self.free if name not in self.held]
        narrowed = self.with_only(free, self.values(self.expected))
        return replace(narrowed, prior=self.prior.without(self.held))

    @cached_property
    def _is_searched(self) -> Bools:
        return np.array([name not in self.held for name in self.free], dtype=np.bool_)

    def restrict(self, thetas: Floats) -> Floats:
        """Return theta (..., S) of the parameters that are searched, from theta (..., P) of all free ones."""
        return thetas[..., self._is_searched]

    def extend(self, thetas: Floats, held: Floats | None = None) -> Floats:
        """Return theta (..., P) of all free parameters, from theta (..., S) of those that are searched.

        `held` (..., H) are theta of the others, by default the centre of their prior.
        """
        extended = np.broadcast_to(self.expected, (*thetas.shape[:-1], len(self.free))).copy()
        extended[..., self._is_searched] = thetas
        if held is not None:
            extended[..., ~self._is_searched] = held
        return extended

    def values(self, theta: Theta) -> dict[str, float]:
        """Return every parameter's value (Pa, mm), ties and fixed ones resolved, for `theta` (P,)."""
        if len(theta) != len(self.bounds):
            raise ValueError(f"theta has {len(theta)} entries, {len(self.bounds)} parameters are free")
        entries = theta.tolist() if isinstance(theta, np.ndarray) else theta
        complete = dict(self.fixed)
        for (name, logarithmic), entry in zip(self._coordinates, entries, strict=True):
            complete[name] = math.exp(entry) if logarithmic else float(entry)
        for name, (factor, source) in self.ties.items():
            complete[name] = factor * complete[source]
        return {name: complete[name] for name in self.names}

    def slopes(self, values: Mapping[str, float]) -> dict[str, Floats]:
        """Return d value / d theta (P,) of every parameter, through logarithms and ties; 0 where fixed."""
        unit = dict(zip(self.free, np.eye(len(self.bounds)), strict=True))
        scaled = {n: (values[n] if is_logarithmic(n) else 1.0) * row for n, row in unit.items()}
        tied = {name: factor * scaled[source] for name, (factor, source) in self.ties.items()}
        held = {name: np.zeros(len(self.bounds)) for name in self.fixed}
        return held | scaled | tied

    def theta(self, values: Mapping[str, float]) -> Floats:
        """Return theta (P,) of the free parameters among `values` (Pa, mm).

        Hyperparameters may be missing: they are what they are before any data.
        """
        complete = {**choose_hyperparameters(self), **values}
        return np.array([to_coordinate(name, complete[name]) for name in self.free])

    @property
    def expected(self) -> Floats:
        """Theta (P,) before any data: the means that are stated, else the middle of the bounds."""
        means = dict(zip(self.free, (0.5 * (self.lower + self.upper)).tolist(), strict=True))
        means |= {name: mean for name, (mean, _) in self.prior.marginals.items() if name in means}
        for tie, _, _ in self.free_ties:
            if tie.name not in self.prior.marginals:
                means[tie.name] = means[tie.source] + math.log(tie.factor)
        return np.array([means[name] for name in self.free])

    @cached_property
    def free_ties(self) -> list[tuple[SoftTie, int, int]]:
        """Ties with a spread, of free parameters to free ones, with the places of both in theta.

        A source comes before what is tied to it.
        """
        place = {name: k for k, name in enumerate(self.free)}
        ties = (tie for tie in self.prior.ties if {tie.name, tie.source} <= place.keys())
        return [(tie, place[tie.name], place[tie.source]) for tie in ties]

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
        complete = {**choose_hyperparameters(self), **self.fixed, **values}
        missing = [name for name in held if name not in complete]
        if missing:
            raise ConfigError(f"no value is given for {', '.join(missing)}", fix="give one, or leave it free")
        return replace(
            self,
            bounds={name: self.bounds[name] for name in self.free if name in free},
            fixed={name: float(complete[name]) for name in held},
            ties=ties,
        ).holding(free)


def with_bevel_spread(parameters: Parameters, sd: float) -> Parameters:
    """Return the parameters with a free bevel CV between insertions, half-normal with `sd`, last."""
    low, high = BEVEL_SPREAD_BOUNDS
    return replace(
        parameters,
        names=(*parameters.names, BEVEL_SPREAD),
        bounds={**parameters.bounds, BEVEL_SPREAD: (low * sd, high * sd)},
        prior=replace(
            parameters.prior, positive=(*parameters.prior.positive, make_half_normal(BEVEL_SPREAD, sd))
        ),
    )


def with_hyperparameters(parameters: Parameters, likelihood: LikelihoodRecord) -> Parameters:
    """Return the parameters with those that a likelihood estimates beside them.

    No needle's bevel is known to vary where the medium fixes it.
    """
    if likelihood.noise_scale == "estimated":
        bounds = {**parameters.bounds, NOISE_SCALE: NOISE_SCALE_BOUNDS}
        parameters = replace(parameters, names=(*parameters.names, NOISE_SCALE), bounds=bounds)
    if likelihood.bevel_spread > 0 and any(name in parameters.free for name in BEVEL_PARAMETERS):
        parameters = with_bevel_spread(parameters, likelihood.bevel_spread)
    return parameters


def without_bevel_spread(parameters: Parameters) -> Parameters:
    """Return the parameters for a bevel offset that is the same in all insertions."""
    return replace(
        parameters,
        names=tuple(name for name in parameters.names if name != BEVEL_SPREAD),
        bounds={name: bounds for name, bounds in parameters.bounds.items() if name != BEVEL_SPREAD},
        prior=parameters.prior.without([BEVEL_SPREAD]),
    )


def choose_hyperparameters(parameters: Parameters) -> dict[str, float]:
    """Return the hyperparameters where nothing is known: at the peak of their prior, or 1."""
    names = [name for name in parameters.names if name in HYPERPARAMETERS]
    stated = {name: parameters.prior.marginals[name] for name in names if name in parameters.prior.marginals}
    return dict.fromkeys(names, 1.0) | {name: math.exp(peak) for name, (peak, _) in stated.items()}


def without_prior(parameters: Parameters) -> Parameters:
    """Return the parameters for an objective that knows no prior: all ties exact, no hyperparameters.

    What is held at the centre of its prior is fixed there.
    """
    parameters = parameters.searched
    soft = {
        tie.name: (tie.factor, tie.source) for tie in parameters.prior.ties if tie.name in parameters.free
    }
    ends = resolve_ties({**parameters.ties, **soft}, frozenset(parameters.names))
    held = choose_hyperparameters(parameters)
    fixed = {**parameters.fixed, **held}
    fixed |= {name: factor * fixed[source] for name, (factor, source) in ends.items() if source in fixed}
    return replace(
        parameters,
        bounds={name: parameters.bounds[name] for name in parameters.free if name not in {**soft, **held}},
        fixed=fixed,
        ties={name: tie for name, tie in ends.items() if tie[1] not in fixed},
        prior=replace(parameters.prior, ties=()),
    )


def loosen_ties(parameters: Parameters) -> Parameters:
    """Return the parameters as they are known without the medium's ties.

    Exact ties of moduli and lengths get the spread `MATERIAL_SPREAD`; those that have a spread are left out.
    """
    loose = {name: tie for name, tie in parameters.ties.items() if is_logarithmic(name)}
    added = [SoftTie(name, source, factor, MATERIAL_SPREAD) for name, (factor, source) in loose.items()]
    bounds = dict(parameters.bounds)
    for tie in added:
        bounds[tie.name] = _find_tied_bounds(tie, bounds, {})
    return replace(
        parameters,
        bounds=bounds,
        ties={name: tie for name, tie in parameters.ties.items() if name not in loose},
        prior=add_ties(parameters.prior.without_ties(), added) if added else parameters.prior.without_ties(),
    )


def find_tie_spread(name: str, parameter: ParameterRecord) -> float:
    """Return the spread of a tie: the stated one, or, without a factor, that of two casts of one material."""
    if parameter.spread is None:
        one_material = dimension(name) == "modulus" and "*" not in str(parameter.tie)
        return MATERIAL_SPREAD if one_material else 1.0
    if is_shape_parameter(name) and parameter.spread > 1:
        raise ConfigError(
            f"the tie of the shape parameter {name} has a spread",
            expected="1",
            fix="leave out `spread`, or give bounds and a prior in place of the tie",
            key=f"parameters.{name}.spread",
        )
    return parameter.spread


def _find_tied_bounds(
    tie: SoftTie, bounds: Mapping[str, tuple[float, float]], fixed: Mapping[str, float]
) -> tuple[float, float]:
    low, high = bounds.get(tie.source) or (fixed[tie.source], fixed[tie.source])
    reach = tie.spread**MAX_TIE_SDS
    high *= tie.factor * reach
    if dimension(tie.name) == "modulus":
        high = min(high, MAX_TISSUE_MU_PA)
    return tie.factor * low / reach, high


def make_tissue(
    values: Mapping[str, float], sequence: Sequence[int], boundaries: Floats, medium: MediumRecord
) -> Tissue:
    """Return the tissue that one insertion meets, in the units of the mechanics (MPa, mm).

    `values` are all parameters (Pa), `sequence` the layer number, from 1, in each of the n intervals (a layer
    may be met again), and `boundaries` (n - 1,) the depths between them, mm.
    """
    beyond = sorted({layer for layer in sequence if not 1 <= layer <= medium.layers})
    if beyond:
        raise ConfigError(
            f"an insertion meets layer {beyond[0]}, the medium `{medium.title}` has {medium.layers}",
            fix="use the medium that the needle went into",
        )
    return Tissue(
        # Pa to MPa = N / mm^2
        mu=np.array([values[f"mu{layer}_pa"] * 1e-6 for layer in sequence]),
        shape=[[values[name] for name in row] for row in LAWS[medium.law].name_shape(sequence)],
        boundaries=np.asarray(boundaries, dtype=np.float64),
        thickness=np.array([medium.thickness_mm]),
        law=medium.law,
        is_checked=True,
        torsional_friction=medium.torsional_friction_n,
    )


def _ordered_names(record: MediumRecord) -> tuple[str, ...]:
    """Return the medium's parameter names in the order of layers; ConfigError unless they are complete."""
    usual, law, needed = state_usual_bounds(record), LAWS[record.law], list[str]()
    for layer in range(1, record.layers + 1):
        # a law without shape parameters takes no notice of an alpha that is left from another law
        unused = [f"alpha{layer}"] if not law.parameters and f"alpha{layer}" in record.parameters else []
        needed += [f"mu{layer}_pa", *(f"{name}{layer}" for name in law.shape_names), *unused]
    needed.append(record.bevel_parameter)
    missing = [name for name in needed if name not in record.parameters and name not in usual]
    extra = [name for name in record.parameters if name not in [*needed, "guide_distance_mm"]]
    if missing or extra:
        faults = [f"`{n}` is missing" for n in missing] + [f"`{n}` is unknown here" for n in extra]
        fixes = [f"remove `{name}`" for name in extra] + [f"add `{name}`" for name in missing]
        raise ConfigError(
            "; ".join(faults),
            key=f"parameters.{extra[0]}" if extra else "parameters",
            expected=f"{', '.join(needed)} ({record.layers} layers), and guide_distance_mm if wanted",
            fix=f"{', '.join(fixes)}; or correct `layers = {record.layers}`",
        )
    return (*needed, *(["guide_distance_mm"] if "guide_distance_mm" in record.parameters else []))


def _has_own_prior(name: str, table: Mapping[str, ParameterRecord]) -> bool:
    """Return whether a shape parameter has a normal prior that no modulus is correlated with."""
    if not is_shape_parameter(name) or not isinstance(table[name].prior, PriorRecord):
        return False
    moduli = {
        alpha_of(other): record.prior for other, record in table.items() if dimension(other) == "modulus"
    }
    return not (isinstance(prior := moduli.get(name), PriorRecord) and prior.correlation)


def state_usual_bounds(record: MediumRecord) -> dict[str, ParameterRecord]:
    """Return the law's shape parameters, free within the usual bounds: for those that a medium leaves out."""
    law = LAWS[record.law]
    rows = zip(law.parameters, law.name_shape(range(1, record.layers + 1)), strict=True)
    return {name: state_usual(usual) for usual, row in rows for name in row}


def state_usual(parameter: ShapeParameter) -> ParameterRecord:
    """Return a shape parameter of a law, free within its usual bounds, with its usual prior."""
    prior = None
    if parameter.prior is not None:
        mean, sd = parameter.prior
        prior = PriorRecord(mean=mean, sd=sd)
    return ParameterRecord(bounds=parameter.usual, prior=prior)


def check_values(name: str, parameter: ParameterRecord, law: str) -> None:
    """Refuse bounds and fixed values without a logarithm, or that the law or a needle cannot have."""
    stated = parameter.bounds or (() if parameter.fixed is None else (parameter.fixed,))
    if not stated:
        return
    low, high, fault = stated[0], max(stated), None
    of_law = {parameter.name: parameter.bounds for parameter in LAWS[law].parameters}
    bounds = of_law.get(dimension(name), (-math.inf, math.inf))
    symmetric = low == 0 and name in BEVEL_PARAMETERS and parameter.bounds is None
    if is_logarithmic(name) and low <= 0 and not symmetric:
        fault = (
            f"{name} may be {low:g}, which is not above 0",
            "a positive number",
            "raise the lower bound, or the fixed value",
        )
    elif any(not bounds[0] <= value <= bounds[1] for value in stated):
        fault = (
            f"the tissue law `{law}` is not meant for {name} = "
            f"{' to '.join(f'{value:g}' for value in stated)}",
            f"{bounds[0]:g} to {bounds[1]:g}",
            "change the bounds or the fixed value, or take another law",
        )
    elif name == "cut_angle_deg" and high >= CUT_ANGLE_LIMIT_DEG:
        fault = (
            f"{name} may be {high:g}, and no needle is simulated with {CUT_ANGLE_LIMIT_DEG:g} or more",
            f"below {CUT_ANGLE_LIMIT_DEG:g} degrees",
            "lower the upper bound, or the fixed value",
        )
    elif dimension(name) == "modulus" and high > MAX_TISSUE_MU_PA:
        fault = (
            f"{name} may be {high:g}, and no tissue is simulated with more than {MAX_TISSUE_MU_PA:g} Pa",
            f"at most {MAX_TISSUE_MU_PA:g} Pa",
            "lower the upper bound, or the fixed value",
        )
    if fault:
        raise ConfigError(fault[0], key=f"parameters.{name}", expected=fault[1], fix=fault[2])
