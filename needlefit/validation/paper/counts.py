"""Claims of the paper about how many insertions there are and what they tune."""

from needlefit.validation.paper.claims import Claim, Tables, rows


def four_and_three(t: Tables) -> Claim:
    """How many insertions crossed four and three layers of phantom 2."""
    listed = phantom2(t)
    validated = {r["validate_layers"]: r["validate_insertions"] for r in rows(t, "study_design", study=2)}
    return Claim(
        "Four- and three-layer insertions of phantom 2",
        "Table I (and study 1 in Table II)",
        f"{listed[4]} + {listed[3]}",
        "study 2 in Table II",
        f"{validated[4]} + {validated[3]}",
        (listed[4], listed[3]) == (validated[4], validated[3]),
        "One insertion ends at the boundary; it carries both readings, and a study states which it uses.",
    )


def tuning_count(t: Tables) -> Claim:
    """How many four-layer insertions tune phantom 2."""
    first, fourth = _tuned(t, 1), _tuned(t, 4)
    one, four = ({**rows(t, "parameters", set=name)[0], "set": ""} for name in ("study1", "study4"))
    return Claim(
        "Four-layer insertions that tune phantom 2",
        "study 1 in Table II",
        f"{first}",
        "study 4 in Table II",
        f"{fourth}",
        first == fourth,
        "Table V gives both studies the same parameters." if one == four else "",
    )


def chicken(t: Tables) -> Claim:
    """How twelve insertions fall on three pieces of chicken."""
    total = rows(t, "insertions", medium="chicken")[0]["insertions"]
    study = rows(t, "study_design", study=5)[0]
    tuned, rest = study["tune_insertions"], study["validate_insertions"]
    return Claim(
        "Chicken insertions",
        "Section IV.A",
        f"3 pieces, one of them punctured at 2 orientations, 3 × 4 = {total}",
        "study 5",
        f"{tuned} on the first piece and {rest} on the two others, {tuned} + {rest} = {tuned + rest}",
        3 * tuned == total,
        f"Three pieces of {total // 3} would leave {total - total // 3} to validate. "
        "Read as 3 insertions at each of 4 piece-orientations: pieces of 3, 3 and 6.",
    )


def plural(t: Tables) -> Claim:
    """Whether studies 2 and 3 are tuned on insertions or on one."""
    second, third = _tuned(t, 2), _tuned(t, 3)
    return Claim(
        "What tunes studies 2 and 3",
        "Section IV.B",
        "two-layer insertions and insertions across three layers",
        "Table II",
        f"{second} insertion and {third} insertion, of {phantom2(t)[3]} with three layers",
        second > 1 and third > 1,
        "Which three-layer insertion was taken is not said.",
    )


def table_numbers(t: Tables) -> Claim:
    """Which tables the rows of the parameter table refer to."""
    return Claim(
        "Which tables the parameter sets belong to",
        "Table V",
        "tables 4, 5 and 6 (Ph2 T4, Ph1 T5, Ch T6 St5, ...)",
        "the paper",
        "five tables: tuning errors by layers and by media are one (III), validation is IV",
        False,
        "Read as: T4 tuning by layers, T5 tuning by media, T6 validation.",
    )


def phantom2(t: Tables) -> dict[int, int]:
    """Return the insertions listed for phantom 2 by number of layers."""
    return {int(r["layers"]): int(r["insertions"]) for r in rows(t, "insertions", medium="phantom2")}


def _tuned(t: Tables, study: int) -> int:
    return int(rows(t, "study_design", study=study)[0]["tune_insertions"])
