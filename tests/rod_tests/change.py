"""Coverage of the relative force N_t / N_0 of rods that the prior hardly knows, with and without a load test in the configuration.

Young's modulus and both springs of every rod are some prior standard deviations off, all three in one direction; the rest is drawn from
the prior, and each mode has a static error of the model. Finite elements of sampler.py give the frequencies of a baseline, of records
after a change of force, and the deflection under one load; the program reads them by `tirante track`. Nothing is shared with it.
Usage: change.py PROGRAM [--rods 100] [--seed 1] [--off 1.5] [--error 0.03] [--jobs 2]
"""
import argparse
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta, timezone
from pathlib import Path

import judge
import numpy as np
import sampler

DISCREPANCY, LOG_SD, BASELINE = 0.01, 1e-3, 30
CHANGES = (-0.20, -0.10, -0.05, 0.05, 0.10)
START = datetime(2026, 1, 5, tzinfo=timezone.utc)


def at(hours):
    return (START + timedelta(hours=hours)).strftime("%Y-%m-%dT%H:%M:%SZ")


def told(program, folder, test, table):
    """Relative force of each changed record, and what the program says of the modulus and the springs."""
    name = folder / ("with.toml" if test else "without.toml")
    text = judge.configuration("paper").replace("discrepancy = 0.0", f"discrepancy = {DISCREPANCY}")
    name.write_text(text + test)
    run = subprocess.run([program, "track", str(table), "--config", str(name), "--format", "json"], capture_output=True, text=True)
    lines = [json.loads(line) for line in run.stdout.splitlines()]
    rows = [line for line in lines if "relative_force" in line]
    changed = [row["relative_force"] for row in rows[-len(CHANGES) :]]
    if run.returncode or len(rows) != BASELINE + 2 + len(CHANGES) or None in changed:
        return "; ".join(str(row.get("rejection") or row.get("set_aside") or row.get("state_reason")) for row in rows[-len(CHANGES) :]) or run.stderr
    return changed


def judged(args, number):
    rng = np.random.default_rng([args.seed, number])
    mean, cv = sampler.PAPER.T
    theta = judge.rod(sampler.PAPER, rng)
    theta[[1, 4, 5]] = (mean * (1 + args.off * cv))[[1, 4, 5]]
    static = 1 + DISCREPANCY * rng.standard_normal(3)
    forces = theta[0] * np.concatenate([[1.0], np.exp(0.05 * np.sin(np.arange(BASELINE + 2))), 1 + np.array(CHANGES)])
    thetas = np.repeat(theta[None], len(forces), 0)
    thetas[:, 0] = forces
    answer = sampler.model(thetas)
    seen = answer["f"] * static * np.exp(LOG_SD * rng.standard_normal((len(forces), 3)))
    deflection = answer["deflection"][0] * (1 + args.error * rng.standard_normal())
    lines = ["time,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz"]
    for hour, f in enumerate(seen[1:]):
        lines.append(",".join([at(24 + hour)] + [f"{v:.7f},{v * LOG_SD:.7f}" for v in f]))
    test = f"""
[[rod.test]]
time = {at(0)}
frequencies_hz = [{", ".join(f"{v:.7f}" for v in seen[0])}]
sd_hz = {LOG_SD * seen[0][0]:.7f}
load = "300N@0.5L={deflection * 1e3:.8f}mm+-{args.error * deflection * 1e3:.8f}mm"
"""
    # The baseline's force is the mean of ln N over its records; two more pass before it is learned.
    reference = np.exp(np.mean(np.log(forces[1 : 1 + BASELINE])))
    truths = forces[3 + BASELINE :] / reference
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        table = folder / "frequencies.csv"
        table.write_text("\n".join(lines) + "\n")
        return truths, [told(args.program, folder, text, table) for text in ("", test)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--rods", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--off", type=float, default=1.5, help="prior standard deviations, of modulus and springs")
    parser.add_argument("--error", type=float, default=0.03, help="relative standard error of the load test")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    with ThreadPoolExecutor(args.jobs) as pool:
        rods = list(pool.map(lambda number: judged(args, number), range(args.rods)))
    for which, name in enumerate(("no test", "one load")):
        good = [(truths, said[which]) for truths, said in rods if isinstance(said[which], list)]
        for _, said in rods:
            if isinstance(said[which], str):
                print(f"{name}: refused: {said[which]}")
        for i, change in enumerate(CHANGES):
            low = [said[i]["q025"] > truths[i] for truths, said in good]
            high = [said[i]["q975"] < truths[i] for truths, said in good]
            held = len(good) - sum(low) - sum(high)
            a, b = judge.exact(held, len(good))
            error = np.array([said[i]["mean"] - truths[i] for truths, said in good])
            sd = np.mean([said[i]["sd"] for truths, said in good])
            print(
                f"{name:8} {change:+.0%} held {held} of {len(good)} ({100 * a:.1f} to {100 * b:.1f} %), truth below {sum(low)}, above {sum(high)}, "
                f"stated sd {100 * sd:.3f} %, rms error {100 * np.sqrt(np.mean(error**2)):.3f} %, mean error {100 * error.mean():+.3f} %",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
