"""`needlefit material`: what a compression test says of alpha and mu."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from needlefit.cli import options, screen


def material(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(metavar="FILE.csv", help="Stretch and stress; data/README.md lists the columns.")
    ],
    stress: Annotated[
        Literal["nominal", "true"] | None,
        typer.Option(help="What a column `stress_kpa` holds whose name does not say it."),
    ] = None,
    foundation: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="FACTOR SPREAD",
            help="Write a prior of the model's mu too: FACTOR times the material's shear modulus, known "
            "within a factor of SPREAD. docs/model.md says between which bounds FACTOR lies.",
        ),
    ] = None,
    out: options.Out = Path("reports"),
    json: options.Json = False,
    verbose: options.Verbose = False,
) -> None:
    """Fit mu and alpha of the Ogden law to a compression test.

    Shapes of needles cannot tell alpha; a test can. Says over which alphas it cannot either, and writes the
    prior that fits use, with tables and figure, to OUT/material-<file>/.
    """
    from needlefit.datasets.compression import read_compression
    from needlefit.inference.material import MaterialFoundation, fit_material
    from needlefit.project.ownership import require_replaceable
    from needlefit.reporting.material import (
        MaterialReport,
        lay_out_material,
        material_to_json,
        write_material,
    )
    from needlefit.reporting.material_tables import summarize_material
    from needlefit.schemas.names import require_file_name

    require_file_name(file.stem, str(file))
    name = f"material-{file.stem}"
    require_replaceable(out / name)
    stated = None if foundation is None else MaterialFoundation(*foundation)
    test = read_compression(file, stress)
    report = MaterialReport(name, test, fit_material(test), stated)
    write_material(report, out / name)
    if json:
        screen.show_json(material_to_json(report))
        return
    screen.show_display(lay_out_material(report))
    for sentence in (*test.warnings, *summarize_material(report.material, stated)):
        screen.print_line(f"{sentence[:1].upper()}{sentence[1:].removesuffix('.')}.")
    if report.material.alpha_identified:
        screen.print_line(f'For layer 1 of a fit: priors = {{ 1 = "{out / name}/prior.toml" }}')
    screen.print_line(f"written: {out / name}/")
