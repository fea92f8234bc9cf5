"""Coverage of the relative force N_t / N_0 of rods that the prior hardly knows, without a test and after each kind of test.

Young's modulus and both springs of every rod are some prior standard deviations off, all three in one direction; the rest is drawn from
the prior, and each mode has a static error of the model. Finite elements of sampler.py give the frequencies of a baseline, of records
after a change of force, and the measurements of a test; the program reads them by `tirante track`. Nothing is shared with it.
Usage: change.py PROGRAM [--rods 100] [--seed 1] [--off 1.5] [--kinds "no test;shapes"] [--jobs 2]
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
STRAINS = [("strains", 0.02)]
LOAD, WEIGHED = [("deflection", 0.03)], [("side", 0.007), ("density", 0.01)]
KINDS = {
    "no test": None,
    "load 3 %": LOAD,
    "load 1 %": [("deflection", 0.01)],
    "mass, ratios": [("ratio", 0.0014)],
    "strain at 0.1 L, mode 1": [("strain_there", 0.02)],
    "strains at 0.05 L": STRAINS,
    "strains at 0.1 L": [("strains_there", 0.02)],
    "shapes": [("shapes", 0.01)],
    "springs": [("springs", 0.05)],
    "caliper and density": WEIGHED,
    "load 3 %, both": LOAD + WEIGHED,
    "load 3 %, strains": LOAD + STRAINS,
    "everything": LOAD + WEIGHED + [("ratio", 0.0014), ("shapes", 0.01)] + STRAINS,
}
START = datetime(2026, 1, 5, tzinfo=timezone.utc)


def at(hours):
    return (START + timedelta(hours=hours)).strftime("%Y-%m-%dT%H:%M:%SZ")


def written(parts, true, rng):
    """The measurements of a test as lines of `[[rod.test]]`."""
    keys = {}
    for what, error in parts:
        # A ratio is not read more exactly than this where it passes through zero.
        sd = error * np.maximum(np.abs(true[what]), sampler.LEAST if what.startswith("strain") else 0.0)
        read = [f"{value:.10g}+-{s:.10g}" for value, s in zip(true[what] + sd * rng.standard_normal(len(sd)), sd)]
        modes = lambda text: [f"mode{order}:{text}={value}" for order, value in enumerate(read, 1)]
        key, lines = {
            "deflection": lambda: ("load", [f"300N@0.5L={read[0].replace('+-', 'm+-')}m"]),
            "ratio": lambda: ("mass", modes(judge.MASS)),
            "strain_there": lambda: ("strain", [f"mode1:0.1L/0.1L={read[0]}"]),
            "strains": lambda: ("strain", modes("0.05L/0.1L")),
            "strains_there": lambda: ("strain", modes("0.1L/0.1L")),
            "shapes": lambda: ("shape", modes("0.1L/0.4L")),
            "side": lambda: ("measured", [f"side={read[0].replace('+-', 'm+-')}m"]),
            "density": lambda: ("measured", [f"density={read[0].replace('+-', 'kg/m3+-')}kg/m3"]),
            "springs": lambda: ("measured", [f"spring_{end}={value.replace('+-', 'Nm/rad+-')}Nm/rad" for end, value in zip(("left", "right"), read)]),
        }[what]()
        keys[key] = keys.get(key, []) + lines
    return "\n".join(f"{key} = {json.dumps(lines)}" for key, lines in keys.items())


def told(program, folder, test, table):
    """Relative force of each changed record."""
    name = folder / "rod.toml"
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
    lines = ["time,f1_hz,sd1_hz,f2_hz,sd2_hz,f3_hz,sd3_hz"]
    for hour, f in enumerate(seen[1:]):
        lines.append(",".join([at(24 + hour)] + [f"{v:.7f},{v * LOG_SD:.7f}" for v in f]))
    moment = f"""
[[rod.test]]
time = {at(0)}
frequencies_hz = [{", ".join(f"{v:.7f}" for v in seen[0])}]
sd_hz = {LOG_SD * seen[0][0]:.7f}
"""
    true = {key: np.atleast_1d(value[0]) for key, value in answer.items()}
    of_kind = lambda kind: np.random.default_rng([args.seed, number, list(KINDS).index(kind)])
    tests = [KINDS[kind] and moment + written(KINDS[kind], true, of_kind(kind)) or "" for kind in args.kinds]
    # The baseline's force is the mean of ln N over its records; two more pass before it is learned.
    reference = np.exp(np.mean(np.log(forces[1 : 1 + BASELINE])))
    truths = forces[3 + BASELINE :] / reference
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        table = folder / "frequencies.csv"
        table.write_text("\n".join(lines) + "\n")
        return truths, [told(args.program, folder, test, table) for test in tests]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--rods", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--off", type=float, default=1.5, help="prior standard deviations, of modulus and springs")
    parser.add_argument("--kinds", default=";".join(KINDS), type=lambda text: text.split(";"), help="names of KINDS, with semicolons")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    with ThreadPoolExecutor(args.jobs) as pool:
        rods = list(pool.map(lambda number: judged(args, number), range(args.rods)))
    for which, name in enumerate(args.kinds):
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
                f"{name:23} {change:+.0%} held {held} of {len(good)} ({100 * a:.1f} to {100 * b:.1f} %), truth below {sum(low)}, above {sum(high)}, "
                f"stated sd {100 * sd:.3f} %, rms error {100 * np.sqrt(np.mean(error**2)):.3f} %, mean error {100 * error.mean():+.3f} %",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
