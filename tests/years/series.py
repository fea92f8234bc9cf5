"""One site's series of identified frequencies: force, exact beam, errors; as tables, configuration and truth."""

import csv
import json
import math
import sys
from dataclasses import asdict, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
from numpy.polynomial import chebyshev

sys.path.append(str(Path(__file__).resolve().parent.parent / "worlds"))
import beam
import rods as rods_of_worlds

import scenario
import weather

# Frequencies are tabulated as ln f over ln(N / N_0): Chebyshev nodes of this range, off by less than 1e-7 (check.py).
RANGE = (0.04, 2.5)
NODES = 22
TERMS = 36
# Share of the rods whose user says about how large the force is (30 % is stated), and how well.
KNOWN, GUESS_CV = 0.4, 0.25
# A line farther off than this leaves the peak of mode 2 alone.
LINE_REACH = 0.015
# Restraint kappa: N falls by kappa E A alpha per kelvin.
EXPANSION_PER_K = 1.2e-5


def stream(seed, name, index):
    """Random numbers of one site, the same whatever else is drawn."""
    words = [seed, *name.encode(), index]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


def tabulate(real, count):
    """Chebyshev coefficients of ln f_n over ln(N / N_0), a column a mode."""
    low, high = (math.log(end) for end in RANGE)
    nodes = np.cos(math.pi * (np.arange(NODES) + 0.5) / NODES)
    forces = real.axial_force_n * np.exp(0.5 * (low + high) + 0.5 * (high - low) * nodes)
    pairs = [beam.matrices(replace(real, axial_force_n=float(force)), TERMS) for force in forces]
    stiffness = np.stack([pair[0] for pair in pairs])
    lower = np.linalg.cholesky(stiffness)
    half = np.linalg.solve(lower, pairs[0][1][None])
    reduced = np.linalg.solve(lower, half.transpose(0, 2, 1))
    values = np.linalg.eigvalsh(0.5 * (reduced + reduced.transpose(0, 2, 1)))[:, : -count - 1 : -1]
    return chebyshev.chebfit(nodes, -0.5 * np.log(values) - math.log(2 * math.pi), NODES - 1)


def log_frequencies(table, ratio):
    """ln f, a row a force ratio N / N_0, a column a mode."""
    low, high = (math.log(end) for end in RANGE)
    inside = np.clip(ratio, *RANGE)
    x = (np.log(inside) - 0.5 * (low + high)) / (0.5 * (high - low))
    return chebyshev.chebval(x, table).T


def draw_rods(rng, drawn, count):
    """Rods of a site: half of all sites have rods of one forge, alike but for a few per cent."""
    alike = rng.random() < 0.5
    rods = []
    for way in drawn.rods:
        stress = scenario.even_in_log(rng, 50e6, 120e6)
        if way.per_k <= -0.015:
            # Held by its walls: nearly all of the expansion becomes force.
            stress = restrained_stress(rng, way.per_k)
        template = rods[0].nominal if alike and rods else None
        rods.append(draw_rod(rng, stress, template, count))
    return rods


def restrained_stress(rng, per_k):
    """The stress [Pa] at which nearly full restraint moves the force by `per_k`."""
    modulus, *_ = rods_of_worlds.MATERIALS["iron"]
    return scenario.uniform(rng, 0.85, 1.0) * modulus * EXPANSION_PER_K / -per_k


def draw_rod(rng, stress, template, count):
    """A rod of tests/worlds, or one of the same section and nearly the same length as `template`."""
    rod = rods_of_worlds.draw(rng, slenderness=(100, 300), length_m=(4.0, 16.0), stress_pa=(stress, stress), fixity=(0.1, 0.9), count=count)
    if template is None:
        return rod
    nominal = replace(template, length_m=round(template.length_m * scenario.uniform(rng, 0.97, 1.03), 2))
    modulus, modulus_cv, density, density_cv = rods_of_worlds.MATERIALS[nominal.material]
    z = np.clip(rng.standard_normal(3), -3.0, 3.0)
    area, inertia = nominal.area_and_inertia(1 + rods_of_worlds.DIMENSION_CV * z[0])
    rigidity = modulus * (1 + modulus_cv * z[1]) * inertia
    springs = tuple(
        rods_of_worlds.fixity_spring(scenario.uniform(rng, 0.1, 0.9), rigidity, nominal.length_m) for _ in range(2)
    )
    real = beam.Beam(nominal.length_m, rigidity, density * (1 + density_cv * z[2]) * area, stress * area, springs)
    return rods_of_worlds.of_beam(nominal, real, rng, count, stress)


class Site:
    """A site of a world: its rods and what was identified of them."""

    def __init__(self, name, seed, index, count):
        rng = stream(seed, name, index)
        self.world = scenario.world(name, rng, count)
        self.start = datetime(2023, 12, 31, tzinfo=timezone.utc) + timedelta(days=self.world.first_day_of_year)
        self.modes = int(rng.choice([3, 4, 5], p=[0.6, 0.2, 0.2]))
        self.rods = draw_rods(rng, self.world, self.modes)
        self.known = rng.random(len(self.rods)) < KNOWN
        self.guess = np.maximum(0.3, 1 + GUESS_CV * rng.standard_normal(len(self.rods)))
        self.names = [f"rod-{number + 1}" for number in range(len(self.rods))]
        self.air = weather.Air(rng, self.world.days, self.world.first_day_of_year)
        self.reading_days, self.celsius = self.thermometer(rng)
        common = weather.memory(rng, 1.0, max(rod.memory_days for rod in self.world.rods) * weather.HOURS, (len(self.air.hours),))
        lags = [rod.lag_h for rod in self.world.rods] + [rod.wall_days * 24.0 for rod in self.world.rods]
        followed = self.air.followed(lags) - weather.MEAN_C
        own = len(self.rods)
        self.records = [
            self.record(rng, number, followed[:, number], followed[:, own + number], common) for number in range(own)
        ]

    def thermometer(self, rng):
        """Times [days] and readings of the site's thermometer."""
        world = self.world
        if world.reading_hours is None:
            days = np.arange(-weather.HOURS, world.days * weather.HOURS) / weather.HOURS
        else:
            first, dates = -1, []
            for turn in range(world.days + 1):
                dates.append(first)
                first += world.reading_every[turn % len(world.reading_every)]
            dates = np.array([date for date in dates if date < world.days])
            days = np.sort((dates[:, None] + np.array(world.reading_hours)[None, :] / 24.0).ravel())
            days = days + world.reading_jitter_h / 24.0 * rng.uniform(-1.0, 1.0, len(days))
        days, celsius = weather.readings(self.air, days, rng, world.fault)
        kept = ~self.is_silent(days)
        return days[kept], celsius[kept]

    def is_silent(self, days):
        begin, end = self.world.silent
        return (days >= begin) & (days < end)

    def record(self, rng, number, fast, slow, common):
        """Times [days], frequencies and standard errors [Hz], and the force ratio of one rod's records."""
        world, way = self.world, self.world.rods[number]
        per_day = world.records_per_day
        days = np.repeat(np.arange(world.days), per_day) + np.tile((scenario.RECORD_HOUR / 24.0 + np.arange(per_day) / per_day) % 1.0, world.days)
        days = np.sort(days + rng.uniform(-1.0, 1.0, len(days)) / 24.0)
        days = days[(rng.random(len(days)) >= world.missing) & ~self.is_silent(days)]
        hours = self.air.hours / weather.HOURS
        fast, slow = np.interp(days, hours, fast), np.interp(days, hours, slow)
        own = weather.memory(rng, 1.0, way.memory_days * weather.HOURS, (len(hours),))
        both = math.sqrt(world.common) * common + math.sqrt(1 - world.common) * own
        white = way.white * np.where(weather.spells(rng, way, days), way.spell_factor, 1.0)
        noise = white * rng.standard_normal(len(days)) + way.memory_sd * np.interp(days, hours, both)
        noise += way.season * np.cos(2 * math.pi * days / 365.25 + way.phase)
        wild = rng.random(len(days)) < way.outliers
        noise += wild * way.outlier_sd * rng.standard_normal(len(days))
        thermal = way.per_k * fast + way.curvature * fast**2 + way.wall_per_k * slow
        change = world.change.at(days) if world.changes and number < world.change.rods else np.zeros(len(days))
        ratio = 1.0 + thermal + noise + change
        rod = self.rods[number]
        table = tabulate(rod.beam, self.modes)
        logs = log_frequencies(table, ratio)
        if world.changes and number < world.change.rods and not world.change.is_axial:
            other = replace(
                rod.beam,
                springs_n_m=tuple(world.change.springs * spring for spring in rod.beam.springs_n_m),
                mass_per_length_kg_m=world.change.mass * rod.beam.mass_per_length_kg_m,
                flexural_rigidity_n_m2=world.change.modulus * rod.beam.flexural_rigidity_n_m2,
            )
            changed = log_frequencies(tabulate(other, self.modes), ratio)
            logs = np.where((days >= world.change.day)[:, None], changed, logs)
        # What sets the rod apart from the beam does so for good.
        static = [math.log(mode.frequency_hz) for mode in rod.modes] - log_frequencies(table, np.ones(1))[0]
        logs = logs + static
        sd = even_errors(rng, self.modes) * np.exp(0.2 * rng.standard_normal(logs.shape))
        logs = logs + sd * rng.standard_normal(logs.shape)
        # A line stands still while the mode moves past it, and draws its peak.
        beside = rng.random(len(days)) < way.line
        apart = math.log(rod.modes[1].frequency_hz) + way.line_offset - logs[:, 1]
        logs[:, 1] += beside * (np.abs(apart) < LINE_REACH) * way.line_pull * rng.random(len(days)) * apart
        frequencies = np.exp(logs)
        return {"days": days, "hz": frequencies, "sd_hz": sd * frequencies, "ratio": ratio}

    def steady(self, number, celsius):
        """The force ratio of an unchanged rod that has been at one temperature for long."""
        way = self.world.rods[number]
        warmer = np.asarray(celsius) - weather.MEAN_C
        return 1.0 + (way.per_k + way.wall_per_k) * warmer + way.curvature * warmer**2

    def stamp(self, day):
        return (self.start + timedelta(seconds=round(float(day) * 86400.0))).strftime("%Y-%m-%dT%H:%M:%SZ")

    def write(self, folder):
        """The tables, and the truth."""
        folder.mkdir(parents=True, exist_ok=True)
        names = [f"{what}{order + 1}_hz" for order in range(self.modes) for what in ("f", "sd")]
        with (folder / "frequencies.csv").open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["time", "rod", *names])
            for name, record in zip(self.names, self.records):
                for row in range(len(record["days"])):
                    cells = [text for pair in zip(record["hz"][row], record["sd_hz"][row]) for text in (f"{pair[0]:.7g}", f"{pair[1]:.3g}")]
                    table.writerow([self.stamp(record["days"][row]), name, *cells])
        with (folder / "temperatures.csv").open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["time", "temperature_c"])
            table.writerows([self.stamp(day), f"{celsius:.1f}"] for day, celsius in zip(self.reading_days, self.celsius))
        (folder / "truth.json").write_text(json.dumps(self.truth()), encoding="utf-8")

    def truth(self):
        world = asdict(self.world)
        rods = [
            {
                "rod": name,
                "axial_force_n": rod.beam.axial_force_n,
                "springs_n_m": rod.beam.springs_n_m,
                "flexural_rigidity_n_m2": rod.beam.flexural_rigidity_n_m2,
                "mass_per_length_kg_m": rod.beam.mass_per_length_kg_m,
                "records": len(record["days"]),
                "least_ratio": float(record["ratio"].min()),
            }
            for name, rod, record in zip(self.names, self.rods, self.records)
        ]
        return {"world": world, "start": self.stamp(0), "modes": self.modes, "rods": rods}

    def answers(self):
        """Arguments with which a user has `tirante init` write each rod."""
        return [
            rods_of_worlds.questions(rod.nominal, name, "mm", None, rod.axial_force_n * guess if known else None)
            for name, rod, known, guess in zip(self.names, self.rods, self.known, self.guess)
        ]

    def configure(self, program, folder, settings=""):
        """The configuration as a user writes it."""
        own = f"[modes]\ncount = {self.modes}\n"
        if self.world.baseline != scenario.World.baseline:
            own += f"[track]\nbaseline_records = {self.world.baseline}\n"
        text, refused = rods_of_worlds.configuration(program, self.answers(), folder, own + settings)
        if refused:
            raise RuntimeError(f"{folder}: init refused {refused} rods")
        (folder / "site.toml").write_text(text, encoding="utf-8")


def even_errors(rng, modes):
    """Relative standard errors of a rod's modes: 0.02 to 0.1 %."""
    return np.exp(rng.uniform(math.log(2e-4), math.log(1e-3), modes))
