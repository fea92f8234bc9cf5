"""Worlds: what a site's rods, walls, thermometer and disturbances are drawn from, by name.

A name is a world, or a world and what happens in it, joined by `+`: `benign`, `full+loss3`, `none+loss10`, `ar5+ramp2`.
"""

from dataclasses import dataclass, field, replace

import numpy as np

# Thermometers fail on this day, rods change at some time of that one.
FAULT_DAY = 100.0
CHANGE_DAY = 150
# Daily records come an hour before or after this one.
RECORD_HOUR = 11.0
# Days followed: a year after 60 days; for what happens suddenly 90 days after it.
DAYS, SUDDEN_DAYS = 426, 241
# Number of rods that change where all do.
ALL_RODS = 99


@dataclass(frozen=True)
class Rod:
    """How one rod's force moves, shares of N_0."""

    per_k: float = 0.0
    lag_h: float = 4.0
    wall_per_k: float = 0.0
    wall_days: float = 10.0
    curvature: float = 0.0
    white: float = 0.002
    memory_sd: float = 0.0
    memory_days: float = 5.0
    season: float = 0.0
    phase: float = 0.0
    outliers: float = 0.0
    outlier_sd: float = 0.03
    # Spells of some days in which the white part is so many times as large; days from the end of one to the next, in the mean.
    spell_factor: float = 1.0
    spell_days: float = 3.0
    calm_days: float = 20.0
    # A line beside mode 2: share of records with it, its distance from f2, how far it draws the peak.
    line: float = 0.0
    line_offset: float = 0.0
    line_pull: float = 0.0


@dataclass(frozen=True)
class Change:
    """What happens to the first rod of a site, or to the first few."""

    # Number of rods that change: the first ones.
    rods: int = 1
    day: float = CHANGE_DAY + 0.5
    # Sudden change of force, and its rate per year, as shares of N_0.
    step: float = 0.0
    per_year: float = 0.0
    # A second sudden change, days after the first.
    again: float = 0.0
    again_days: float = 30.0
    # Factors on both springs, on the mass per length and on the modulus.
    springs: float = 1.0
    mass: float = 1.0
    modulus: float = 1.0

    @property
    def is_axial(self):
        return (self.springs, self.mass, self.modulus) == (1.0, 1.0, 1.0)

    def at(self, days):
        """The change of force at these days."""
        later = np.maximum(days - self.day, 0.0)
        steps = np.where(days >= self.day, self.step, 0.0) + np.where(later >= self.again_days, self.again, 0.0)
        return steps + self.per_year * later / 365.25

    @property
    def is_of_all(self):
        return self.rods == ALL_RODS


@dataclass(frozen=True)
class World:
    """One site's circumstances, and one draw of a rod for each of its rods."""

    name: str
    rods: tuple
    days: int = DAYS
    first_day_of_year: int = 1
    # Readings of the thermometer: times of day [h]; None: every hour; empty: none.
    reading_hours: tuple = None
    reading_jitter_h: float = 0.0
    # Days between readings, where they are not daily.
    reading_every: tuple = (1,)
    fault: tuple = None
    records_per_day: int = 1
    missing: float = 0.03
    # No record and no reading between these days.
    silent: tuple = (0.0, 0.0)
    # Share of the memory's variance that all rods of the site have in common.
    common: float = 0.5
    # Records of the baseline.
    baseline: int = 30
    change: Change = field(default_factory=Change)
    changes: bool = False

    @property
    def shown_day(self):
        """The day from which on records show the change."""
        begin, end = self.silent
        return end if begin <= self.change.day < end else self.change.day


def uniform(rng, low, high):
    return float(rng.uniform(low, high))


def even_in_log(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sign(rng):
    return 1.0 if rng.random() < 0.5 else -1.0


def quiet(rng):
    """A rod of the benign world."""
    return Rod(
        per_k=uniform(rng, -0.010, -0.002),
        lag_h=uniform(rng, 2.0, 6.0),
        curvature=uniform(rng, -2e-5, 2e-5),
    )


def restrained(rng):
    return replace(quiet(rng), per_k=uniform(rng, -0.020, -0.015))


def mixed(rng):
    """A rod of a world nobody tuned for: every disturbance in some measure."""
    return Rod(
        per_k=uniform(rng, -0.020, 0.0),
        lag_h=even_in_log(rng, 1.0, 24.0),
        wall_per_k=uniform(rng, -0.003, 0.003),
        wall_days=even_in_log(rng, 3.0, 40.0),
        curvature=uniform(rng, -3e-5, 3e-5),
        white=uniform(rng, 0.001, 0.0025),
        memory_sd=even_in_log(rng, 0.0005, 0.0025),
        memory_days=even_in_log(rng, 1.0, 20.0),
        season=uniform(rng, 0.0, 0.003),
        phase=uniform(rng, 0.0, 2 * np.pi),
        outliers=uniform(rng, 0.0, 0.02),
    )


MORNING = 9.75


def base(name, rng, count):
    """The circumstances called `name`, for `count` rods."""
    start = int(rng.integers(1, 366))
    make, site = quiet, {"first_day_of_year": start}

    def with_memory(days):
        return lambda r: replace(quiet(r), memory_sd=0.002, memory_days=days, white=0.0015)

    once = {"reading_hours": (MORNING,)}
    if name == "full":
        make = restrained
    elif name == "daily15h":
        site |= once
        make = lambda r: replace(quiet(r), lag_h=15.0)
    elif name == "masonry8":
        make = lambda r: replace(quiet(r), wall_per_k=uniform(r, -0.003, -0.001), wall_days=8.0)
    elif name == "masonry30":
        make = lambda r: replace(quiet(r), wall_per_k=0.003 * sign(r), wall_days=30.0)
    elif name in ("ar5", "ar20"):
        make = with_memory(float(name[2:]))
    elif name == "harsh":
        site |= once

        def make(r):
            rod = replace(with_memory(5.0)(r), lag_h=uniform(r, 6.0, 24.0))
            return replace(rod, wall_per_k=uniform(r, -0.003, 0.003), wall_days=15.0)

    elif name == "winter":
        site["first_day_of_year"] = 319
        make = lambda r: replace(
            quiet(r), per_k=uniform(r, -0.015, -0.005), wall_per_k=uniform(r, -0.003, 0.003), wall_days=20.0
        )
    elif name == "season":
        make = lambda r: replace(quiet(r), season=0.003, phase=uniform(r, 0.0, 2 * np.pi))
    elif name == "outl":
        make = lambda r: replace(quiet(r), outliers=0.02)
    elif name in ("spells", "spellsfull"):
        # Storms, or works beside the rod: three days of noise 2.5 to 5 times as large, about twice a month.
        still = quiet if name == "spells" else restrained
        make = lambda r: replace(still(r), spell_factor=even_in_log(r, 2.5, 5.0))
    elif name == "spellsrare":
        # Of any length and size, a few times a year.
        make = lambda r: replace(
            quiet(r), spell_factor=even_in_log(r, 2.0, 8.0), spell_days=even_in_log(r, 1.0, 10.0), calm_days=90.0
        )
    elif name in ("stuck", "thdrift", "offset", "dead"):
        site["fault"] = ("drift" if name == "thdrift" else name, FAULT_DAY)
    elif name in ("jump", "jumpfull"):
        make = quiet if name == "jump" else restrained
        site["fault"] = ("offset", FAULT_DAY, even_in_log(rng, 2.0, 20.0) * sign(rng))
    elif name in ("fahrenheit", "fahrenheitfull"):
        make = quiet if name == "fahrenheit" else restrained
        site["fault"] = ("fahrenheit", FAULT_DAY)
    elif name == "none":
        site["reading_hours"] = ()
    elif name == "nonefull":
        site["reading_hours"] = ()
        make = restrained
    elif name == "twoaweek":
        site |= once | {"reading_every": (3, 4)}
    elif name == "many":
        site["records_per_day"] = 6
    elif name in ("hourly", "hourlyfull"):
        make = quiet if name == "hourly" else restrained
        site["records_per_day"] = 24
    elif name == "line":
        make = lambda r: replace(quiet(r), line=1 / 3, line_offset=uniform(r, 0.001, 0.002) * sign(r), line_pull=0.5)
    elif name == "linestrong":
        make = lambda r: replace(quiet(r), line=1 / 3, line_offset=uniform(r, 0.005, 0.01) * sign(r), line_pull=0.5)
    elif name == "held":
        make = mixed
        site |= {
            "reading_hours": [None, (3.75, MORNING, 15.75, 21.75), (MORNING,)][int(rng.integers(3))],
            "missing": uniform(rng, 0.0, 0.2),
            "common": uniform(rng, 0.0, 1.0),
        }
    elif name == "held2":
        make = mixed
        site |= once | {"reading_jitter_h": 2.0, "missing": 0.15, "common": uniform(rng, 0.0, 1.0)}
    elif name != "benign":
        raise ValueError(f"no world {name}")
    rods = tuple(make(rng) for _ in range(count))
    return World(name=name, rods=rods, **site)


BASES = (
    "benign full daily15h masonry8 masonry30 ar5 ar20 harsh winter season outl spells spellsfull spellsrare stuck thdrift offset dead none nonefull twoaweek many "
    "jump jumpfull fahrenheit fahrenheitfull hourly hourlyfull line linestrong held held2"
).split()


def event(name, moment=0.5):
    """What `name` says happens to the first rod at this share of its day, and the days that are followed."""
    sudden = {"days": SUDDEN_DAYS}
    for word, per_cent in (("loss", -0.01), ("two", -0.01), ("all", -0.01), ("gap", -0.01), ("soon", -0.01), ("early", -0.01), ("long", -0.01), ("springs", -0.01), ("mass", 0.01), ("modulus", -0.01)):
        if not name.startswith(word):
            continue
        first, _, second = name[len(word) :].partition("then")
        size = per_cent * float(first)
        if word == "loss":
            return Change(day=CHANGE_DAY + moment, step=size, again=per_cent * float(second or 0)), sudden
        if word in ("two", "all"):
            return Change(day=CHANGE_DAY + moment, step=size, rods=2 if word == "two" else ALL_RODS), sudden
        if word == "gap":
            # One to four months without a record, in which the rod changes.
            end, silent_days = CHANGE_DAY + (RECORD_HOUR - 1.0) / 24.0, 30.0 + 100.0 * moment
            day = end - silent_days * ((7.0 * moment) % 1.0)
            return Change(day=day, step=size), sudden | {"silent": (end - silent_days, end)}
        if word == "soon":
            # After four records of the baseline or so.
            return Change(day=3 + moment, step=size), sudden
        if word == "early":
            # Half-way through a baseline of 30 records.
            return Change(day=15 + moment, step=size), sudden
        if word == "long":
            return Change(day=60 + moment, step=size), sudden | {"baseline": 120}
        if word == "springs":
            return Change(day=CHANGE_DAY + moment, springs=1 + size), sudden
        if word == "mass":
            return Change(day=CHANGE_DAY + moment, mass=1 + size), sudden
        if word == "modulus":
            return Change(day=CHANGE_DAY + moment, modulus=1 + size), sudden
    if name.startswith("since"):
        # From the first day on, in all that the baseline learns.
        return Change(day=0.5 + 0.5 * moment, per_year=-0.01 * float(name[5:])), {"days": DAYS}
    if name.startswith("first"):
        return Change(day=CHANGE_DAY + moment, per_year=-0.01 * float(name[5:])), {"days": DAYS}
    if name.startswith("late"):
        return Change(day=DAYS - 2 + moment, per_year=-0.01 * float(name[4:])), {"days": DAYS + 220}
    raise ValueError(f"nothing called {name} happens: loss3, loss3then5, two10, all20, since5, gap40, soon40, early3, long3, first2, late2, springs20, mass1, modulus3")


def world(name, rng, count):
    """A world by its full name."""
    circumstances, _, happening = name.partition("+")
    drawn = replace(base(circumstances, rng, count), name=name)
    if not happening:
        return drawn
    change, site = event(happening, float(rng.random()))
    if happening.startswith(("soon", "early", "long")):
        # While the baseline is learned: so many records, not days.
        change = replace(change, day=change.day / drawn.records_per_day)
    return replace(drawn, change=change, changes=True, **site)
