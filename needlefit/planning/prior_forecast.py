"""Predict a needle before any was measured: by the priors of a tissue model, or by published moduli."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.draw_simulation import simulate_scene_draws
from needlefit.inference.forward_model import tabulate_sets
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.parameters import Parameters
from needlefit.inference.predict import draw_from_prior
from needlefit.mechanics.published import PublishedRange, read_moduli
from needlefit.mechanics.scene import Scene
from needlefit.project.random_streams import random_stream
from needlefit.schemas.medium import BEVEL_BOUNDS, MediumRecord
from needlefit.schemas.scene import Advance

DRAWS = 1000
MODULUS_BOUNDS_PA = (10.0, 1e8)  # beyond all soft tissues and gels
# The bevel's parameter before any fit: its median, in mm or degrees, and its factor of 1 SD. The paper's
# needles have b of 0.03 to 0.085 mm.
# Errors of the entry pose, beside the parameters of a tissue model.
POSE_SHIFT, POSE_ANGLE = "pose_shift_mm", "pose_angle_deg"
BEVEL_PRIORS: Mapping[str, tuple[float, float]] = {"bevel_mm": (0.05, 1.7), "cut_angle_deg": (1.0, 2.0)}


@dataclass(frozen=True)
class PriorForecast:
    """The tip of a planned needle over draws of all that is not known of it."""

    tips: Floats  #: (B, 3) in the constraint frame, mm, of draws that can be solved
    target: Floats  #: (3,), mm: as stated, or the median of the tips
    hits: float  #: share of the tips within the radius about the target
    #: by parameter, and error of the pose, ends of 95 % of its draws (Pa, mm, degrees)
    priors: Mapping[str, tuple[float, float]]
    shares: Mapping[str, float]  #: by the same, its squared rank correlation with the deflection of the tip
    failed: int  #: draws that cannot be solved
    outside: int  #: tips of needles outside what the model assumes

    def interval(self, axis: int) -> tuple[float, float, float]:
        """Return median and ends of the 95 % interval of a coordinate of the tip, mm."""
        low, median, high = np.quantile(self.tips[:, axis], [0.025, 0.5, 0.975])
        return float(median), float(low), float(high)


def list_published(names: str) -> list[PublishedRange]:
    """Return the published moduli of media by their names, as `gelatine,liver`; none if it names others."""
    published = read_moduli()
    parts = [part.strip().lower() for part in names.split(",")]
    return [published[part] for part in parts] if all(part in published for part in parts) else []


def describe_published(moduli: Sequence[PublishedRange], layers: int, advance: Advance) -> MediumRecord:
    """Return a tissue model of published moduli: one of each layer, or one of all.

    The range that a source states is taken for 95 % of a lognormal prior. ConfigError if neither fits.
    """
    if len(moduli) not in (1, layers):
        raise ConfigError(
            f"{len(moduli)} media are named, and the scene has {layers} layers",
            expected="one medium for all layers, or one for each, from the entry on",
            fix="name as many, as in --medium gelatine,liver",
        )
    parameters: dict[str, object] = {}
    for n, modulus in enumerate(list(moduli) * (layers if len(moduli) == 1 else 1), start=1):
        low, high = modulus.shear_pa
        prior = {"median": math.sqrt(low * high), "factor": (high / low) ** (0.5 / NORMAL_95_HALF_WIDTH_SD)}
        parameters[f"mu{n}_pa"] = {"bounds": MODULUS_BOUNDS_PA, "prior": prior}
    bevel = "cut_angle_deg" if advance == "path_angle" else "bevel_mm"
    median, factor = BEVEL_PRIORS[bevel]
    parameters[bevel] = {"bounds": BEVEL_BOUNDS[bevel], "prior": {"median": median, "factor": factor}}
    table = {"schema": MediumRecord.SCHEMA, "layers": layers, "advance": advance, "parameters": parameters}
    return MediumRecord.model_validate(table)


def forecast_by_prior(
    scene: Scene,
    medium: MediumRecord,
    radius: float,
    target: Sequence[float] | None = None,
    seed: int = 1,
    pose_sds: tuple[float, float] = (0.0, 0.0),
) -> PriorForecast:
    """Predict the tip of a scene by draws of all parameters of a tissue model from their prior.

    `radius`, mm, about the target counts as a hit. `pose_sds`: standard deviations of the entry point, mm,
    and of the direction there, degrees, in each of both directions across. ConfigError if the scene has more
    layers than the model, ModelError if no draw can be solved.
    """
    if scene.tissue.layers > medium.layers:
        raise ConfigError(
            f"the scene has {scene.tissue.layers} layers, the tissue model {medium.layers}",
            expected="at most as many",
            fix="name another tissue model",
        )
    parameters = Parameters.from_record(medium)
    rng = random_stream(seed, "before data")
    sets = [parameters.values(theta) for theta in draw_from_prior(parameters, DRAWS, rng)]
    exact = np.zeros((DRAWS, scene.tissue.layers))
    simulated = simulate_scene_draws(sets, medium, scene, np.array([scene.depth]), exact[:, 0], exact[:, 1:])
    tips = simulated.points[simulated.solved][:, 0].copy()
    if not len(tips):
        raise ModelError(
            "no draw of the parameters can be solved for this scene",
            fix="lessen its depth, or narrow the priors of the tissue model",
        )
    pose = random_stream(seed, "pose before data").standard_normal((2, DRAWS, 2))[:, simulated.solved]
    terms = zip((POSE_SHIFT, POSE_ANGLE), pose_sds, pose, strict=True)
    errors = {name: sd * deviations for name, sd, deviations in terms if sd}
    tips[:, 1:] += errors.get(POSE_SHIFT, 0.0) + np.radians(errors.get(POSE_ANGLE, 0.0)) * tips[:, :1]
    aim = np.median(tips, axis=0) if target is None else np.array([*target, 0.0][:3])
    table = {name: values[simulated.solved] for name, values in tabulate_sets(sets).items()}
    free = [name for name in parameters.free if np.ptp(table[name]) > 0]
    drawn = {name: table[name] for name in free} | errors
    return PriorForecast(
        tips,
        aim,
        hits=float(np.mean(np.linalg.norm(tips - aim, axis=1) <= radius)),
        priors={name: tuple(np.quantile(values, [0.025, 0.975]).tolist()) for name, values in drawn.items()},
        shares=_share_variance(drawn, tips[:, 1:]),
        failed=len(sets) - len(tips),
        outside=int(np.sum(~simulated.valid[simulated.solved])),
    )


def _share_variance(table: Mapping[str, Floats], across: Floats) -> dict[str, float]:
    """Return the squared rank correlation of each parameter with tips (B, 2), greatest first.

    Tips, and what is drawn across the needle (B, 2), are taken along the direction in which tips spread most.
    Draws are independent, so that the shares add up to 1 where the tip depends on each monotonically.
    """
    direction = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)[2][0]
    tip = np.argsort(np.argsort(across @ direction))
    along = {name: values if values.ndim == 1 else values @ direction for name, values in table.items()}
    ranks = {name: np.argsort(np.argsort(values)) for name, values in along.items()}
    shares = {name: float(np.corrcoef(rank, tip)[0, 1] ** 2) for name, rank in ranks.items()}
    return dict(sorted(shares.items(), key=lambda pair: -pair[1]))
