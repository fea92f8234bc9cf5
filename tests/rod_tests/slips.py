"""What becomes of slips in tests of a rod: refused by name, marked as a conflict, or taken in silence.

Rods are drawn from the prior and measured by the finite elements of sampler.py; one measurement is then told wrongly, as people do. The
program hears it beside three frequencies alone, and beside everything else. A slip that is taken in silence is shown with how often the
95 % interval still holds the true force: the width of a prior hides what it hides.
Usage: slips.py PROGRAM [--rods 10] [--seed 1] [--priors paper,informed] [--slips ...] [--jobs 1]
"""
import argparse
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import judge
import numpy as np
import sampler

G = 9.80665


def texts(theta, rng):
    """Every measurement told rightly: name -> list of (flag, format, value, relative error)."""
    t = {key: np.atleast_1d(value[0]) for key, value in sampler.model(theta[None]).items()}
    told = lambda value, error: value * (1 + error * rng.standard_normal())
    deflection = told(t["deflection"][0], 0.03)
    return t["f"] + 0.01 * rng.standard_normal(3), {
        "load": dict(force=300.0, place="0.5L", mm=deflection * 1e3),
        "mass": dict(kg=20.0, place="0.3L", ratios=[told(value, 0.0014) for value in t["ratio"]]),
        "strain": dict(place="0.05L", ratio=told(t["strain"][0], 0.02)),
        "shape": dict(places=("0.1L", "0.4L"), ratios=[told(value, 0.01) for value in t["shapes"]]),
        "side": dict(mm=told(theta[3], 0.007) * 1e3),
        "density": dict(si=told(theta[2], 0.01)),
    }


def flags(told):
    out = []
    if d := told.get("load"):
        for one in d if isinstance(d, list) else [d]:
            out += ["--load", f"{one['force']:.6g}N@{one['place']}={one['mm']:.6g}mm+-3%"]
    if d := told.get("mass"):
        for order, ratio in enumerate(d["ratios"], 1):
            out += ["--mass", f"mode{order}:{d['kg']:.6g}kg@{d['place']}={ratio:.7f}+-0.14%"]
    if d := told.get("strain"):
        out += ["--strain", f"mode1:{d['place']}/0.1L={d['ratio']:.7g}+-2%"]
    if d := told.get("shape"):
        for order, ratio in enumerate(d["ratios"], 1):
            out += ["--shape", f"mode{order}:{d['places'][0]}/{d['places'][1]}={ratio:.7g}+-1%"]
    if d := told.get("side"):
        out += ["--measured", f"side={d['mm']:.6g}mm+-0.7%"]
    if d := told.get("density"):
        out += ["--measured", f"density={d['si']:.6g}kg/m3+-1%"]
    return out


def scaled(name, key, by):
    def slip(d):
        d[name][key] = [by * value for value in d[name][key]] if isinstance(d[name][key], list) else by * d[name][key]
    return slip


def put(name, key, value):
    def slip(d):
        d[name][key] = value
    return slip


def swapped(d):
    d["shape"]["ratios"] = [1 / value for value in d["shape"]["ratios"]]


def second_load(d):
    d["load"] = [d["load"], d["load"] | {"mm": 1.5 * d["load"]["mm"]}]


SLIPS = {  # name: (the measurement it concerns, what is told instead)
    "nothing wrong": ("load", lambda d: None),
    "load read in kgf, told as N": ("load", scaled("load", "force", 1 / G)),
    "load read in lbf, told as N": ("load", scaled("load", "force", 1 / 4.44822)),
    "load halved": ("load", scaled("load", "force", 0.5)),
    "deflection in 1/10 mm told as mm": ("load", scaled("load", "mm", 10)),
    "deflection of the wrong sign": ("load", scaled("load", "mm", -1)),
    "load at 0.5 L, told at 0.25 L": ("load", put("load", "place", "0.25L")),
    "place beyond the end": ("load", put("load", "place", "1.05L")),
    "place in per cent as metres": ("load", put("load", "place", "50m")),
    "two loads that contradict, 1.5 times": ("load", second_load),
    "mass in lb told as kg": ("mass", scaled("mass", "kg", 2.20462)),
    "mass in kg told as lb": ("mass", scaled("mass", "kg", 1 / 2.20462)),
    "mass in g": ("mass", scaled("mass", "kg", 1e3)),
    "mass of 1.5 rods": ("mass", put("mass", "kg", 772.0)),
    "mass at 0.3 L, told at 0.6 L": ("mass", put("mass", "place", "0.6L")),
    "mass outside": ("mass", put("mass", "place", "1.3L")),
    "ratio upside down": ("mass", lambda d: d["mass"].update(ratios=[1 / r for r in d["mass"]["ratios"]])),
    "sensors swapped": ("shape", swapped),
    "one sensor turned round": ("shape", scaled("shape", "ratios", -1)),
    "sensor at 0.1 L, told at 0.2 L": ("shape", put("shape", "places", ("0.2L", "0.4L"))),
    "sensor beyond its end": ("shape", put("shape", "places", ("-0.1L", "0.4L"))),
    "strain in microstrain as strain": ("strain", scaled("strain", "ratio", 1e6)),
    "strain per mm as per m": ("strain", scaled("strain", "ratio", 1e-3)),
    "gauge on the other face": ("strain", scaled("strain", "ratio", -1)),
    "strain of both faces": ("strain", scaled("strain", "ratio", 2)),
    "side of another rod, +15 %": ("side", scaled("side", "mm", 1.15)),
    "side in cm as mm": ("side", scaled("side", "mm", 0.1)),
    "density in g/cm3 as kg/m3": ("density", scaled("density", "si", 1e-3)),
    "density of aluminium": ("density", put("density", "si", 2700.0)),
}


def heard(program, config, frequencies, told, truth, about):
    joined = ",".join(f"{value:.5f}" for value in frequencies)
    command = [program, "identify", "--config", config, "--format", "json", "--frequencies", joined, "--sd", "0.01"] + flags(told)
    run = subprocess.run(command, capture_output=True, text=True)
    lines = run.stdout.splitlines()
    if not lines:
        return "refused", run.stderr.strip().splitlines()[-1]
    row = json.loads(lines[-1])
    if row["axial_force_n"] is None:
        return "refused", row["rejection"]["message"]
    worst = max(row["tested"]["conflicts"], key=lambda c: c["score"])
    if worst["score"] >= 3 or (row["conflict"] or 0) > 4:
        return "marked", f"{worst['datum']} {worst['score']:.1f} {worst['hint'] or ''}"
    force = row["axial_force_n"]
    return ("silent, true inside" if force["q025"] <= truth <= force["q975"] else "silent, false"), ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--rods", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--priors", default="paper,informed")
    parser.add_argument("--slips", default=";".join(SLIPS))
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(args.jobs) as pool:
        for name in args.priors.split(","):
            prior, discrepancy = judge.PRIORS[name]
            config = Path(folder) / f"{name}.toml"
            config.write_text(judge.configuration(name))
            for slip in args.slips.split(";"):
                about, change = SLIPS[slip]

                def one(number):
                    rng = np.random.default_rng([args.seed, number])
                    theta = judge.rod(prior, rng)
                    out = []
                    for beside in ("frequencies", "everything"):
                        f, told = texts(theta, np.random.default_rng([args.seed, number, 1]))
                        f = f * (1 + discrepancy * np.random.default_rng([args.seed, number, 2]).standard_normal(3))
                        change(told)
                        if beside == "frequencies":
                            told = {about: told[about]}
                        out.append(heard(args.program, str(config), f, told, theta[0], about))
                    return out

                rows = list(pool.map(one, range(args.rods)))
                for i, beside in enumerate(("frequencies", "everything")):
                    kinds = [row[i][0] for row in rows]
                    count = ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds)))
                    print(f"{name:9}{slip:38}{beside:12} {count} | {next((row[i][1] for row in rows if row[i][1]), '')[:200]}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
