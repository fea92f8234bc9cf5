"""What `tirante track --json` said of one site, held against the truth."""

import math
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

DAY_S = 86400.0
# The first charted year: after two months, for a year.
CHARTED = (60.0, 425.0)
# A found change has had so long to be sized [days].
SIZED_AFTER = 10.0


@dataclass
class Rod:
    """One rod judged."""

    world: str
    site: int
    rod: str
    changes: bool
    # From which on its records show the change.
    change_day: float
    # Day of the first record that shows the change; infinite without one.
    first_day: float
    # Days since the first record's day on which alarms were raised, by kind, in the order they were told: (told, raised).
    raised: dict = field(default_factory=dict)
    confirmed: list = field(default_factory=list)
    records: int = 0
    set_aside: dict = field(default_factory=dict)
    rejected: int = 0
    # (day, truth inside, deviation in stated standard deviations, stated sd) of the change since commissioning.
    coverage: list = field(default_factory=list)
    size_held: bool = None
    onset_held: bool = None
    # The same as last told, weeks later; and the width of both intervals [days].
    onset_held_late: bool = None
    onset_widths: tuple = ()
    # Whether a drift says plainly that the axial force changed; whether an alarm says that it is not the force alone; whether any weighed it.
    claims_force: bool = False
    denies_force: bool = False
    weighed: bool = False
    state: str = ""
    alarms: tuple = ()
    # Days the figure shown at the end is behind the last record, and its error; None without a figure.
    stale: float = None

    def told(self, kind, low=-math.inf, high=math.inf):
        """The day on which this kind was first told within a stretch of days; none if it was not."""
        days = [day for day, _ in self.raised.get(kind, []) if low <= day < high]
        return min(days) if days else None


    def delay(self, kind):
        """Days from the change to the record that told this kind; infinite if none did."""
        day = self.told(kind, self.change_day)
        return math.inf if day is None else day - self.change_day

    def is_told(self, kind, days):
        """Whether this kind was told within some days of the first record that shows the change."""
        day = self.told(kind, self.change_day)
        return day is not None and day <= self.first_day + days


def day_of(start, text):
    return (datetime.fromisoformat(text.replace("Z", "+00:00")) - start).total_seconds() / DAY_S


def judge(site, index, lines):
    """The verdicts on a site's rods: `site` the truth (series.Site), `lines` the JSON objects of `tirante track`."""
    world = site.world
    start = site.start
    found = []
    for number, name in enumerate(site.names):
        changes = world.changes and number < world.change.rods
        own = [(day_of(start, line["start"]), line) for line in lines if line["rod"] == name]
        first = min((day for day, _ in own if day >= world.shown_day), default=math.inf)
        verdict = Rod(world.name, index, name, changes, world.shown_day, first, records=len(own))
        for day, line in own:
            if line.get("rejection"):
                verdict.rejected += 1
            if line.get("set_aside"):
                reason = line["set_aside"]
                verdict.set_aside[reason] = verdict.set_aside.get(reason, 0) + 1
            for event in line["events"]:
                if event["what"] == "raised":
                    verdict.raised.setdefault(event["kind"], []).append((day, day_of(start, event["time"])))
            if day >= (world.shown_day if changes else CHARTED[0]):
                verdict.claims_force |= any(map(claims_force, line["alarms"]))
                verdict.denies_force |= any(map(denies_force, line["alarms"]))
                verdict.weighed |= any(alarm.get("alternatives") for alarm in line["alarms"])
            if any(is_confirmed(alarm) for alarm in line["alarms"]):
                verdict.confirmed.append(day)
        shown = [(day, line) for day, line in own if line.get("relative_force_at_reference")]
        wanted = [at for at in (120.0, world.days - 0.5) if at < world.days]
        if changes:
            wanted = [world.shown_day + 60.0]
            if world.change.day < 1.0:
                wanted = [60.0, 120.0, 180.0, world.days - 0.5]
        for at in wanted:
            before = [(day, line) for day, line in shown if at - 7.0 < day <= at]
            if before:
                verdict.coverage.append(held(site, number, learned(site, number, verdict), *before[-1]))
        if own:
            last_day, last = own[-1]
            verdict.state = last["state"]
            verdict.alarms = tuple(sorted({alarm["kind"] for alarm in last["alarms"] if not alarm["cleared"]}))
            if shown:
                verdict.stale = last_day - shown[-1][0]
        if changes and world.change.is_axial:
            look_at_change(site, number, own, verdict)
        found.append(verdict)
    return found


def is_confirmed(alarm):
    """Whether a drift is one that the other rods confirm."""
    return alarm["kind"] == "drift" and alarm.get("witness") == "confirmed"


def claims_force(alarm):
    """Whether a drift names the axial force and nothing else that could be the cause."""
    return alarm["kind"] == "drift" and alarm["message"].startswith("the axial force")


def denies_force(alarm):
    """Whether the odds of an alarm are 20:1 or more against the axial force alone."""
    kinds = (alarm.get("alternatives") or {}).get("kinds", [])
    return any(one["kind"] == "force" and one["probability"] <= 1 / 21 for one in kinds)


def learned(site, number, verdict):
    """Days of the records of a rod's baseline: a change that is told while it is learned ends it."""
    days = site.records[number]["days"][: site.world.baseline]
    told = [day for kind in ("drift", "limit") for day, _ in verdict.raised.get(kind, [])]
    is_told = verdict.changes and any(site.world.change.day <= day < days[-1] for day in told)
    return days[days < site.world.change.day] if is_told else days


def truth(site, number, baseline, day, reference_c):
    """N over the mean N of the baseline's days, both at the reference temperature, without what fluctuates."""
    steady = float(site.steady(number, reference_c))
    if not site.world.changes or number >= site.world.change.rods:
        return 1.0
    change = site.world.change
    return (steady + float(change.at(day))) / (steady + float(change.at(baseline).mean()))


def held(site, number, baseline, day, line):
    stated = line["relative_force_at_reference"]
    real = truth(site, number, baseline, day, line["reference_temperature_c"])
    return (
        day,
        stated["q025"] <= real <= stated["q975"],
        (stated["mean"] - real) / stated["sd"],
        stated["sd"],
    )


def look_at_change(site, number, own, verdict):
    """Size and onset of the first drift told after the change, as stated `SIZED_AFTER` days later, and its onset as stated at last."""
    change = site.world.change
    first = verdict.told("drift", change.day)
    if first is None:
        return
    every = [
        (day, alarm["change"])
        for day, line in own
        if day >= first
        for alarm in line["alarms"]
        if alarm["kind"] == "drift" and alarm.get("change")
    ]
    stated = [one for one in every if one[0] <= first + SIZED_AFTER]
    if not stated:
        return
    day, said = stated[-1]
    # As a share of the baseline's mean force, which the season moves by a tenth and more where the walls hold the rod.
    ratio = site.records[number]["ratio"][: len(learned(site, number, verdict))]
    size = float(change.at(day) / np.exp(np.log(ratio).mean()))
    verdict.size_held = said["size"]["q025"] <= size <= said["size"]["q975"]
    dated = [[day_of(site.start, one[key]) for key in ("onset_q025", "onset_q975")] for one in (said, every[-1][1])]
    verdict.onset_held, verdict.onset_held_late = (begin <= change.day <= end for begin, end in dated)
    verdict.onset_widths = tuple(end - begin for begin, end in dated)
