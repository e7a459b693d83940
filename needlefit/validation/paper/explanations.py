"""Claims of the paper about averages, and about what makes an error-to-deflection percentage large."""

from needlefit.validation.paper.claims import Claim, Tables, rows
from needlefit.validation.paper.counts import phantom2


def maximum_called_average(t: Tables) -> Claim:
    """Which column the largest average IPE of the text stands in."""
    layers, media = rows(t, "tuning_by_layers"), rows(t, "tuning_by_media")
    mean, peak = (
        f"{max(r[column] for r in layers):.2f} mm and {max(r[column] for r in media):.2f} mm"
        for column in ("ipe_mean_mm", "ipe_max_mm")
    )
    said = "0.62 mm and 0.60 mm"
    return Claim(
        "Largest average IPE by layers and by media",
        "Section V.A",
        said,
        "Table III",
        f"{mean} under IPE; {peak} stand under Max IPE",
        mean == said,
        "Meant is the average over insertions of each one's maximum.",
    )


def halves(t: Tables) -> Claim:
    """Whether phantom 2's mean IPE by media is the mean of its rows by layers."""
    counts = phantom2(t)
    by_layers = rows(t, "tuning_by_layers")
    ipe, te = (
        sum(counts[r["layers"]] * r[column] for r in by_layers) / sum(counts.values())
        for column in ("ipe_mean_mm", "te_mm")
    )
    printed = rows(t, "tuning_by_media", medium="phantom2")[0]
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


def deeper(t: Tables) -> Claim:
    """Whether EDP falls with depth."""
    edp = {r["layers"]: r["edp_percent"] for r in rows(t, "tuning_by_layers")}
    depth = {r["layers"]: r for r in rows(t, "insertions", medium="phantom2")}
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


def chicken_depth(t: Tables) -> Claim:
    """Whether chicken insertions are shallow."""
    chicken = rows(t, "insertions", medium="chicken")[0]["depth_max_mm"]
    phantoms = max(r["depth_max_mm"] for r in rows(t, "insertions") if r["medium"] != "chicken")
    return Claim(
        "Why chicken has a large EDP",
        "Section V.A",
        "shallower insertions",
        "Table I",
        f"chicken down to {chicken:.2f} mm, no phantom deeper than {phantoms:.2f} mm",
        chicken < phantoms,
        "Deflections are small there, but not for want of depth.",
    )


def edp_everywhere(t: Tables) -> Claim:
    """Whether every study has an EDP above 100 %."""
    largest: dict[int, float] = {}
    for row in rows(t, "validation"):
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


def edp_two_layers(t: Tables) -> Claim:
    """Whether the two-layer insertion of study 1 has an EDP above 100 %."""
    edp = rows(t, "validation", study=1, validate_layers=2)[0]["edp_percent"]
    return Claim(
        "EDP above 100 % in study 1",
        "Section V.B",
        "the two- and one-layer insertions",
        "Table IV",
        f"two layers {edp:g} %",
        edp > 100,
    )


def edp_depth(t: Tables) -> Claim:
    """Whether the insertions with the larger EDP of studies 3 and 4 are shallow."""
    row = rows(t, "validation", study=3)[0]
    group = rows(t, "insertions", medium=row["validate_medium"])[0]
    others = [r["depth_min_mm"] for r in rows(t, "insertions") if r["medium"] != group["medium"]]
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
