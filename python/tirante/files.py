"""Stores, results and draws that the program wrote, as data frames."""

from __future__ import annotations

import json
import sqlite3
from os import PathLike
from pathlib import Path
from typing import Union
from urllib.parse import quote

import numpy as np
import pandas as pd

_APPLICATION = 0x54697261
_TABLES = {"records": "record", "periods": "period", "alarms": "alarm", "modes": "mode"}
# The default reads numbers back to the bit from pandas 3.1 on.
_EXACT = {} if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
# Text columns of the program's CSV, text however they look: a rod may be called 01 or NA.
_TEXT = (
    "acknowledged_words", "alarms", "config", "emulator", "events", "file", "flags", "id", "kind", "message", "parameters",
    "rejection", "rejection_message", "rod", "seed", "set_aside", "site", "state", "state_reason",
)
_TIMES = ("start", "raised", "acknowledged", "cleared")


def _times(table: pd.DataFrame) -> pd.DataFrame:
    for name in _TIMES:
        if name in table.columns:
            table[name] = pd.to_datetime(table[name], format="ISO8601", utc=True)
    return table


def read_store(path: Union[str, PathLike[str]], what: str = "records") -> pd.DataFrame:
    """A table of a store: `records`, `periods`, `alarms` or `modes`, times as UTC; the columns are those of docs/store.md.

    Rows of `modes` have the `rod` and `start` of their record. The store is opened for reading alone, also while a daemon
    writes it; its checksums are left to the program.
    """
    if what not in _TABLES:
        raise ValueError(f"what: one of {', '.join(_TABLES)} is wanted")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such store")
    connection = sqlite3.connect(f"file:{quote(str(Path(path).resolve()))}?mode=ro", uri=True)
    try:
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        if application != _APPLICATION:
            raise ValueError(f"{path}: is no store of Tirante")
        if what == "modes":
            query = "SELECT record.rod, record.start, mode.* FROM mode JOIN record ON record.id = mode.record ORDER BY record.start_ns, mode_order"
        else:
            order = {"records": "start_ns, id", "periods": "rod, segment, period", "alarms": "raised, id"}[what]
            query = f"SELECT * FROM {_TABLES[what]} ORDER BY {order}"
        table = pd.read_sql(query, connection)
    except sqlite3.DatabaseError as error:
        raise ValueError(f"{path}: {error}") from error
    finally:
        connection.close()
    return _times(table.drop(columns=["checksum", "identity"], errors="ignore"))


def read_results(path: Union[str, PathLike[str]]) -> pd.DataFrame:
    """Results of a file: lines of JSON (`replay --format json`), or CSV or Parquet of `tirante history`.

    Of JSON, nested fields become columns joined by dots, `axial_force_n.mean`; lists stay lists.
    """
    ending = Path(path).suffix.lower()
    if ending == ".parquet":
        return _times(pd.read_parquet(path))
    if ending == ".csv":
        # Only an empty cell is a missing value.
        return _times(pd.read_csv(path, dtype=dict.fromkeys(_TEXT, str), keep_default_na=False, na_values=[""], **_EXACT))
    with open(path, encoding="utf-8") as lines:
        rows = [json.loads(line) for line in lines if line.strip()]
    return _times(pd.json_normalize(rows))


def read_draws(path: Union[str, PathLike[str]]) -> pd.DataFrame:
    """Posterior draws that `tirante identify --draws-out` wrote: a column a quantity, and `weight`."""
    ending = Path(path).suffix.lower()
    if ending == ".npy":
        return pd.DataFrame(np.load(path, allow_pickle=False))
    if ending == ".parquet":
        return pd.read_parquet(path)
    return pd.read_csv(path, dtype=np.float64, **_EXACT)
