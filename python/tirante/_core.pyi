"""The compiled part of the package; the modules beside it are its face."""

from collections.abc import Sequence
from os import PathLike
from typing import final

import numpy as np
from numpy.typing import NDArray

__all__ = ["Event", "Outcome", "Records", "Site", "Tracker", "resonances", "welch"]

_Floats = NDArray[np.float64]
_Mode = tuple[int, float, float]

@final
class Event:
    @property
    def kind(self) -> str: ...
    @property
    def rod(self) -> str: ...
    @property
    def start_ns(self) -> int | None: ...
    @property
    def duration_s(self) -> float | None: ...
    @property
    def fs_hz(self) -> float | None: ...
    @property
    def temperature_c(self) -> float | None: ...
    @property
    def reason(self) -> str | None: ...
    @property
    def readings(self) -> list[tuple[int, float]]: ...
    def samples(self) -> _Floats | None: ...

@final
class Records:
    def __iter__(self) -> Records: ...
    def __next__(self) -> Event: ...
    @property
    def notes(self) -> list[str]: ...

@final
class Outcome:
    def to_json(self) -> str: ...
    @property
    def is_identified(self) -> bool: ...
    @property
    def doubts(self) -> list[str]: ...
    @property
    def quantities(self) -> list[str]: ...
    @property
    def draws(self) -> _Floats | None: ...
    @property
    def weights(self) -> _Floats | None: ...
    @property
    def df_hz(self) -> float | None: ...
    @property
    def psd(self) -> _Floats | None: ...

@final
class Tracker:
    def take(self, outcome: Outcome) -> Outcome | None: ...
    def take_readings(self, event: Event) -> bool: ...
    def take_frequencies(
        self,
        rod: str,
        start_ns: int,
        given: Sequence[_Mode],
        *,
        temperature_c: float | None = None,
        duration_s: float = 0.0,
        rms: float | None = None,
    ) -> Outcome | None: ...
    def state(self, rod: str) -> str: ...

@final
class Site:
    @staticmethod
    def load(path: str | PathLike[str] | None = None, settings: Sequence[tuple[str, str]] = ...) -> Site: ...
    @staticmethod
    def parse(text: str) -> Site: ...
    @property
    def name(self) -> str: ...
    @property
    def rods(self) -> list[str]: ...
    @property
    def effective(self) -> str: ...
    def identify_frequencies(self, given: Sequence[_Mode], rod: str | None = None) -> Outcome: ...
    def identify(self, event: Event) -> Outcome: ...
    def record(
        self,
        samples: _Floats,
        fs_hz: float,
        start_ns: int,
        *,
        rod: str | None = None,
        unit: str | None = None,
        temperature_c: float | None = None,
    ) -> Event: ...
    def read(
        self,
        paths: Sequence[str | PathLike[str]],
        *,
        rate_hz: float | None = None,
        unit: str | None = None,
        start_ns: int | None = None,
    ) -> Records: ...
    def tracker(self) -> Tracker: ...
    def frequencies(self, quantities: Sequence[float], modes: int = 3, rod: str | None = None) -> list[float]: ...
    def quantities(self, rod: str | None = None) -> list[str]: ...

def welch(
    samples: _Floats,
    fs_hz: float,
    *,
    segment_s: float | None = None,
    overlap: float = 0.5,
    window: str = "hann",
) -> tuple[float, _Floats, int]: ...
def resonances(
    samples: _Floats,
    fs_hz: float,
    low_hz: float,
    high_hz: float,
    *,
    masks: Sequence[tuple[float, float]] = ...,
) -> tuple[str, list[tuple[float, float, float, float, float, bool]]]: ...
