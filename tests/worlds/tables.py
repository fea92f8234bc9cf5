"""Verdicts as Markdown tables, and the requirements as lines that pass or fail."""

from collections import Counter

from score import TOLD, interval

BINS = ((0.0, 0.5), (0.5, 0.75), (0.75, 0.9), (0.9, 0.95), (0.95, 0.99), (0.99, 1.0001))


def share(hits, count, digits=0):
    return f"{100 * hits / count:.{digits}f}" if count else "-"


def row(name, some):
    """One class."""
    clear = [v for v in some if v.clear >= 3]
    claimed = [v for v in some if v.claimed]
    judged, held = sum(v.judged for v in some), sum(v.held for v in some)
    forces = [v for v in some if v.force_held is not None]
    low, high = interval(held, judged)
    codes = Counter(v.code for v in some if not v.claimed)
    refused = ", ".join(f"{code} {count}" for code, count in codes.most_common())
    return (
        f"| {name} | {len(some)} | {share(len(claimed), len(some))} | {share(sum(v.claimed for v in clear), len(clear))} of {len(clear)} "
        f"| {share(held, judged, 1)} ({100 * low:.0f} to {100 * high:.0f}) of {judged} | {share(sum(v.force_held for v in forces), len(forces))} "
        f"| {sum(bool(v.wrong) and v.told for v in some)} | {sum(bool(v.intruders) for v in some)} | {refused} |"
    )


def by_class(verdicts):
    names = list(dict.fromkeys(v.name for v in verdicts))
    lines = [
        f"| class | records | identified % | of those with three clear modes % | frequencies held % | N held % | wrong orders told at {TOLD} | foreign peaks | refused |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [row(name, [v for v in verdicts if v.name == name]) for name in names]
    with_rod = [v for v in verdicts if v.has_rod]
    return lines + ([row("all with a rod", with_rod)] if with_rod else [])


def stated(verdicts, low, high):
    """If right, for each probability stated between the limits: of orders that were told, and of the likeliest assignments of records that
    were refused with it."""
    told = [v.right for v in verdicts if v.claimed and v.probability is not None and low <= v.probability < high]
    refused = [v.candidate[1] for v in verdicts if v.code == "no-label" and v.candidate and low <= v.candidate[0] < high]
    return told, refused


def calibration(verdicts):
    """Stated probability of the labels against the share that is right."""
    lines = ["| stated | told | right % | likeliest assignment of a refused record | right % |", "|---|---|---|---|---|"]
    for low, high in BINS:
        cells = []
        for some in stated(verdicts, low, high):
            ends = interval(sum(some), len(some))
            cells += [str(len(some)), f"{share(sum(some), len(some), 1)} ({100 * ends[0]:.0f} to {100 * ends[1]:.0f})" if some else "-"]
        if cells[0] != "0" or cells[2] != "0":
            lines.append(f"| {low} to {min(high, 1.0)} | {' | '.join(cells)} |")
    return lines


def requirements(verdicts, few=False):
    """(passes, sentence) for each requirement. Coverage of a class fails if even the favourable end of its interval does; with
    `few` records that holds for every share."""
    found = []

    def reaches(hits, count, wanted):
        return count > 0 and (interval(hits, count)[1] if few else hits / count) >= wanted

    def need(passes, text):
        found.append((bool(passes), text))

    rods = [v for v in verdicts if v.has_rod]
    for name in dict.fromkeys(v.name for v in rods):
        some = [v for v in rods if v.name == name]
        judged, held = sum(v.judged for v in some), sum(v.held for v in some)
        if judged:
            low, high = interval(held, judged)
            text = f"{name}: {share(held, judged, 1)} % of {judged} frequencies held ({100 * low:.0f} to {100 * high:.0f}), wanted 90 to 98"
            need(high >= 0.90 and low <= 0.98, text)
        else:
            need(few, f"{name}: no frequency to judge")
    if rods:
        judged, held = sum(v.judged for v in rods), sum(v.held for v in rods)
        low, high = interval(held, judged)
        text = f"all these: {share(held, judged, 1)} % of {judged} frequencies held ({100 * low:.1f} to {100 * high:.1f}), wanted 90 to 98"
        need(judged and high >= 0.90 and low <= 0.98, text)
        for least, wanted in ((3, 0.95), (5, 0.98)):
            some = [v for v in rods if v.clear >= least]
            hits = sum(v.claimed for v in some)
            text = f"{share(hits, len(some), 1)} % of {len(some)} records with {least} or more clear modes identified, wanted {100 * wanted:.0f}"
            need(reaches(hits, len(some), wanted), text)
        wrong = sum(bool(v.wrong) and v.told for v in rods)
        need(wrong <= 0.001 * len(rods), f"{wrong} of {len(rods)} with a true mode under a wrong order told at {TOLD}, wanted 1 in 1000")
        beside = [v for v in rods if v.intruders and not v.wrong]
        need(len(beside) <= 0.03 * len(rods) or (few and interval(len(beside), len(rods))[0] <= 0.03), f"{len(beside)} of {len(rods)} with a foreign peak beside right orders, wanted 30 in 1000")
        forces = [v for v in beside if v.force_held is not None]
        hits = sum(v.force_held for v in forces)
        need(not forces or interval(hits, len(forces))[1] >= 0.90, f"{hits} of the {len(forces)} forces beside foreign peaks held, wanted 90 %")
        forces = [v for v in rods if v.force_held is not None]
        hits = sum(v.force_held for v in forces)
        need(reaches(hits, len(forces), 0.90) and interval(hits, len(forces))[0] <= 0.98, f"{share(hits, len(forces), 1)} % of {len(forces)} forces held, wanted 90 to 98")
    for known, limit in ((False, 0.01), (True, 0.001)):
        some = [v for v in verdicts if not v.has_rod and v.known == known and v.name == "no-rod"]
        hits = sum(v.claimed for v in some)
        first = "when the rod is known" if known else "at first contact"
        # As many as chance allows where fewer records were made than the limit could show.
        need(not some or interval(hits, len(some))[0] <= limit, f"{hits} of {len(some)} records without a rod claimed {first}, wanted {limit}")
    some = [right for kind in stated(rods, 0.9, 0.95) for right in kind]
    if some:
        hits = sum(some)
        low, high = interval(hits, len(some))
        need(high >= 0.88 and low <= 0.97, f"{share(hits, len(some), 1)} % of {len(some)} that say 0.9 to 0.95 right, wanted 88 to 97")
    return found
