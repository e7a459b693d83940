"""What a compression test says of a material: for the screen, as files, and as the prior of a layer."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.compression import CompressionTest
from needlefit.datasets.formats.toml import dumps
from needlefit.inference.material import MaterialEstimate, MaterialFoundation, make_material_prior
from needlefit.inference.specimen_fit import ALPHA_RANGE, SpecimenFit
from needlefit.project.atomic_write import replace_folder
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.figures.material import draw_curves, draw_profiles
from needlefit.reporting.files import write_csv, write_json
from needlefit.reporting.material_said import prior_note, summary, verdict
from needlefit.reporting.material_tables import curves, profiles, table
from needlefit.reporting.numbers import number
from needlefit.validation.provenance import package_versions

_PACKAGES = ("numpy", "scipy")
_NOTES = (
    "μ is the material's shear modulus, not the model's foundation modulus. “r” is the correlation of "
    "neighbouring residuals, “worth” the independent points that are left of n for it.",
)


@dataclass(frozen=True)
class Report:
    """One test and what came out of it; `foundation` is what the user states of the model's mu."""

    name: str
    test: CompressionTest
    material: MaterialEstimate
    foundation: MaterialFoundation | None = None


def layout(report: Report) -> Display:
    """Return the table of specimens."""
    columns = (
        *(text("Specimen"), Column("n"), Column("Stretch to"), Column("μ", "kPa"), Column("α")),
        *(text("95 % of α"), Column("Residual", "%"), Column("r"), Column("Worth"), text("α is")),
    )
    rows = tuple(_cells(fit) for fit in report.material.fits)
    measure = report.test.measure
    caption = f"One-term Ogden solid fitted to {measure} stress in uniaxial compression."
    return Display("material", caption, columns, rows, (), (), _NOTES)


def write_material(report: Report, folder: Path) -> list[Path]:
    """Write table, curves, profiles and prior to `folder`, replacing an earlier result there.

    Returns the files; beside the tables of curves and profiles lie their figures. `prior.toml` is written
    only if some specimen identifies alpha.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    material = report.material
    with replace_folder(folder) as new:
        write_csv(pd.DataFrame(table(material)), new / "material.csv")
        draw_curves(report.test.measure, curves(material), new / "curves.pdf")
        draw_profiles(profiles(material), new / "profiles.pdf")
        if material.alpha_identified:
            (new / "prior.toml").write_text(prior_file(report), encoding="utf-8")
        write_json(new / "material.json", as_json(report))
        write_json(new / "run.json", provenance(report))
    return sorted(folder.iterdir())


def as_json(report: Report) -> dict[str, Any]:
    """Return the result for machines."""
    said = [*summary(report.material, report.foundation), *report.test.warnings]
    prior = _prior_tables(report) if report.material.alpha_identified else None
    return {"name": report.name, "summary": said, "specimens": table(report.material), "prior": prior}


def provenance(report: Report) -> dict[str, Any]:
    """Return what a reader needs to repeat the fit; no time and no path."""
    return {
        "name": report.name,
        "versions": package_versions(_PACKAGES),
        "file": report.test.path.name,
        "sha256": report.test.digest,
        "columns": list(report.test.columns),
        "measure": report.test.measure,
        "law": "ogden, one term, incompressible: energy 2 mu / alpha^2 (sum lambda^alpha - 3)",
        "alpha_range": list(ALPHA_RANGE),
        "foundation": None if report.foundation is None else asdict(report.foundation),
        "warnings": list(report.test.warnings),
    }


def prior_file(report: Report) -> str:
    """Return the text of `prior.toml`."""
    head = [
        "# What a compression test says of one layer. A fit or study takes it, here for layer 1, by",
        '#     priors = { 1 = "the/path/of/this/file/prior.toml" }',
    ]
    tables = {"schema": 1, "title": report.test.path.name, "note": prior_note(report.material)}
    tables |= {"sha256": report.test.digest, **_prior_tables(report)}
    return "\n".join(head) + "\n" + dumps(tables)


def _prior_tables(report: Report) -> dict[str, Mapping[str, Any]]:
    alpha, mu = make_material_prior(report.material, report.foundation)
    stated = {"alpha": alpha} if mu is None else {"alpha": alpha, "mu_pa": mu}
    return {name: one.model_dump(exclude_defaults=True) for name, one in stated.items()}


def _cells(fit: SpecimenFit) -> tuple[str, ...]:
    size = float(np.max(np.abs(fit.specimen.stress)))
    ranges = " or ".join(f"{low:.2f} to {high:.2f}" for low, high in fit.profile.regions)
    return (
        *(fit.specimen.name, str(len(fit.residuals)), f"{fit.specimen.stretch.min():.3f}"),
        number(1e3 * fit.mu) if fit.identified else "–",
        f"{fit.alpha:.2f}".replace("-", "−") if fit.identified else "–",
        ranges.replace("-", "−"),
        f"{100 * fit.noise / size:.2g}",
        f"{fit.neighbour_correlation:.2f}",
        f"{fit.effective_points:.0f}",
        verdict(fit),
    )
