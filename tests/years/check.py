"""The generator of years against closed forms; one line a check, each ends with `: ok`, or the exit code is 1."""

import math
import sys
from dataclasses import replace

import numpy as np

import scenario
import series
import weather
import beam

FAILED = []


def check(what, passes, seen=""):
    print(f"{what} {seen}: {'ok' if passes else 'NOT OK'}")
    if not passes:
        FAILED.append(what)


def frequencies():
    rng = series.stream(7, "check", 0)
    drawn = scenario.world("full", rng, 4)
    worst = 0.0
    for rod in series.draw_rods(rng, drawn, 5):
        table = series.tabulate(rod.beam, 5)
        for ratio in (0.045, 0.3, 0.8, 1.0, 1.37, 2.4):
            exact = beam.modes(replace(rod.beam, axial_force_n=ratio * rod.beam.axial_force_n), 5)
            logs = series.log_frequencies(table, np.array([ratio]))[0]
            worst = max(worst, max(abs(math.log(mode.frequency_hz) - log) for mode, log in zip(exact, logs)))
    # A thousandth of the smallest error of a frequency.
    check("tabulated frequencies are the beam's", worst < 2e-7, f"(largest difference of ln f {worst:.1e})")
    string = beam.Beam(10.0, 1e-3, 8.0, 1e5, (0.0, 0.0))
    log = series.log_frequencies(series.tabulate(string, 3), np.array([0.25]))[0]
    wanted = [math.log(order / 20.0 * math.sqrt(0.25 * 1e5 / 8.0)) for order in (1, 2, 3)]
    check("a rod without stiffness is a string", np.allclose(log, wanted, atol=1e-6))


def memories():
    rng = series.stream(7, "check", 1)
    many = weather.memory(rng, 0.002, 120.0, (400, 4000))
    # 4000 independent series: the sd of an sd is 1.1 %, of a correlation 1.6 %.
    check("memory has its spread from the first step on", abs(many[0].std() / 0.002 - 1) < 0.05 and abs(many[-1].std() / 0.002 - 1) < 0.05)
    share = np.corrcoef(many[100], many[220])[0, 1]
    check("memory falls to 1/e in its time", abs(share - math.exp(-1)) < 0.07, f"({share:.3f})")


def spells():
    way = scenario.Rod(spell_factor=4.0)
    days = np.arange(40000.0)
    share = weather.spells(np.random.default_rng(2), way, days).mean()
    wanted = way.spell_days / (way.spell_days + way.calm_days)
    # Some 1700 spells: their share is known to 3 %.
    check("spells take their share of the days", abs(share / wanted - 1) < 0.1, f"({share:.3f}, wanted {wanted:.3f})")
    check("a rod without spells has none", not weather.spells(None, scenario.Rod(), days).any())


def lags():
    air = weather.Air(series.stream(7, "check", 2), 60, 100)
    check("air is where Italy's is", 0 < air.celsius.mean() < 26 and 3 < air.celsius.std() < 12)
    air.celsius = np.where(air.hours < 0, 0.0, 10.0)
    wall = air.followed([48.0])[:, 0]
    after = wall[np.searchsorted(air.hours, 47)]
    check("a wall goes 63 % of a step in its lag", abs(after - 10 * (1 - math.exp(-1))) < 1e-9, f"({after:.4f})")


def thermometers():
    rng = series.stream(7, "check", 3)
    air = weather.Air(rng, 200, 1)
    days = np.arange(0, 200, 1 / 24)
    _, good = weather.readings(air, days, rng)
    noise = good - air.at(days)
    check("a thermometer is right but for 0.1 K and its digit", abs(noise.std() - math.hypot(0.1, 0.1 / math.sqrt(12))) < 0.01, f"({noise.std():.3f} K)")
    late = days >= 120.0
    for kind, wanted in (("offset", 2.0), ("drift", 0.03 * (days[late] - 100).mean())):
        _, bad = weather.readings(air, days, rng, (kind, 100.0))
        off = (bad - air.at(days))[late].mean()
        check(f"thermometer fault {kind}", abs(off - wanted) < 0.02, f"({off:.2f} K)")
    _, bad = weather.readings(air, days, rng, ("stuck", 100.0))
    check("thermometer fault stuck", len(set(bad[days >= 100.0])) == 1)
    left, _ = weather.readings(air, days, rng, ("dead", 100.0))
    check("thermometer fault dead", left.max() < 100.0)


def forces():
    site = series.Site("none+loss10", 7, 0, 2)
    record, twin = site.records[0], series.Site("none+loss10", 7, 0, 2).records[0]
    check("the same seed gives the same site", all(np.array_equal(record[key], twin[key]) for key in record))
    # What is left after temperature, from a day each side of the change: seconds apart nothing else moves a tenth of it.
    way, world = site.world.rods[0], site.world
    followed = site.air.followed([way.lag_h])[:, 0] - weather.MEAN_C
    warm = np.interp(record["days"], site.air.hours / weather.HOURS, followed)
    left = record["ratio"] - way.per_k * warm - way.curvature * warm**2
    later = record["days"] >= world.change.day
    steps = left[later].mean() - left[~later].mean(), left[~later].std()
    check("a loss is of its size, the noise of its", abs(steps[0] + 0.1) < 6e-4 and abs(steps[1] / way.white - 1) < 0.25, f"({steps[0]:.4f}, {steps[1]:.4f})")
    logs = series.log_frequencies(series.tabulate(site.rods[0].beam, site.modes), record["ratio"])
    static = np.log([mode.frequency_hz for mode in site.rods[0].modes]) - series.log_frequencies(
        series.tabulate(site.rods[0].beam, site.modes), np.ones(1)
    )[0]
    z = (np.log(record["hz"]) - logs - static) / (record["sd_hz"] / record["hz"])
    # Some 700 errors or more.
    check("errors of frequencies are as stated", abs(z.mean()) < 0.15 and abs(z.std() - 1) < 0.1, f"(mean {z.mean():.3f}, sd {z.std():.3f})")
    steady = site.steady(0, weather.MEAN_C)
    check("nothing moves an unchanged rod at the mean temperature", steady == 1.0)
    mean = float(np.log(record["hz"]).mean())
    # Frozen: another number of numpy's streams would be another campaign.
    check("the streams are frozen", abs(mean - FROZEN) < 1e-6, f"({mean:.7f})")


# Mean ln f of the records of `none+loss10`, seed 7, site 0 of two rods, the first.
FROZEN = 2.8241530


def main():
    frequencies()
    memories()
    spells()
    lags()
    thermometers()
    forces()
    sys.exit(1 if FAILED else 0)


if __name__ == "__main__":
    main()
