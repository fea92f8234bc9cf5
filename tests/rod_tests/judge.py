"""Calibration of the axial force that `tirante identify` gives with each kind of test of a rod.

Rods are drawn from the prior, measured by the finite elements of sampler.py with normal errors of known size, and given to the program's
command line: nothing is shared with it. For each kind of datum it prints the coverage of the 95 % interval with its exact interval, the
chi-square of the truth's rank among the draws in ten equal classes with its probability, and how often the program refused.
Usage: judge.py PROGRAM [--rods 200] [--seed 1] [--priors paper,informed] [--kinds ...] [--jobs 2] [--out rows.jsonl]
"""
import os

os.environ.setdefault("ELEMENTS", "120")  # the strain near a support needs them
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import argparse
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import sampler

PRIORS = {"paper": (sampler.PAPER, 0.0), "informed": (sampler.INFORMED, 0.01)}
QUANTITIES = ("axial_force_n", "youngs_modulus_pa", "density_kg_m3", "side_m", "spring_left_n_m", "spring_right_n_m")
SD_HZ = 0.01
MASS = "20kg@0.3L"
KINDS = {
    "frequencies alone": [],
    "load 3 %": [("deflection", 0.03)],
    "load 1 %": [("deflection", 0.01)],
    "mass, ratios": [("ratio", 0.0014)],
    "mass, frequencies": [("heavy", 0.0)],
    "strain at 0.05 L": [("strain", 0.02)],
    "strain there": [("strain_there", 0.02)],
    "shapes": [("shapes", 0.01)],
    "caliper": [("side", 0.007)],
    "density": [("density", 0.01)],
    "caliper and density": [("side", 0.007), ("density", 0.01)],
    "springs": [("springs", 0.05)],
    "everything": [("deflection", 0.03), ("ratio", 0.0014), ("strain", 0.02), ("shapes", 0.01), ("side", 0.007), ("density", 0.01)],
}


def configuration(name):
    prior, discrepancy = PRIORS[name]
    lines = [f"{quantity} = {{ mean = {mean!r}, cv = {cv!r} }}" for quantity, (mean, cv) in zip(QUANTITIES, prior.tolist())]
    return f"""[site]
name = "calibration"
[[rod]]
id = "rod"
length_m = {sampler.LENGTH}
section = "square"
discrepancy = {discrepancy}
[rod.priors]
{chr(10).join(lines)}
[rod.channel]
topic = "/rod"
unit = "m"
"""


def rod(prior, rng):
    """One rod of the zero-truncated normals."""
    while True:
        theta = prior[:, 0] * (1 + prior[:, 1] * rng.standard_normal(6))
        if np.all(theta > 0):
            return theta


def flags(kind, theta, discrepancy, rng):
    """The measurements of one rod as arguments of `identify`."""
    true = {key: np.atleast_1d(value[0]) for key, value in sampler.model(theta[None]).items()}
    shared = 1 + discrepancy * rng.standard_normal(3)
    seen = true["f"] * shared + SD_HZ * rng.standard_normal(3)
    joined = lambda values: ",".join(f"{value:.6f}" for value in values)
    out = ["--frequencies", joined(seen), "--sd", str(SD_HZ)]
    for what, error in KINDS[kind]:
        if what == "heavy":
            heavy = true["f"] * true["ratio"] * shared + SD_HZ * rng.standard_normal(3)
            out += ["--mass", MASS, "--mass-frequencies", joined(heavy), "--mass-sd", str(SD_HZ)]
            continue
        sd = error * np.abs(true[what])
        told = true[what] + sd * rng.standard_normal(len(sd))
        pairs = list(enumerate(zip(told, sd), 1))
        if what == "deflection":
            out += ["--load", f"300N@0.5L={told[0] * 1e3:.8f}mm+-{sd[0] * 1e3:.8f}mm"]
        elif what == "ratio":
            for order, (value, s) in pairs:
                out += ["--mass", f"mode{order}:{MASS}={value:.8f}+-{s:.8f}"]
        elif what in ("strain", "strain_there"):
            place = "0.05L" if what == "strain" else "0.1L"
            out += ["--strain", f"mode1:{place}/0.1L={told[0]:.10f}+-{sd[0]:.10f}"]
        elif what == "shapes":
            for order, (value, s) in pairs:
                out += ["--shape", f"mode{order}:0.1L/0.4L={value:.8f}+-{s:.8f}"]
        elif what == "side":
            out += ["--measured", f"side={told[0] * 1e3:.6f}mm+-{sd[0] * 1e3:.6f}mm"]
        elif what == "density":
            out += ["--measured", f"density={told[0]:.4f}kg/m3+-{sd[0]:.4f}kg/m3"]
        else:
            for name, (_, (value, s)) in zip(("spring_left", "spring_right"), pairs):
                out += ["--measured", f"{name}={value:.3f}Nm/rad+-{s:.3f}Nm/rad"]
    return out


def judged(program, folder, name, kind, number, seed):
    prior, discrepancy = PRIORS[name]
    rng = np.random.default_rng([seed, list(PRIORS).index(name), list(KINDS).index(kind), number])
    theta = rod(prior, rng)
    draws = folder / f"{name}-{list(KINDS).index(kind)}-{number}.npy"
    command = [program, "identify", "--config", str(folder / f"{name}.toml"), "--format", "json", "--draws-out", str(draws)]
    command += flags(kind, theta, discrepancy, rng) + ["--seed", str(number + 1)]
    run = subprocess.run(command, capture_output=True, text=True)
    row = {"prior": name, "kind": kind, "number": number, "truth_n": theta[0], "exit": run.returncode}
    lines = run.stdout.splitlines()
    if not lines:
        return row | {"said": run.stderr.strip()}
    told = json.loads(lines[-1])
    force = told["axial_force_n"]
    if force is None:
        return row | {"said": told["rejection"]["message"]}
    sample = np.load(draws)
    draws.unlink()
    return row | {
        "inside": bool(force["q025"] <= theta[0] <= force["q975"]),
        "rank": float(np.average(sample["axial_force_n"] < theta[0], weights=sample["weight"])),
        "cv": force["cv"],
        "ess": told["ess"],
        "conflict": told["conflict"],
        "sampler": (told["tested"] or {}).get("sampler", "rejection"),
    }


def exact(count, of):
    """Clopper-Pearson interval by bisection of the binomial sum."""
    from math import comb

    tail = lambda p, low, high: sum(comb(of, i) * p**i * (1 - p) ** (of - i) for i in range(low, high + 1))

    def root(function):
        a, b = 0.0, 1.0
        for _ in range(60):
            mid = 0.5 * (a + b)
            a, b = (mid, b) if function(mid) else (a, mid)
        return a

    low = 0.0 if count == 0 else root(lambda p: tail(p, count, of) < 0.025)
    high = 1.0 if count == of else root(lambda p: tail(p, 0, count) > 0.025)
    return low, high


def chance(chi2, rng=np.random.default_rng(0)):
    """Probability that ten equal classes are at least as uneven (chi-square, 9 degrees)."""
    return float(np.mean(rng.chisquare(9, 200_000) >= chi2))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--rods", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--priors", default=",".join(PRIORS))
    parser.add_argument("--kinds", default=",".join(KINDS).replace("mass, ", "mass; "))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    kinds = [kind.replace("mass; ", "mass, ") for kind in args.kinds.split(",")]
    out = args.out.open("a") if args.out else None
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(args.jobs) as pool:
        folder = Path(folder)
        for name in args.priors.split(","):
            (folder / f"{name}.toml").write_text(configuration(name))
            for kind in kinds:
                rows = list(pool.map(lambda i: judged(args.program, folder, name, kind, i, args.seed), range(args.rods)))
                for row in rows:
                    if out:
                        print(json.dumps(row), file=out, flush=True)
                forces = [row for row in rows if "inside" in row]
                refused = len(rows) - len(forces)
                if not forces:
                    print(f"{name:9} {kind:20} refused {refused}: {rows[0].get('said')}", flush=True)
                    continue
                held = sum(row["inside"] for row in forces)
                low, high = exact(held, len(forces))
                classes = np.histogram([row["rank"] for row in forces], 10, (0, 1))[0]
                chi2 = float(((classes - len(forces) / 10) ** 2).sum() / (len(forces) / 10))
                samplers = {s: sum(row["sampler"] == s for row in forces) for s in sorted({row["sampler"] for row in forces})}
                print(
                    f"{name:9} {kind:20} held {100 * held / len(forces):5.1f} % ({100 * low:.1f} to {100 * high:.1f}) of {len(forces)}, "
                    f"ranks chi2 {chi2:.1f} p {chance(chi2):.3f}, cv {np.median([row['cv'] for row in forces]):.3f}, "
                    f"refused {refused}, {samplers}",
                    flush=True,
                )


if __name__ == "__main__":
    sys.exit(main())
