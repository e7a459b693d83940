"""Posterior draws of the parameters that one insertion meets, and its needles for all of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from needlefit.arrays import Floats, Ints
from needlefit.inference.forward_model import stack_shape
from needlefit.mechanics.batch import Batch
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue


@dataclass(frozen=True)
class ParameterDraws:
    """Posterior draws of the parameters of the layers that one insertion meets."""

    mu: Floats  #: (B, n) of the n layers that it meets, MPa
    shape: Floats  #: (B, p, n) shape parameters of the law
    bevel: Floats  #: (B,) b, mm; of an advance by the path angle theta, rad

    def __len__(self) -> int:
        return len(self.bevel)

    @classmethod
    def exact(cls, tissue: Tissue, bevel: Bevel, rules: ModelOptions) -> Self:
        """Return the one draw of parameters that are taken as exact."""
        strength, _ = rules.bevel_strength(bevel)
        return cls(tissue.mu[None], tissue.shape[None], np.array([strength]))

    def only(self, rows: Ints) -> Self:
        """Return some of the draws."""
        return replace(self, mu=self.mu[rows], shape=self.shape[rows], bevel=self.bevel[rows])

    def make_batch(
        self, needle: Needle, tissue: Tissue, steps: tuple[Step, ...], rules: ModelOptions
    ) -> Batch:
        """Return the insertion of every draw, with its moduli, shape parameters and bevels."""
        name = "cut_angle" if rules.path_angle else "offset"
        return Batch(needle, tissue, steps, rules, mu=self.mu, shape=self.shape, **{name: self.bevel})


def select_layer_draws(draws: pd.DataFrame, layers: Sequence[int], law: str) -> ParameterDraws:
    """Return draws (one column per parameter; Pa, mm) of a law, arranged by the layers that a needle meets.

    `layers` are their numbers, from 1, in the order in which they are met.
    """
    return ParameterDraws(
        mu=np.column_stack([draws[f"mu{layer}_pa"] * 1e-6 for layer in layers]),
        shape=stack_shape({str(name): column for name, column in draws.items()}, law, layers),
        bevel=np.radians(draws["cut_angle_deg"].to_numpy(dtype=np.float64))
        if "cut_angle_deg" in draws
        else draws["bevel_mm"].to_numpy(dtype=np.float64),
    )
