"""A study of tip tracks -> a folder of files, complete or not there at all."""

from pathlib import Path

from needlefit.inference.sampling.posterior import save
from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.document import Document, compile_pdf
from needlefit.reporting.figures.tracks import draw_tracks
from needlefit.reporting.files import write_csv, write_json
from needlefit.reporting.tracks.layouts import (
    coverage_layout,
    depths_layout,
    parameters_layout,
    scores_layout,
)
from needlefit.reporting.tracks.said import in_short
from needlefit.validation.tracks.results import (
    TrackResults,
    compare_methods_by_run,
    posterior_file,
    store_tracks,
    tabulate_by_depth,
    tabulate_coverage,
)

_CAPTION = (
    "Tip readings (points; hollow: they say how the run lies in the tracker’s frame) and what was foretold "
    "of them: the fitted model’s median with 50 and 95 % bands (blue), a straight line (grey) and a parabola "
    "(green). Below each: the guide’s place on the way to each reading, mm. Bands may leave the panels."
)


def write_tracks(results: TrackResults, folder: Path) -> Path:
    """Write tables, figure, posteriors and report to `folder`, replacing an earlier result there.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        frames = {"runs": results.runs, "parameters": results.parameters}
        frames |= {"paired": compare_methods_by_run(results), "coverage": tabulate_coverage(results)}
        frames["depths"] = tabulate_by_depth(results)
        for name, frame in frames.items():
            write_csv(frame.assign(origin=results.origin), new / f"{name}.csv")
        for fit, posterior in results.posteriors.items():
            save(posterior, new / posterior_file(fit))
        drawn = draw_tracks(results.readings.assign(origin=results.origin), new / "readings.pdf")
        (new / "report.pdf").write_bytes(compile_pdf(_story(results, drawn)))
        store_tracks(results, new)
        write_json(new / "run.json", results.run | {"not_converged": list(results.faults)})
        write_json(new / "timing.json", results.timing)
    return folder


def _story(results: TrackResults, drawn: Path) -> Document:
    synthetic = results.origin == "synthetic"
    blocks = (
        *(document.warning(f"NOT CONVERGED: {fault}.") for fault in results.faults),
        *document.warnings_in(results.run, results.name),
        document.text(results.record.question),
        document.bullets([*in_short(results), *results.remarks]),
        document.heading("Runs foretold"),
        document.table(scores_layout(results), synthetic),
        document.table(depths_layout(results), synthetic),
        document.table(coverage_layout(results), synthetic),
        document.figure(drawn, _CAPTION, synthetic),
        document.heading("What was learned"),
        document.table(parameters_layout(results), synthetic),
        document.heading("What was assumed"),
        document.bullets([one for one in (results.record.note, *results.notes) if one]),
    )
    return Document(results.title, f"{results.name} · {results.dataset_title}", synthetic, blocks)
