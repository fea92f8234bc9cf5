"""The package against the program: the same numbers to the bit, and the same refusals."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tirante

ROOT = Path(__file__).parents[2]
PROGRAM = Path(sys.executable).with_name("tirante")
PAPER = [4.492, 9.288, 13.252]
PAPER_SD = 0.031_622_776_601_683_79


def program(*words, code=0, cwd=ROOT):
    """Output of the program that the wheel installed."""
    run = subprocess.run([PROGRAM, *map(str, words)], cwd=cwd, capture_output=True, text=True, check=False)
    assert run.returncode == code, run.stderr
    return run.stdout


def lines(text):
    return [json.loads(line) for line in text.splitlines()]


@pytest.fixture(scope="module")
def paper():
    return tirante.Site.load()


def test_the_wheel_brings_the_program():
    assert program("--version").startswith("tirante ")


def test_frequencies_give_the_programs_numbers_and_draws(paper, tmp_path):
    found = paper.identify_frequencies(PAPER, PAPER_SD)
    files = {}
    for ending in ("npy", "csv"):
        files[ending] = tmp_path / f"draws.{ending}"
        words = ["identify", "--frequencies", ",".join(map(str, PAPER)), "--draws-out", files[ending], "--format", "json"]
        assert lines(program(*words)) == [found.row]
        draws = tirante.read_draws(files[ending])
        pd.testing.assert_frame_equal(draws.drop(columns="weight"), found.draws, check_exact=True)
        assert np.array_equal(draws["weight"], found.weights)
    mean = np.average(found.draws["axial_force_n"], weights=found.weights)
    # One sum against another: rounding alone.
    assert mean == pytest.approx(found.force["mean"], rel=1e-12)


def test_a_force_in_doubt_bears_its_mark(paper):
    doubted = paper.identify_frequencies(PAPER, 0.005)
    assert doubted.doubts == ["conflict"]
    assert " ! " in repr(doubted) and repr(doubted).endswith("kN (conflict)>"), repr(doubted)
    hz = paper.frequencies(dict(zip(paper.quantities(), [800e3, 2.0e11, 7700, 0.0715, 3e5, 3e5, 14.0])))
    believed = paper.identify_frequencies(hz, 0.005)
    assert believed.doubts == [] and "!" not in repr(believed) and "(" not in repr(believed), repr(believed)


def test_a_force_without_an_order_of_magnitude_bears_its_mark():
    support = {"fixity_low": 0, "fixity_high": 0.99, "ends": 2}
    bar = tirante.Site.of_rod(
        "square",
        length_m=19.09,
        axial_force_n={"low": 1e3, "high": 1.555e7, "even_in": "logarithm"},
        youngs_modulus_pa={"mean": 1.9e11, "cv": 0.1},
        density_kg_m3={"mean": 7650, "cv": 0.03},
        side_m={"mean": 0.2277, "cv": 0.02},
        spring_left_n_m=support,
        spring_right_n_m=support,
    )
    found = bar.identify_frequencies([2.438, 7.544, 15.540], 0.001)
    assert found.force["q975"] > 10 * found.force["q025"] and found.doubts == ["wide"]
    assert " ? " in repr(found) and repr(found).endswith("kN (wide)>"), repr(found)


def test_a_missing_mode_keeps_its_place(paper):
    found = paper.identify_frequencies([4.492, None, 13.252], [0.005, None, 0.01])
    words = ["identify", "--frequencies", "4.492,-,13.252", "--sd", "0.005,-,0.01", "--format", "json"]
    assert lines(program(*words)) == [found.row]


def test_a_described_rod_is_the_configurations():
    site = tirante.Site.of_rod(
        "round",
        name="rod-1",
        length_m=12.5,
        axial_force_n={"mean": 150e3, "cv": 0.3},
        youngs_modulus_pa={"mean": 190e9, "cv": 0.1},
        density_kg_m3={"mean": 7600, "cv": 0.03},
        diameter_m=0.045,
        spring_left_n_m={"low": 0, "high": 500e3},
        spring_right_n_m={"low": 0, "high": 500e3},
    )
    hz = site.frequencies(dict(zip(site.quantities(), [150e3, 190e9, 7600, 0.045, 1e5, 1e5, 12.5])))
    found = site.identify_frequencies(hz, 0.01)
    given = ",".join(map(repr, hz))
    words = ["identify", "--frequencies", given, "--sd", "0.01", "--config", "config/minimal.toml", "--format", "json"]
    printed = lines(program(*words))[0]
    # The hash of the configuration holds names that change no number.
    assert {**found.row, "config": None} == {**printed, "config": None}
    assert found.force["q025"] < 150e3 < found.force["q975"]


def test_a_recording_gives_the_programs_line(paper):
    path = ROOT / "recordings/todi-pull.mcap"
    records = paper.read(path)
    (record,) = [event for event in records if event.kind == "record"]
    found = paper.identify(record)
    printed = lines(program("identify", path, "--format", "json"))
    assert printed == [found.row]
    # An array does not say that it begins at a release, as the recording's cut does: the motion is recognised.
    again = paper.record(record.samples(), record.fs_hz, record.start_ns)
    assert np.array_equal(again.samples(), record.samples())
    same = paper.identify(again)
    assert list(same.modes.index) == [1, 2, 3]
    assert (np.abs(same.modes["frequency_hz"] - found.modes["frequency_hz"]) < found.modes["sd_hz"]).all()
    assert np.array_equal(same.spectrum.psd, found.spectrum.psd)
    assert found.spectrum.psd.size > 100
    alone = tirante.spectrum(record.samples(), record.fs_hz)
    assert np.array_equal(alone.psd, found.spectrum.psd)
    assert alone.frequency_hz[1] == found.spectrum.df_hz


def test_records_give_the_relative_force_of_a_replay(tmp_path):
    folder = ROOT / "recordings/campaign-2025.mcap"
    config = ROOT / "config/campaign.toml"
    store = tmp_path / "campaign.db"
    printed = lines(program("replay", folder, "--config", config, "--store", store, "--format", "json"))
    site = tirante.Site.load(config)
    followed = [outcome.row for outcome in site.track(site.read(folder))]
    assert followed == printed
    assert sum(row["relative_force"] is not None for row in followed) > 10
    table = tirante.read_store(store)
    assert table["relative_force"].dropna().tolist() == [
        row["relative_force"]["mean"] for row in sorted(printed, key=lambda row: row["start"]) if row["relative_force"]
    ]
    assert str(table["start"].dtype).endswith(", UTC]")
    modes = tirante.read_store(store, "modes")
    assert len(modes) == sum(len(row["modes"]) for row in printed)
    results = tmp_path / "results.jsonl"
    results.write_text("".join(json.dumps(row) + "\n" for row in printed))
    assert tirante.read_results(results)["axial_force_n.mean"].tolist()[0] == printed[0]["axial_force_n"]["mean"]
    csv = tmp_path / "history.csv"
    csv.write_text(program("history", "--store", store, "--format", "csv"))
    pd.testing.assert_series_equal(
        tirante.read_results(csv)["axial_force_n"], table["axial_force_n"], check_exact=True
    )
    for what in ("periods", "alarms"):
        tirante.read_store(store, what)


def test_frequencies_of_a_table_are_tracked_as_by_the_program(tmp_path):
    config = ROOT / "config/minimal.toml"
    site = tirante.Site.load(config)
    rows = []
    for day in range(34):
        force = 150e3 if day < 31 else 135e3
        truth = dict(zip(site.quantities(), [force, 190e9, 7600, 0.045, 1e5, 1e5, 12.5]))
        rows.append((f"{np.datetime64('2026-01-01') + day}T00:00:00Z", site.frequencies(truth)))
    table = tmp_path / "table.csv"
    table.write_text(
        "time,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz\n"
        + "".join(f"{time}," + ",".join(f"{hz!r},0.002" for hz in given) + "\n" for time, given in rows)
    )
    tracker = site.tracker()
    followed = [tracker.take_frequencies(time, hz, 0.002).row for time, hz in rows]
    assert followed == lines(program("track", table, "--config", config, "--format", "json"))
    last = followed[-1]["relative_force"]
    assert last["q025"] < 0.9 < last["q975"]
    # The same row again is no new record.
    assert tracker.take_frequencies(rows[0][0], rows[0][1], 0.002) is None


def test_a_time_is_never_guessed(paper):
    import datetime

    from tirante.site import nanoseconds

    stamp = pd.Timestamp("2026-01-01T00:00:00Z")
    zoned = datetime.datetime(2026, 1, 1, 1, tzinfo=datetime.timezone(datetime.timedelta(hours=1)))
    for same in (stamp, "2026-01-01", np.datetime64("2026-01-01"), zoned, stamp.value, np.int64(stamp.value)):
        assert nanoseconds(same) == stamp.value
    tracker = paper.tracker()
    for missing in (pd.NaT, np.datetime64("NaT"), None, float("nan"), 1767225600.0, np.float64(1767225600), True):
        with pytest.raises((TypeError, ValueError), match="time"):
            tracker.take_frequencies(missing, PAPER, PAPER_SD)
    # Seconds, milliseconds and microseconds as whole numbers, and no time at all.
    for seconds in (0, 1_767_225_600, 1_767_225_600_000, 1_767_225_600_000_000):
        with pytest.raises(ValueError, match="nanoseconds"):
            tracker.take_frequencies(seconds, PAPER, PAPER_SD)


def test_a_record_without_a_time_is_identified_but_not_tracked(paper, tmp_path):
    (record,) = paper.read(ROOT / "recordings/todi-pull.mcap")
    table = tmp_path / "undated.csv"
    np.savetxt(table, record.samples(), header="displacement [m]", comments="")
    undated = list(paper.read(table, rate_hz=record.fs_hz))
    assert paper.identify(undated[0]).is_identified
    config = tmp_path / "site.toml"
    config.write_text(paper.effective)
    program("replay", table, "--config", config, "--rate", record.fs_hz, "--store", tmp_path / "site.db", code=1)
    for events in (undated, [paper.record(record.samples(), record.fs_hz)]):
        with pytest.raises(ValueError, match="todi.*`start`"):
            list(paper.track(events))
    (outcome,) = paper.track(paper.read(table, rate_hz=record.fs_hz, start="2026-03-01T10:00Z"))
    assert outcome.row["start"] == "2026-03-01T10:00:00Z"


def test_masked_samples_and_frequencies_are_missing(paper):
    t = np.arange(6_000) / 100.0
    samples = 1e-4 * np.sin(2 * np.pi * 4.5 * t) * np.exp(-0.1 * t)
    samples[2_000:2_003] = -9999.0
    masked = np.ma.masked_equal(samples, -9999.0)
    nan = np.where(masked.mask, np.nan, samples)
    assert np.array_equal(paper.record(masked, 100.0).samples(), paper.record(nan, 100.0).samples())
    assert np.abs(paper.record(masked, 100.0).samples()).max() < 2e-4
    whole = np.ma.masked_array([1, 2, -9999], mask=[0, 0, 1])
    assert np.array_equal(tirante.signals.samples_of(whole), [1.0, 2.0, np.nan], equal_nan=True)
    with pytest.raises(TypeError, match="complex"):
        paper.record(samples + 1j, 100.0)
    wanted = paper.identify_frequencies([4.492, None, 13.252], 0.01).row
    for missing in (np.nan, pd.NA, np.ma.masked):
        assert paper.identify_frequencies([4.492, missing, 13.252], 0.01).row == wanted
    assert paper.identify_frequencies(np.ma.masked_equal([4.492, -1.0, 13.252], -1.0), 0.01).row == wanted


def test_a_record_is_motion(paper, tmp_path):
    for unit in ("degC", "K", "ue"):
        with pytest.raises(ValueError, match="unit.*motion.*m/s2"):
            paper.record(np.zeros(10), 1.0, unit=unit)
        with pytest.raises(ValueError, match="unit.*motion"):
            paper.read(tmp_path / "any.csv", unit=unit)


def test_names_of_rods_stay_text(tmp_path):
    csv = tmp_path / "history.csv"
    seed = "18446744073709551615"
    csv.write_text(f"rod,start,state,axial_force_n,seed\n01,2026-01-01T00:00:00Z,learning,,{seed}\nNA,2026-01-02T00:00:00Z,null,1.5,\n")
    table = tirante.read_results(csv)
    assert table["rod"].tolist() == ["01", "NA"]
    assert table["state"].tolist() == ["learning", "null"]
    assert table["axial_force_n"].isna().tolist() == [True, False]
    assert table["seed"].isna().tolist() == [False, True] and table["seed"][0] == seed
    assert str(table["start"].dtype).endswith(", UTC]")


def test_amplitude_and_length_of_a_row_count_as_in_a_table(tmp_path):
    config = ROOT / "config/minimal.toml"
    site = tirante.Site.load(config)
    truth = dict(zip(site.quantities(), [150e3, 190e9, 7600, 0.045, 1e5, 1e5, 12.5]))
    hz = site.frequencies(truth)
    # The tenth day's sensor gives millimetres for metres.
    rows = [(f"{np.datetime64('2026-01-01') + day}T00:00:00Z", 1e-5 if day != 9 else 1e-2) for day in range(12)]
    table = tmp_path / "table.csv"
    given = ",".join(f"{f!r},0.002" for f in hz)
    table.write_text("time,duration_s,rms,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz\n" + "".join(f"{time},600,{rms!r},{given}\n" for time, rms in rows))
    tracker = site.tracker()
    followed = [tracker.take_frequencies(time, hz, 0.002, duration_s=600, rms=rms).row for time, rms in rows]
    assert followed == lines(program("track", table, "--config", config, "--format", "json"))
    assert [row["set_aside"] for row in followed].count("amplitude") == 1
    for wrong in ({"rms": -1.0}, {"rms": float("nan")}, {"duration_s": float("inf")}):
        with pytest.raises(ValueError, match="rms"):
            tracker.take_frequencies("2027-01-01", hz, 0.002, **wrong)


def test_resonances_of_an_array():
    t = np.arange(12_000) / 200.0
    signal = sum(np.exp(-0.002 * 2 * np.pi * n * 5 * t) * np.sin(2 * np.pi * n * 5 * t) / n for n in (1, 2, 3))
    found = tirante.resonances(np.round(1e-4 * signal, 8), 200.0, 2.0, 40.0)
    assert found.motion == "free-decay"
    nearest = [np.abs(found.table["frequency_hz"] - hz).min() for hz in (5, 10, 15)]
    # The fit's own error of such a decay is far below a millihertz; the resolution of 10 nm adds nothing to speak of.
    assert max(nearest) < 1e-3


def test_arviz_has_the_posterior(paper, tmp_path):
    arviz = pytest.importorskip("arviz")
    found = paper.identify_frequencies(PAPER, PAPER_SD)
    data = found.to_arviz()
    assert isinstance(data, arviz.InferenceData)
    force = data.posterior["axial_force_n"].to_numpy()
    assert force.shape == (1, len(found.weights))
    # Systematic resampling: each weight within one of its share, so the mean is off by a small part of the spread.
    assert abs(force.mean() - found.force["mean"]) < 0.02 * found.force["sd"]
    assert "length_m" not in data.posterior, "a quantity known exactly has no posterior"
    data.to_netcdf(tmp_path / "posterior.nc")
    again = arviz.from_netcdf(tmp_path / "posterior.nc")
    assert again.posterior.attrs["rod"] == "todi"


def test_memory_is_shared_and_not_to_be_written(paper):
    found = paper.identify_frequencies(PAPER, PAPER_SD)
    assert np.shares_memory(found.draws.to_numpy(), found._core.draws)
    with pytest.raises(ValueError):
        found.weights[0] = 1.0


def test_nonsense_is_refused_with_a_reason(paper, tmp_path):
    with pytest.raises(ValueError, match="side_m"):
        tirante.Site.of_rod("square", length_m=14, axial_force_n=1e5)
    with pytest.raises(ValueError, match="no key|unknown|did you mean|not a key"):
        tirante.Site.of_rod("square", length_m=14, sidem=1)
    for hz, sd in (([], 0.1), ([5, 4], 0.1), ([float("inf")], 0.1), ([4.0], 0.0), ([4.0] * 6, 0.1), ([4.0, 9.0], [0.1])):
        with pytest.raises(ValueError):
            paper.identify_frequencies(hz, sd)
    with pytest.raises(KeyError, match="todi"):
        paper.identify_frequencies(PAPER, 0.03, rod="elsewhere")
    refused = paper.identify_frequencies([40.0, 90.0, 140.0], 0.01)
    assert not refused.is_identified and refused.rejection
    with pytest.raises(tirante.Refused):
        refused.force
    with pytest.raises(tirante.Refused):
        refused.draws
    with pytest.raises(OSError):
        list(paper.read(tmp_path / "nothing.mcap"))
    with pytest.raises(ValueError, match="/todi/displacement"):
        list(paper.read(ROOT / "recordings/aisle.mcap"))
    flat = paper.record(np.zeros(10_000), 100.0)
    assert flat.kind == "rejected" and "constant" in flat.reason
    assert "constant" in paper.identify(flat).rejection
    with pytest.raises(ValueError, match="rate"):
        paper.record(np.zeros(10), 0.0)
    with pytest.raises(ValueError, match="unit"):
        paper.record(np.zeros(10), 1.0, unit="furlong")
    with pytest.raises(ValueError, match="dimensions"):
        tirante.spectrum(np.zeros((2, 2)), 1.0)
    with pytest.raises(FileNotFoundError):
        tirante.read_store(tmp_path / "nothing.db")
    (tmp_path / "text.db").write_text("no database " * 100)
    with pytest.raises(ValueError):
        tirante.read_store(tmp_path / "text.db")
