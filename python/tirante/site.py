"""A site: what is known of its rods, their records, and their forces over time."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from typing import Union

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from . import _core
from .outcome import Outcome
from .signals import samples_of

Event = _core.Event
Records = _core.Records
Path = Union[str, PathLike[str]]
Time = Union[str, int, datetime.datetime, np.datetime64, pd.Timestamp]
Prior = Union[float, Mapping[str, float]]


def nanoseconds(time: Time) -> int:
    """Nanoseconds since 1970; a time without a zone is UTC, a whole number is nanoseconds already."""
    if isinstance(time, (float, np.floating, bool, np.bool_)):
        # pandas would take 1767225600.0, which is seconds, for nanoseconds.
        raise TypeError(f"time: {time!r} has no unit; whole nanoseconds since 1970 or a pandas.Timestamp are wanted")
    if isinstance(time, (int, np.integer)):
        return int(time)
    stamp = pd.Timestamp(time)
    if stamp is pd.NaT:
        raise ValueError("time: it is missing (NaT)")
    stamp = stamp.tz_localize("UTC") if stamp.tzinfo is None else stamp.tz_convert("UTC")
    return int(stamp.as_unit("ns").value)


def _is_missing(value: object) -> bool:
    return value is np.ma.masked or bool(pd.isna(value))


def given_modes(
    frequencies_hz: Sequence[float | None], sd_hz: float | Sequence[float | None]
) -> list[tuple[int, float, float]]:
    """Order, frequency and standard error of the modes that were measured: `None`, NaN, NA or a masked value stands for one that was not."""
    errors = [sd_hz] * len(frequencies_hz) if isinstance(sd_hz, (int, float)) else list(sd_hz)
    if len(errors) != len(frequencies_hz):
        raise ValueError(f"sd_hz has {len(errors)} entries, frequencies_hz {len(frequencies_hz)}")
    modes = []
    for order, (hz, sd) in enumerate(zip(frequencies_hz, errors), start=1):
        if _is_missing(hz):
            continue
        if _is_missing(sd):
            raise ValueError(f"sd_hz: mode {order} was measured, its error is missing")
        modes.append((order, float(hz), float(sd)))
    return modes


def _toml(value: Prior | str) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(number)}" for key, number in value.items()) + " }"
    return repr(float(value))


class Site:
    """A configuration with every rod of it ready for records."""

    def __init__(self, core: _core.Site) -> None:
        self._core = core

    @classmethod
    def load(cls, path: Path | None = None, settings: Mapping[str, object] | None = None) -> Site:
        """Reads a configuration; without a path, the built-in rod of the paper.

        `settings` override keys, as the program's `--set` does: `{"abc.draws": 50_000}`.
        """
        pairs = [(key, str(value)) for key, value in (settings or {}).items()]
        return cls(_core.Site.load(path, pairs))

    @classmethod
    def parse(cls, text: str) -> Site:
        """Reads a configuration from its text, in TOML."""
        return cls(_core.Site.parse(text))

    @classmethod
    def of_rod(
        cls,
        section: str,
        *,
        length_m: Prior,
        name: str = "rod",
        discrepancy: float | None = None,
        modes: int | None = None,
        seed: int | None = None,
        unit: str = "m",
        **priors: Prior,
    ) -> Site:
        """A site of one rod. Sections: `square`, `round`, `rectangle`, `direct`.

        Priors are the keys of the configuration's `[rod.priors]`: a number is known exactly, a mapping is a distribution,
        such as `{"mean": 800e3, "cv": 0.2}`, `{"low": 0, "high": 5e5}`, `{"fixity_low": 0, "fixity_high": 0.9}`.
        """
        lines = ["[site]", f"name = {_toml(name)}"]
        lines += [] if seed is None else [f"seed = {int(seed)}"]
        lines += [] if modes is None else ["[modes]", f"count = {int(modes)}"]
        lines += ["[[rod]]", f"id = {_toml(name)}", f"section = {_toml(section)}", f"length_m = {_toml(length_m)}"]
        lines += [] if discrepancy is None else [f"discrepancy = {_toml(discrepancy)}"]
        lines += ["[rod.priors]"] + [f"{key} = {_toml(prior)}" for key, prior in priors.items()]
        lines += ["[rod.channel]", f"topic = {_toml('/' + name)}", f"unit = {_toml(unit)}"]
        return cls.parse("\n".join(lines) + "\n")

    @property
    def name(self) -> str:
        """Name of the site."""
        return self._core.name

    @property
    def rods(self) -> list[str]:
        """Ids of the rods."""
        return self._core.rods

    @property
    def effective(self) -> str:
        """The configuration with every default filled in, as TOML."""
        return self._core.effective

    def quantities(self, rod: str | None = None) -> list[str]:
        """Names of a rod's quantities, with their units."""
        return self._core.quantities(rod)

    def frequencies(self, quantities: Mapping[str, float], modes: int = 3, rod: str | None = None) -> list[float]:
        """Natural frequencies in hertz of a rod with these quantities, by its forward model."""
        names = self.quantities(rod)
        if set(quantities) != set(names):
            raise ValueError(f"quantities: {', '.join(names)} are wanted")
        return self._core.frequencies([float(quantities[name]) for name in names], modes, rod)

    def identify_frequencies(
        self,
        frequencies_hz: Sequence[float | None],
        sd_hz: float | Sequence[float | None],
        rod: str | None = None,
    ) -> Outcome:
        """Posterior of the force from natural frequencies of modes 1, 2, ... and their standard errors.

        The numbers are those of `tirante identify --frequencies ... --sd ...`.
        """
        return Outcome(self._core.identify_frequencies(given_modes(frequencies_hz, sd_hz), rod))

    def record(
        self,
        samples: ArrayLike,
        fs_hz: float,
        start: Time = 0,
        *,
        rod: str | None = None,
        unit: str | None = None,
        temperature_c: float | None = None,
    ) -> Event:
        """A record from evenly spaced samples in `unit` (else in that of the rod's channel), after the quality checks.

        Missing samples are NaN, or masked. The samples are copied: the checks may repair them, and the record keeps them.
        Without `start` it can be identified, not tracked.
        """
        return self._core.record(
            samples_of(samples), fs_hz, nanoseconds(start), rod=rod, unit=unit, temperature_c=temperature_c
        )

    def read(
        self,
        paths: Path | Iterable[Path],
        *,
        rate_hz: float | None = None,
        unit: str | None = None,
        start: Time | None = None,
    ) -> Records:
        """Records of recordings and other programs' files, or folders of them, in the order of their times.

        An iterator; a file that cannot be read, or has no topic of the site, is an error. `notes` of it tell of damage. Records
        of a file that does not say when it began can be identified, but tracked only with `start`.
        """
        return self._core.read(
            [paths] if isinstance(paths, (str, PathLike)) else list(paths),
            rate_hz=rate_hz,
            unit=unit,
            start_ns=None if start is None else nanoseconds(start),
        )

    def identify(self, record: Event) -> Outcome:
        """Modes and force of a record. The numbers are those of `tirante identify FILE`."""
        return Outcome(self._core.identify(record))

    def track(self, records: Iterable[Event]) -> Iterator[Outcome]:
        """Results of records with their relative force, in the order of event time, as `tirante replay` prints them.

        A record without a time is refused, as by `tirante replay`.
        """
        tracker = self.tracker()
        for record in records:
            outcome = tracker.take(record)
            if outcome is not None:
                yield outcome

    def tracker(self) -> Tracker:
        """A tracker of the site's rods that has seen no record."""
        return Tracker(self._core)


class Tracker:
    """The fold over the records of a site's rods, in memory; records in the order of event time."""

    def __init__(self, core: _core.Site) -> None:
        self._site = core
        self._core = core.tracker()

    def take(self, record: Event) -> Outcome | None:
        """Takes a record and gives its result, or temperatures beside records; `None` for these and for a record taken before."""
        if record.kind == "readings":
            self._core.take_readings(record)
            return None
        taken = self._core.take(self._site.identify(record))
        return None if taken is None else Outcome(taken)

    def take_frequencies(
        self,
        time: Time,
        frequencies_hz: Sequence[float | None],
        sd_hz: float | Sequence[float | None],
        *,
        rod: str | None = None,
        temperature_c: float | None = None,
        duration_s: float = 0.0,
        rms: float | None = None,
    ) -> Outcome | None:
        """Takes frequencies identified elsewhere, as `tirante track` takes a row of a table.

        `rms` of the samples, in one unit throughout, tells a sensor whose gain changed; the record lasted `duration_s`.
        """
        modes = given_modes(frequencies_hz, sd_hz)
        taken = self._core.take_frequencies(
            self._one(rod), nanoseconds(time), modes, temperature_c=temperature_c, duration_s=duration_s, rms=rms
        )
        return None if taken is None else Outcome(taken)

    def state(self, rod: str | None = None) -> str:
        """State of a rod: `learning`, `monitoring`, `alarm` or `not-monitoring`; of a site with several rods, which one is wanted."""
        return self._core.state(self._one(rod))

    def _one(self, rod: str | None) -> str:
        rods = self._site.rods
        if rod is not None:
            return rod
        if len(rods) != 1:
            raise KeyError(f"rod: one of {', '.join(rods)} is wanted")
        return rods[0]
