"""Axial force of tie-rods from vibration records, with its uncertainty.

Numbers are those of the program `tirante`, to the bit, for the same input and seed. Units are SI; names carry them.

>>> import tirante
>>> site = tirante.Site.load()                 # the rod of the paper; Site.load("site.toml") reads yours
>>> found = site.identify_frequencies([4.492, 9.288, 13.252], sd_hz=1e-3**0.5)
>>> round(found.force["mean"] / 1e3)           # kN
558
"""

from .files import read_draws, read_results, read_store
from .outcome import Outcome, Refused
from .signals import Resonances, Spectrum, resonances, spectrum
from .site import Event, Records, Site, Tracker

__all__ = [
    "Event",
    "Outcome",
    "Records",
    "Refused",
    "Resonances",
    "Site",
    "Spectrum",
    "Tracker",
    "read_draws",
    "read_results",
    "read_store",
    "resonances",
    "spectrum",
]
