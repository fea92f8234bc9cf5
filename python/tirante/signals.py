"""Spectra and resonances of arrays, of no rod in particular."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from . import _core


def samples_of(values: ArrayLike) -> NDArray[np.float64]:
    """One contiguous row of doubles; an array that is one already is not copied. Masked samples are missing, NaN."""
    if np.iscomplexobj(values):
        raise TypeError("samples: real numbers are wanted, these are complex")
    if isinstance(values, np.ma.MaskedArray):
        values = values.astype(np.float64).filled(np.nan)
    given = np.asarray(values, dtype=np.float64, order="C")
    if given.ndim != 1:
        raise ValueError(f"samples: one row is wanted, the array has {given.ndim} dimensions")
    return given


@dataclass(frozen=True)
class Spectrum:
    """A one-sided power spectral density by Welch's method."""

    df_hz: float
    """Distance of neighbouring lines in hertz."""
    psd: NDArray[np.float64]
    """Density at each line, unit^2/Hz."""
    segments: int | None = None
    """Segments averaged, if known."""

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequency of each line in hertz."""
        return np.arange(self.psd.size, dtype=np.float64) * self.df_hz


@dataclass(frozen=True)
class Resonances:
    """Resonances of a signal."""

    motion: str
    """Recognised motion: `ambient`, `free-decay`, `free-decays` or `blow`."""
    table: pd.DataFrame
    """One row a resonance: `frequency_hz`, `frequency_sd_hz`, `damping`, `damping_log_sd`, `peak_to_noise`, `line`."""


def spectrum(
    samples: ArrayLike,
    fs_hz: float,
    *,
    segment_s: float | None = None,
    overlap: float = 0.5,
    window: str = "hann",
) -> Spectrum:
    """Welch's spectrum of samples at `fs_hz`. Doubles in one contiguous row are read in place.

    Segments are a sixth of the record, 10 to 40 s, unless `segment_s` says otherwise; each loses its straight line.
    """
    return Spectrum(*_core.welch(samples_of(samples), fs_hz, segment_s=segment_s, overlap=overlap, window=window))


def resonances(
    samples: ArrayLike,
    fs_hz: float,
    low_hz: float,
    high_hz: float,
    *,
    masks: Sequence[tuple[float, float]] = (),
) -> Resonances:
    """Resonances between two frequencies, refined by maximum likelihood, with standard errors and damping."""
    motion, found = _core.resonances(samples_of(samples), fs_hz, low_hz, high_hz, masks=list(masks))
    columns = ["frequency_hz", "frequency_sd_hz", "damping", "damping_log_sd", "peak_to_noise", "line"]
    return Resonances(motion, pd.DataFrame(found, columns=columns))
