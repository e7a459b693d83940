"""Check the paper's claims: counts of insertions, averages, and explanations of a large EDP."""

from needlefit.studies.paper.claims import Claim, PublishedTables, select_rows


def check_four_and_three_layers(t: PublishedTables) -> Claim:
    """Check how many insertions crossed four and three layers of phantom 2."""
    listed = count_phantom2(t)
    validated = {
        r["validate_layers"]: r["validate_insertions"] for r in select_rows(t, "study_design", study=2)
    }
    return Claim(
        "Four- and three-layer insertions of phantom 2",
        "Table I (and study 1 in Table II)",
        f"{listed[4]} + {listed[3]}",
        "study 2 in Table II",
        f"{validated[4]} + {validated[3]}",
        (listed[4], listed[3]) == (validated[4], validated[3]),
        "One insertion ends at the boundary; it carries both readings, and a study states which it uses.",
    )


def check_tuning_count(t: PublishedTables) -> Claim:
    """Check how many four-layer insertions tune phantom 2."""
    first, fourth = _count_tuned(t, 1), _count_tuned(t, 4)
    one, four = ({**select_rows(t, "parameters", set=name)[0], "set": ""} for name in ("study1", "study4"))
    return Claim(
        "Four-layer insertions that tune phantom 2",
        "study 1 in Table II",
        f"{first}",
        "study 4 in Table II",
        f"{fourth}",
        first == fourth,
        "Table V gives both studies the same parameters." if one == four else "",
    )


def check_chicken_counts(t: PublishedTables) -> Claim:
    """Check how twelve insertions are divided among three pieces of chicken."""
    total = select_rows(t, "insertions", medium="chicken")[0]["insertions"]
    study = select_rows(t, "study_design", study=5)[0]
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


def check_tuning_insertions(t: PublishedTables) -> Claim:
    """Check whether studies 2 and 3 are tuned on several insertions or on one."""
    second, third = _count_tuned(t, 2), _count_tuned(t, 3)
    return Claim(
        "What tunes studies 2 and 3",
        "Section IV.B",
        "two-layer insertions and insertions across three layers",
        "Table II",
        f"{second} insertion and {third} insertion, of {count_phantom2(t)[3]} with three layers",
        second > 1 and third > 1,
        "Which three-layer insertion was taken is not stated.",
    )


def check_table_numbers(t: PublishedTables) -> Claim:
    """Check which tables the rows of the parameter table refer to."""
    return Claim(
        "Which tables the parameter sets belong to",
        "Table V",
        "tables 4, 5 and 6 (Ph2 T4, Ph1 T5, Ch T6 St5, ...)",
        "the paper",
        "five tables: tuning errors by layers and by media are one (III), validation is IV",
        False,
        "Read as: T4 tuning by layers, T5 tuning by media, T6 validation.",
    )


def count_phantom2(t: PublishedTables) -> dict[int, int]:
    """Return the number of insertions into phantom 2 by number of layers."""
    return {int(r["layers"]): int(r["insertions"]) for r in select_rows(t, "insertions", medium="phantom2")}


def _count_tuned(t: PublishedTables, study: int) -> int:
    return int(select_rows(t, "study_design", study=study)[0]["tune_insertions"])


def check_largest_average(t: PublishedTables) -> Claim:
    """Check in which column the largest average IPE of the text stands."""
    layers, media = select_rows(t, "tuning_by_layers"), select_rows(t, "tuning_by_media")
    mean, peak = (
        f"{max(r[column] for r in layers):.2f} mm and {max(r[column] for r in media):.2f} mm"
        for column in ("ipe_mean_mm", "ipe_max_mm")
    )
    statement = "0.62 mm and 0.60 mm"
    return Claim(
        "Largest average IPE by layers and by media",
        "Section V.A",
        statement,
        "Table III",
        f"{mean} under IPE; {peak} stand under Max IPE",
        mean == statement,
        "Meant is the average over insertions of each one's maximum.",
    )


def check_table_halves(t: PublishedTables) -> Claim:
    """Check whether phantom 2's mean IPE by media is the mean of its rows by layers."""
    counts = count_phantom2(t)
    by_layers = select_rows(t, "tuning_by_layers")
    ipe, te = (
        sum(counts[r["layers"]] * r[column] for r in by_layers) / sum(counts.values())
        for column in ("ipe_mean_mm", "te_mm")
    )
    printed = select_rows(t, "tuning_by_media", medium="phantom2")[0]
    return Claim(
        f"Mean IPE over the {sum(counts.values())} insertions of phantom 2",
        "the lower half of Table III",
        f"{printed['ipe_mean_mm']:.2f} mm",
        "its upper half",
        f"rows by layers with the mean {ipe:.3f} mm over {' + '.join(map(str, counts.values()))} insertions "
        f"(their mean TE, {te:.3f} mm, does give the {printed['te_mm']:.2f} mm printed)",
        abs(ipe - printed["ipe_mean_mm"]) <= 0.01,  # half a digit in the cells averaged, half in their mean
        "The parameters are the same; the difference is more than rounding.",
    )


def check_edp_falls_with_depth(t: PublishedTables) -> Claim:
    """Check whether EDP falls with depth."""
    edp = {r["layers"]: r["edp_percent"] for r in select_rows(t, "tuning_by_layers")}
    depth = {r["layers"]: r for r in select_rows(t, "insertions", medium="phantom2")}
    four, three = (
        f"{edp[n]:g} % at {depth[n]['depth_min_mm']:.2f} to {depth[n]['depth_max_mm']:.2f} mm" for n in (4, 3)
    )
    return Claim(
        "EDP and depth",
        "Section V.A",
        "smaller for deeper insertions",
        "Tables I and III",
        f"four layers {four}, three layers {three}",
        edp[4] < edp[3],
    )


def check_chicken_depth(t: PublishedTables) -> Claim:
    """Check whether chicken insertions are shallow."""
    chicken = select_rows(t, "insertions", medium="chicken")[0]["depth_max_mm"]
    phantoms = max(r["depth_max_mm"] for r in select_rows(t, "insertions") if r["medium"] != "chicken")
    return Claim(
        "Why chicken has a large EDP",
        "Section V.A",
        "shallower insertions",
        "Table I",
        f"chicken down to {chicken:.2f} mm, no phantom deeper than {phantoms:.2f} mm",
        chicken < phantoms,
        "Deflections are small there, but not for want of depth.",
    )


def check_edp_everywhere(t: PublishedTables) -> Claim:
    """Check whether every study has an EDP above 100 %."""
    largest: dict[int, float] = {}
    for row in select_rows(t, "validation"):
        largest[row["study"]] = max(row["edp_percent"], largest.get(row["study"], 0.0))
    below = [f"study {study} has at most {edp:g} %" for study, edp in largest.items() if edp <= 100]
    return Claim(
        "EDP above 100 %",
        "Section V.B",
        "across all studies",
        "Table IV",
        "; ".join(below) or "every study has one",
        not below,
    )


def check_edp_two_layers(t: PublishedTables) -> Claim:
    """Check whether the two-layer insertion of study 1 has an EDP above 100 %."""
    edp = select_rows(t, "validation", study=1, validate_layers=2)[0]["edp_percent"]
    return Claim(
        "EDP above 100 % in study 1",
        "Section V.B",
        "the two- and one-layer insertions",
        "Table IV",
        f"two layers {edp:g} %",
        edp > 100,
    )


def check_edp_depth(t: PublishedTables) -> Claim:
    """Check whether the insertions with the larger EDP of studies 3 and 4 are shallow."""
    row = select_rows(t, "validation", study=3)[0]
    group = select_rows(t, "insertions", medium=row["validate_medium"])[0]
    others = [r["depth_min_mm"] for r in select_rows(t, "insertions") if r["medium"] != group["medium"]]
    implied = 100 * row["te_mm"] / row["edp_percent"]
    return Claim(
        "Why EDP exceeds 100 %",
        "Section V.B",
        "shallower insertions",
        "Tables I and IV",
        f"study 3 has {row['edp_percent']:g} % at {group['depth_min_mm']:.2f} to "
        f"{group['depth_max_mm']:.2f} mm; every other group begins shallower ({max(others):.2f} mm at most)",
        group["depth_min_mm"] < max(others),
        f"TE / EDP implies a deflection of {implied:.1f} mm there: small, but not for want of depth.",
    )
