"""Results of records."""

from __future__ import annotations

import json
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from . import _core
from .signals import Spectrum

if TYPE_CHECKING:
    import arviz


class Refused(ValueError):
    """A record that gives no force was asked for one; the message is the reason."""


class Outcome:
    """Result of one record or of frequencies: a force, or the reason why there is none."""

    def __init__(self, core: _core.Outcome) -> None:
        self._core = core

    @cached_property
    def row(self) -> dict[str, Any]:
        """The fields of the line that the program prints for the record with `--format json`."""
        return json.loads(self._core.to_json())

    @property
    def is_identified(self) -> bool:
        """True if there is a force."""
        return self._core.is_identified

    @property
    def rejection(self) -> str | None:
        """Reason why there is no force."""
        rejection = self.row["rejection"]
        return None if rejection is None else rejection["message"]

    @property
    def force(self) -> dict[str, float]:
        """Axial force of the record alone in newtons: `mean`, `sd`, `cv`, `q025`, `q50`, `q975`, `mean_error`."""
        force = self.row["axial_force_n"]
        if force is None:
            raise Refused(self.rejection or "the record has no force of its own")
        return force

    @property
    def conflict(self) -> float | None:
        """Distance of the frequencies from everything the model can produce, in standard deviations."""
        return self.row["conflict"]

    @property
    def doubts(self) -> list[str]:
        """Reasons to doubt the force, the gravest first: `conflict`, `prior`, `orders`, `wide` (docs/measure.md, Marks)."""
        return self._core.doubts

    @property
    def relative_force(self) -> dict[str, float] | None:
        """N_t / N_0 of a tracked record as measured, with the temperature's share."""
        return self.row["relative_force"]

    @property
    def relative_force_at_reference(self) -> dict[str, float] | None:
        """N_t / N_0 of a tracked record at the reference temperature; `None` where temperature or its effect are not known yet."""
        return self.row["relative_force_at_reference"]

    @cached_property
    def modes(self) -> pd.DataFrame:
        """Measured modes: `frequency_hz`, `sd_hz`, `damping`, `misfit`, by `order`."""
        columns = ["order", "frequency_hz", "sd_hz", "damping", "misfit"]
        return pd.DataFrame(self.row["modes"], columns=columns).set_index("order")

    @property
    def spectrum(self) -> Spectrum | None:
        """Welch's spectrum of the record."""
        if self._core.df_hz is None or self._core.psd is None:
            return None
        return Spectrum(self._core.df_hz, self._core.psd)

    @property
    def draws(self) -> pd.DataFrame:
        """Posterior draws, one a row, SI, over the same memory; each counts by its weight."""
        if self._core.draws is None:
            raise Refused(self.rejection or "the record has no posterior of its own")
        return pd.DataFrame(self._core.draws, columns=self._core.quantities, copy=False)

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the draws; they sum to one."""
        if self._core.weights is None:
            raise Refused(self.rejection or "the record has no posterior of its own")
        return self._core.weights

    def resample(self, count: int | None = None, *, seed: int = 1) -> pd.DataFrame:
        """Draws of equal weight, by systematic resampling; as many as there are unless said."""
        weights = self.weights
        count = weights.size if count is None else count
        positions = (np.random.default_rng(seed).random() + np.arange(count)) / count
        chosen = np.searchsorted(np.cumsum(weights), positions * weights.sum(), side="right")
        return self.draws.iloc[np.minimum(chosen, weights.size - 1)].reset_index(drop=True)

    def to_arviz(self, count: int | None = None, *, seed: int = 1) -> arviz.InferenceData:
        """The posterior as ArviZ's InferenceData, in draws of equal weight, with the frequencies as observed data.

        The draws are independent: there is one chain, and its diagnostics of mixing say nothing.
        """
        import arviz

        draws = self.resample(count, seed=seed)
        uncertain = [name for name in draws.columns if draws[name].nunique() > 1]
        posterior = {name: draws[name].to_numpy()[np.newaxis, :] for name in uncertain}
        orders = [int(order) for order in self.modes.index]
        data = arviz.from_dict(
            posterior=posterior,
            observed_data={"frequency_hz": self.modes["frequency_hz"].to_numpy()},
            constant_data={"frequency_sd_hz": self.modes["sd_hz"].to_numpy()},
            coords={"mode": orders},
            dims={"frequency_hz": ["mode"], "frequency_sd_hz": ["mode"]},
        )
        for key in ("rod", "start", "seed", "config", "epsilon", "ess", "conflict"):
            value = self.row[key]
            if value is not None:
                # 64 bits without a sign do not fit every format that ArviZ writes.
                data.posterior.attrs[key] = str(value) if key == "seed" else value
        return data

    def __repr__(self) -> str:
        rod = self.row["rod"]
        if self.row["axial_force_n"] is not None:
            force = self.force
            mark = "" if not self.doubts else "! " if {"conflict", "prior"} & set(self.doubts) else "? "
            doubts = f" ({', '.join(self.doubts)})" if self.doubts else ""
            return f"<Outcome {rod}: {mark}{force['mean'] / 1e3:.1f} kN, sd {force['sd'] / 1e3:.1f} kN{doubts}>"
        return f"<Outcome {rod}: {self.rejection or 'frequencies alone'}>"
