"""What `validate` prints for people: our row and the paper's, one below the other, then the rivals."""

from typing import TYPE_CHECKING

from needlefit.cli import screen

if TYPE_CHECKING:
    from needlefit.validation.results import Results

_PAIRED = {
    "rival": "rival",
    "ipe_mean_mm": "IPE mm",
    "te_mm": "TE mm",
    "difference_mm": "ΔIPE mm",
    "difference_se_mm": "s.e. mm",
    "better": "fit better on",
    "insertions": "of",
}


def show_validation(results: "Results") -> None:
    """Print the validation table of one study, then the rivals on the same insertions and points.

    A fit scores nothing but its own insertions: of it only its name and the data are printed.
    """
    from needlefit.reporting.contest import rivals_said
    from needlefit.reporting.foretold import foretold_layout
    from needlefit.reporting.layouts import validation_layout
    from needlefit.reporting.names import rival_name
    from needlefit.validation.summary import paired

    show_head(results)
    if (results.errors["role"] == "tune").all():
        return
    screen.show_display(validation_layout([results]))
    rivals = paired(results)
    table = rivals.assign(rival=[rival_name(str(rival), results) for rival in rivals["rival"]])
    table = table[list(_PAIRED)].round(3).rename(columns=_PAIRED)
    screen.show_frame(
        table, "Rivals on the same held-out insertions and points; ΔIPE is the rival's IPE minus the fit's."
    )
    screen.say(rivals_said(results))
    if len(results.predictive):
        screen.show_display(foretold_layout(results))


def show_head(results: "Results") -> None:
    """Print what this is, what the data are, and what failed, in words that a reader cannot miss."""
    from needlefit.reporting.posterior import unconverged_said
    from needlefit.reporting.sentences import failures_said, validity_said

    screen.say(f"{results.name}: {results.title}" if results.title else results.name)
    if results.origin == "synthetic":
        screen.say(f"  SYNTHETIC data ({results.dataset_title}): consistency, no evidence for the model")
    else:
        screen.say(f"  measured data: {results.dataset_title}")
    if results.interrupted:
        screen.say("  INTERRUPTED: the best found so far")
    for said in (failures_said(results), validity_said(results), unconverged_said(results)):
        if said:
            screen.say(f"  {said}")
