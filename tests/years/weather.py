"""Air, rods and walls that follow it, and thermometers.

Times are days since the first record's day, hourly from `BEFORE_DAYS` earlier, so that the slowest wall has forgotten how it began.
"""

import math

import numpy as np

BEFORE_DAYS = 150
MEAN_C = 13.0
HOURS = 24


def memory(rng, sd, memory_steps, shape):
    """Stationary first-order autoregression along the first axis."""
    share = math.exp(-1.0 / memory_steps)
    kicks = rng.standard_normal(shape) * sd * math.sqrt(1.0 - share**2)
    series = np.empty(shape)
    series[0] = rng.standard_normal(shape[1:]) * sd
    for step in range(1, shape[0]):
        series[step] = share * series[step - 1] + kicks[step]
    return series


class Air:
    """Hourly air [degC] of one site: season, days of changing amplitude, weather of three days and of a month."""

    def __init__(self, rng, days, first_day_of_year):
        self.hours = np.arange(-BEFORE_DAYS * HOURS, days * HOURS + 1)
        day = self.hours / HOURS
        year = first_day_of_year + day
        season = 7.5 * np.cos(2 * math.pi * (year - 205.0) / 365.25)
        # Clear spells of some days, and more sun in summer.
        clear = np.exp(memory(rng, 0.4, 3.0, (len(self.hours) // HOURS + 2,)))
        amplitude = 3.0 * np.interp(day + BEFORE_DAYS, np.arange(len(clear)), clear)
        diurnal = amplitude * (1.0 + 0.3 * np.cos(2 * math.pi * (year - 190.0) / 365.25))
        diurnal *= np.cos(2 * math.pi * (day - 15.0 / 24))
        weather = memory(rng, 2.5, 3.0 * HOURS, (len(day),)) + memory(rng, 1.2, 25.0 * HOURS, (len(day),))
        self.celsius = MEAN_C + season + diurnal + weather

    def at(self, days):
        return np.interp(days, self.hours / HOURS, self.celsius)

    def followed(self, lags_h):
        """What follows the air with these lags [h], one column each."""
        keep = np.exp(-1.0 / np.asarray(lags_h, dtype=float))
        series = np.empty((len(self.hours), len(keep)))
        state = np.full(len(keep), self.celsius[: 30 * HOURS].mean())
        for index, celsius in enumerate(self.celsius):
            state = keep * state + (1.0 - keep) * celsius
            series[index] = state
        return series


def spells(rng, way, days):
    """Whether each time [days] is in one of a rod's spells of larger noise; calms are exponential, spells half to one and a half times as long."""
    inside = np.zeros(len(days), dtype=bool)
    if way.spell_factor == 1.0:
        return inside
    at = float(rng.exponential(way.calm_days))
    while len(days) and at < days[-1]:
        end = at + way.spell_days * float(rng.uniform(0.5, 1.5))
        inside |= (days >= at) & (days < end)
        at = end + float(rng.exponential(way.calm_days))
    return inside


def readings(air, days, rng, fault=None):
    """What a thermometer with 0.1 K noise and digits of 0.1 K says at these times [days]: (times, degC).

    `fault`: None, or (kind, day): `stuck` at its last reading, `drift` of 0.03 K a day, `offset` of 2 K or as many as follow,
    `fahrenheit`, `dead`.
    """
    celsius = air.at(days) + 0.1 * rng.standard_normal(len(days))
    if fault is not None:
        kind, since, *size_k = fault
        late = days >= since
        if kind == "dead":
            days, celsius = days[~late], celsius[~late]
        elif kind == "stuck":
            celsius[late] = celsius[~late][-1]
        elif kind == "drift":
            celsius[late] += 0.03 * (days[late] - since)
        elif kind == "offset":
            celsius[late] += size_k[0] if size_k else 2.0
        elif kind == "fahrenheit":
            celsius[late] = 32.0 + 1.8 * celsius[late]
        else:
            raise ValueError(f"no fault {kind}")
    return days, np.round(celsius, 1)
