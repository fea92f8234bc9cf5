"""Verdicts as Markdown tables."""

import math
import statistics
import sys
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent.parent / "worlds"))
from score import interval

import scenario
from verdicts import CHARTED

# What one false alarm in ten years means for the first charted year.
STATED = 0.088


def share(hits, count):
    """`6.0 (2.2 to 12.6)`, per cent with the exact 95 % interval."""
    if count == 0:
        return "-"
    low, high = interval(hits, count)
    return f"{100 * hits / count:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def days(values, count):
    """Median and 90 % of delays among `count` rods; `never` beyond those found."""
    ordered = sorted(values) + [None] * (count - len(values))
    if not ordered:
        return "-"
    at = lambda q: ordered[min(len(ordered) - 1, int(q * len(ordered)))]
    said = lambda value: "never" if value is None else f"{value:.0f}"
    return f"{said(at(0.5))} / {said(at(0.9))}"


def covered(rods):
    every = [one for rod in rods for one in rod.coverage]
    return share(sum(inside for _, inside, _, _ in every), len(every)) + f" of {len(every)}"


def stated_sd(rods):
    every = [sd for rod in rods for *_, sd in rod.coverage]
    return f"{100 * statistics.median(every):.2f}" if every else "-"


def sites_with(rods, kind, low, high):
    """How many sites told this kind at all within a stretch of days."""
    return len({rod.site for rod in rods if rod.told(kind, low, high) is not None})


def set_aside(rods):
    counts = Counter()
    for rod in rods:
        counts.update(rod.set_aside)
        counts["rejected"] += rod.rejected
    records = sum(rod.records for rod in rods)
    parts = [f"{reason} {100 * count / records:.2f}" for reason, count in counts.most_common() if count]
    return ", ".join(parts) or "-"


def late_onsets(sized):
    """The onset as last stated: held, and the width of its interval, median and 90 %."""
    if not sized:
        return "-"
    widths = sorted(rod.onset_widths[1] for rod in sized)
    at = lambda q: widths[min(len(widths) - 1, int(q * len(widths)))]
    return f"{share(sum(rod.onset_held_late for rod in sized), len(sized))}, {at(0.5):.1f} / {at(0.9):.1f}"


def without_change(name, rods, seconds):
    """One world in which nothing happens to any rod."""
    low, high = CHARTED
    kinds = ("limit", "suspected", "not-axial", "sensor", "no-data", "outside-training", "conflict")
    drifts = sum(rod.told("drift", low, high) is not None for rod in rods)
    confirmed = sum(any(low <= day < high for day in rod.confirmed) for rod in rods)
    sites = len({rod.site for rod in rods})
    others = ", ".join(
        f"{kind} {100 * count / len(rods):.0f}"
        for kind in kinds
        if (count := sum(rod.told(kind, low, high) is not None for rod in rods))
    )
    drifting = sites_with(rods, "drift", low, high)
    return (
        f"| {name} | {sites} x {len(rods) / sites:.1f} | {share(drifts, len(rods))} | {drifting} | {share(confirmed, len(rods))} "
        f"| {sites_with(rods, 'common', low, high)} | {others or '-'} | {covered(rods)} | {stated_sd(rods)} | {set_aside(rods)} | {seconds / len(rods):.2f} |"
    )


def with_change(name, rods, seconds):
    """One world in which the first rod of each site changes."""
    changed = [rod for rod in rods if rod.changes]
    others = [rod for rod in rods if not rod.changes]

    def found(kind):
        told = [(rod.told(kind, rod.change_day), rod.change_day) for rod in changed]
        return [day - since for day, since in told if day is not None]

    # A false drift before the change stands; what would have been told then cannot be seen.
    early = sum(rod.told("drift", high=rod.change_day) is not None for rod in changed)
    drift, limit = found("drift"), found("limit")
    confirmed = [min(late) - rod.change_day for rod in changed if (late := [day for day in rod.confirmed if day >= rod.change_day])]
    sized = [rod for rod in changed if rod.size_held is not None]
    states = Counter(rod.state + ("" if not rod.alarms else ": " + " ".join(rod.alarms)) for rod in changed)
    ends = ", ".join(f"{state} {count}" for state, count in states.most_common(4))
    stale = [rod.stale for rod in changed if rod.stale is not None]
    left = sum(rod.told("drift", rod.change_day) is not None for rod in others)
    return (
        f"| {name} | {len(changed)} | {early} | {share(len(drift), len(changed))} | {days(drift, len(changed))} | {days(confirmed, len(changed))} "
        f"| {len(limit)}: {days(limit, len(changed))} | {len(found('not-axial'))} | {share(sum(rod.size_held for rod in sized), len(sized))} "
        f"| {share(sum(rod.onset_held for rod in sized), len(sized))} | {late_onsets(sized)} | {covered(changed)} | {ends} | {max(stale, default=0):.0f} "
        f"| {share(left, len(others))} | {set_aside(changed)} |"
    )


def happening(name):
    """The change of the first rods of a world with one."""
    return scenario.event(name.partition("+")[2])[0]


def explanations(found):
    """What alarms said of the kind of change, world by world, and how many of those that named the force were wrong."""
    lines, named, wrong = [], 0, 0
    for name, every in found.items():
        rods = [rod for rod in every if rod.changes] if "+" in name else every
        is_force = "+" in name and happening(name).is_axial
        weighed, claims = sum(rod.weighed for rod in rods), sum(rod.claims_force for rod in rods)
        if not weighed and not claims:
            continue
        named, wrong = named + claims, wrong + (0 if is_force else claims)
        lines.append(f"| {name} | {len(rods)} | {weighed} | {claims} | {sum(rod.denies_force for rod in rods)} |")
    if not lines:
        return []
    head = [
        "",
        "What alarms said at any time after the change (where nothing changes, after two months); 5 % of those that name the force may be something else.",
        "",
        "| world | rods | with an alarm that weighs it | say the axial force, 20:1 | say not the force alone, 20:1 |",
        "|---|---|---|---|---|",
    ]
    return [*head, *lines, "", f"{wrong} of {named} that name the force are wrong: {share(wrong, named)} %"]


def report(found, seconds):
    """All worlds, first those in which nothing happens."""
    lines = []
    calm = [name for name in found if "+" not in name]
    if calm:
        lines += [
            f"First charted year (days {CHARTED[0]:.0f} to {CHARTED[1]:.0f}); {100 * STATED:.1f} % of rods with a false drift are stated. Kinds: % of rods that told them. "
            "Coverage: 95 % interval of the force at the reference temperature over that of the baseline, one look at day 120 and one at the end.",
            "",
            "| world | sites x rods | drift % | sites with drift | confirmed % | sites with `common` | other kinds % | covered % | sd % | set aside % | s a rod |",
            "|---|---|---|---|---|---|---|---|---|---|---|",
        ]
        lines += [without_change(name, found[name], seconds[name]) for name in calm]
        rods = [rod for name in calm for rod in found[name]]
        lines += ["", f"All {len(rods)} rods: covered {covered(rods)}", ""]
    eventful = [name for name in found if "+" in name]
    if eventful:
        lines += [
            "Something happens to the first rod of each site. Days: median / 90 % of the rods, from the change to the record that told it. Size and onset: their intervals ten "
            "days after the alarm; force: that at the reference temperature 60 days after the change. Figure: days by which the last one shown is behind the last record.",
            "",
            "| world | rods | drift before | drift % | days | confirmed days | limit: days | not-axial | size held % | onset held % | onset at last: held %, days wide | force covered % | at the end | figure | other rods drift % | set aside % |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
        ]
        lines += [with_change(name, found[name], seconds[name]) for name in eventful]
    return lines + explanations(found)


# Required of changes: share told within so many days.
WITHIN = {
    "benign+loss3": (0.5, 2),
    "benign+loss1": (0.5, 2),
    "full+loss1": (0.5, 5),
    "ar5+loss1": (0.5, 20),
    "harsh+loss3": (0.5, 5),
    "benign+late2": (0.5, 70),
    "full+late2": (0.5, 90),
    "benign+early3": (0.5, 5),
    "none+loss10": (0.5, 2),
    "none+loss20": (0.5, 2),
    "nonefull+loss20": (0.5, 2),
}
# Told within so many days of 3 % in any other world.
LOSS3_DAYS = 2
# Daily records come up to an hour early or late.
JITTER_DAYS = 0.1
# Worlds whose thermometer moves by itself: every rod follows, and the site says so once.
THERMOMETER = ("thdrift", "offset", "jump", "jumpfull")


def requirements(found):
    """(passes, sentence) for each requirement; a share fails if its exact 95 % interval excludes what is required."""
    lines = []

    def need(passes, text):
        lines.append((bool(passes), text))

    low, high = CHARTED
    calm = [name for name in found if "+" not in name]
    for name in calm:
        rods = found[name]
        sites = len({rod.site for rod in rods})
        drifts = sum(rod.told("drift", low, high) is not None for rod in rods)
        least = interval(drifts, len(rods))[0]
        if name in THERMOMETER:
            confirmed = sum(any(low <= day < high for day in rod.confirmed) for rod in rods)
            need(interval(confirmed, len(rods))[0] <= 0.025, f"{name}: {confirmed} of {len(rods)} rods with a confirmed drift, 2.5 % allowed")
            told = sites_with(rods, "common", low, high)
            need(interval(told, sites)[1] >= 0.9, f"{name}: {told} of {sites} sites with a notice, wanted all")
        else:
            need(least <= STATED, f"{name}: {drifts} of {len(rods)} rods with a false drift, {100 * STATED:.1f} % stated")
    every = []
    for name, rods in found.items():
        some = rods if "+" not in name else [rod for rod in rods if rod.changes and happening(name).is_axial]
        looks = [inside for rod in some for _, inside, _, _ in rod.coverage]
        every += looks
        if looks:
            need(interval(sum(looks), len(looks))[1] >= 0.90, f"{name}: {share(sum(looks), len(looks))} % of {len(looks)} changes since commissioning covered, wanted 90 or more")
    if every:
        least, most = interval(sum(every), len(every))
        need(most >= 0.93 and least <= 0.97, f"all: {share(sum(every), len(every))} % of {len(every)} changes since commissioning covered, wanted 93 to 97")
    for name in (name for name in found if "+" in name):
        change = happening(name)
        rods = [rod for rod in found[name] if rod.changes]
        wanted, within = WITHIN.get(name, (0.5, LOSS3_DAYS) if name.endswith("+loss3") else (None, None))
        if wanted is not None:
            hits = sum(rod.delay("drift") <= within + JITTER_DAYS for rod in rods)
            need(interval(hits, len(rods))[1] >= wanted, f"{name}: {hits} of {len(rods)} told within {within} days, wanted {100 * wanted:.0f} %")
        if name == "benign+early10":
            hits = sum(any(rod.is_told(kind, 0.0) for kind in ("suspected", "limit", "drift")) for rod in rods)
            need(interval(hits, len(rods))[1] >= 0.99, f"{name}: {hits} of {len(rods)} told with the first record, as `suspected` at least, wanted all")
            hits = sum(rod.is_told("drift", 1 + JITTER_DAYS) for rod in rods)
            need(interval(hits, len(rods))[1] >= 0.99, f"{name}: {hits} of {len(rods)} told as `drift` within a day of the first record, wanted all")
        if change.is_of_all:
            sites = len({rod.site for rod in rods})
            told = sites_with(rods, "common", change.day, math.inf)
            need(interval(told, sites)[1] >= 0.99, f"{name}: {told} of {sites} sites with a notice, wanted all")
            confirmed = sum(any(day >= rod.change_day for day in rod.confirmed) for rod in rods)
            need(interval(confirmed, len(rods))[0] <= 0.025, f"{name}: {confirmed} of {len(rods)} rods with a confirmed drift, 2.5 % allowed")
            if change.step <= -0.2:
                stands = sum("limit" in rod.alarms for rod in rods)
                need(interval(stands, len(rods))[1] >= 0.99, f"{name}: `limit` stands at the end for {stands} of {len(rods)} rods, wanted all")
        elif change.step <= -0.03:
            hits = sum(rod.delay("drift") < math.inf or rod.delay("limit") < math.inf for rod in rods)
            need(interval(hits, len(rods))[1] >= 0.99, f"{name}: {hits} of {len(rods)} found, wanted all")
        if change.step <= -0.4:
            hits = sum(rod.is_told("limit", 1 + JITTER_DAYS) for rod in rods)
            need(interval(hits, len(rods))[1] >= 0.99, f"{name}: {hits} of {len(rods)} told as `limit` within a day of the first record, wanted all")
        if change.is_axial:
            wrong, said = sum(rod.denies_force for rod in rods), "not the force alone"
        else:
            wrong, said = sum(rod.claims_force for rod in rods), "the axial force"
        need(interval(wrong, len(rods))[0] <= 0.05, f"{name}: {wrong} of {len(rods)} say wrongly {said}, 20:1; 1 in 20 allowed")
        sized = [rod for rod in rods if rod.size_held is not None]
        if change.step and not change.again and change.day > 40 and sized:
            for what, hits in (
                ("sizes", sum(rod.size_held for rod in sized)),
                ("onsets", sum(rod.onset_held for rod in sized)),
                ("onsets, as last stated,", sum(rod.onset_held_late for rod in sized)),
            ):
                need(interval(hits, len(sized))[1] >= 0.90, f"{name}: {share(hits, len(sized))} % of {len(sized)} {what} covered, wanted 90 or more")
    return lines
