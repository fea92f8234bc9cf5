"""People with one file: what `tirante measure` says to each, told only length, section and material, held against the truth.

    python3 tests/worlds/users.py --users 600 --program target/release/tirante

Rods from 1 kN to 2 MN, as wires, bars and flats of iron and steel; displacement, velocity and acceleration in the units of the trade;
nine kinds of file; ambient vibration, blows and releases; 5 to 10 modes in the band. Every user is another rod, and nothing of it
comes from the program. The sensor shows at least five modes. Prints a table, and what is required as lines that pass or fail. Exit code 1 if one fails.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

import beam
import classes
import formats
import recording
import rods
import scene as scenes
import score
from rods import between, even_in_log
from scene import Scene, Stroke

RATES = (*classes.RATES, 4000.0, 5000.0, 8000.0, 10000.0, 16000.0)
# Users of one round: every kind of file six times or seven, every size of force once.
ROUND = 60
FORCE_N = (1e3, 2e6)
STRESS_PA = (12e6, 240e6)
# Fixity of an end, each range as often: as good as hinged, anything, as good as clamped. The second alone would be the rods whose force
# is the easiest to hold (docs/abc.md, Priors that claim little).
HINGED, CLAMPED = 0.1, 0.9
ENDS = ((0.0, HINGED), (0.0, 0.97), (CLAMPED, 0.99))
# Most samples of a file.
MOST = 400_000
# Modes a record shows at least: so many stand `score.CLEAR_DB` over the rest.
CLEAR = 5
# By so much a sensor is better that does not show them [dB], and how often it is exchanged.
BETTER_DB, EXCHANGES = 10.0, 6
# A force farther from the truth than this many standard deviations, and outside its interval, is wrong: chance gives one of 2000.
WRONG_SD = 3.5
# The program's own marks (docs/measure.md): conflict, prior, orders of the modes, ratio of the interval's ends.
CONFLICT, PRIOR_TAIL, CERTAIN, WIDE = 3.0, 0.01, 0.99, 10.0


def rod_of(rng, force_n):
    """A rod under this force, as it is in a wall and as its owner measures it."""
    stress = even_in_log(rng, *STRESS_PA)
    area = force_n / stress
    section = str(rng.choice(["square", "round", "rectangle"], p=[0.35, 0.45, 0.2]))
    wide = between(rng, 0.5, 2.5) if section == "rectangle" else {"square": 1.0, "round": math.pi / 4}[section]
    height = math.sqrt(area / wide)
    # A calliper reads tenths of a millimetre, of wire hundredths.
    digits = 4 if height > 0.01 else 5
    nominal_height = round(height, digits)
    dimensions = (nominal_height,) if section != "rectangle" else (round(wide * height, digits), nominal_height)
    length = round(min(max(height * even_in_log(rng, 70, 350), 0.6), 25.0), 2)
    material = str(rng.choice(["iron", "steel"], p=[0.7, 0.3]))
    nominal = rods.Nominal(length, section, dimensions, material)
    modulus, modulus_cv, density, density_cv = rods.MATERIALS[material]
    z = np.clip(rng.standard_normal(3), -3.0, 3.0)
    real_area, inertia = nominal.area_and_inertia(1 + rods.DIMENSION_CV * z[0])
    rigidity = modulus * (1 + modulus_cv * z[1]) * inertia
    springs = tuple(rods.fixity_spring(between(rng, *ENDS[rng.randint(len(ENDS))]), rigidity, length) for _ in range(2))
    real = beam.Beam(length, rigidity, density * (1 + density_cv * z[2]) * real_area, force_n, springs)
    return rods.of_beam(nominal, real, rng, 12, force_n / real_area)


def ends_of(real):
    """The ends of a beam in words."""
    fixities = [spring / (spring + 3 * real.flexural_rigidity_n_m2 / real.length_m) for spring in real.springs_n_m]
    return " and ".join(
        sorted("hinged" if one < HINGED else "clamped" if one >= CLAMPED else "between" for one in fixities)
    )


def scene_of(rng, rod):
    """Half of the users wait for the wind, half strike the rod or let it go."""
    bands = int(rng.randint(5, 11))
    wanted = rod.modes[bands - 1].frequency_hz / 0.42
    fs_hz = next((rate for rate in RATES if rate >= wanted), RATES[-1])
    scene = Scene(
        rod=rod,
        damping=classes.damping(rng),
        fs_hz=fs_hz,
        duration_s=float(rng.choice([60.0, 120.0, 300.0])),
        sensor_at=between(rng, 0.06, 0.48),
        quantity=str(rng.choice(["displacement", "velocity", "acceleration"], p=[0.4, 0.35, 0.25])),
        clearance_db=between(rng, 30, 55),
        sd_si=even_in_log(rng, 3e-6, 1e-4),
    )
    if rng.random_sample() < 0.5:
        scene.gust_log_sd = float(rng.choice([0.0, 0.0, 0.6]))
    else:
        scene.duration_s = float(rng.choice([20.0, 30.0, 60.0]))
        kind = str(rng.choice(["release", "blow"]))
        onset = between(rng, 1.0, 6.0)
        ramp = between(rng, 0.5, 3.0) if kind == "release" else 0.0
        scene.strokes = [Stroke(kind, onset, between(rng, 0.08, 0.45), ramp_s=ramp, contact_s=0.3 / fs_hz)]
        scene.ambient = 1 / even_in_log(rng, 20, 1000)
        scene.clearance_db = between(rng, 40, 70)
        scene.sd_si = even_in_log(rng, 3e-5, 1e-3)
    scene.duration_s = max(10.0, min(scene.duration_s, MOST / fs_hz))
    return scene


def shown(scene, seed, index, as_drawn):
    """The record, by a sensor good enough to show the modes; the same motion and noise, the noise less by what the sensor is better."""
    for _ in range(EXCHANGES):
        record = scenes.render(scene, np.random.RandomState([seed, index, 1]))
        if as_drawn or sum(mode["clear_db"] >= score.CLEAR_DB for mode in record.modes) >= CLEAR:
            break
        scene.clearance_db += BETTER_DB
    return record


def user(seed, index, folder, as_drawn=False):
    """Writes the file of one user; the arguments for it and the truth."""
    rng = np.random.RandomState([seed, index])
    low, high = (math.log(force) for force in FORCE_N)
    # Each round goes through all sizes of force, in an order that shares no period with the formats.
    share = ((37 * index) % ROUND + between(rng, 0.0, 1.0)) / ROUND
    rod = rod_of(rng, math.exp(low + share * (high - low)))
    scene = scene_of(rng, rod)
    record = shown(scene, seed, index, as_drawn)
    unit, factor = recording.UNITS[scene.quantity][int(rng.randint(0, len(recording.UNITS[scene.quantity])))]
    kind, ending, writer = formats.WRITERS[index % len(formats.WRITERS)]
    path = folder / f"user-{seed}-{index:04d}{ending}"
    if writer is None:
        recording.write(path, [("laser", record, factor)], seed, unit)
        added = []
    else:
        added = writer(path, factor * record.samples, unit, scene.fs_hz)
    truth = {
        "rod": path.stem,
        "class": kind,
        "has_rod": True,
        "known": False,
        "axial_force_n": rod.axial_force_n,
        "stress_pa": rod.stress_pa,
        "ends": ends_of(rod.beam),
        "discrepancy": f"off the beam by {100 * rod.discrepancy:g} %",
        "fs_hz": scene.fs_hz,
        "duration_s": scene.duration_s,
        "quantity": scene.quantity,
        "excitation": "decay" if scene.strokes else "ambient",
        "frequency_hz": [mode.frequency_hz for mode in rod.modes],
        "modes": record.modes,
        "foreign_hz": [],
    }
    return path, answers(rod.nominal, rng) + added, truth


def answers(nominal, rng):
    """What a user says of a rod, each in another unit."""
    def size(value):
        return [f"{value * 1e3:.6g} mm", f"{value * 1e3:.6g}mm", f"{value * 1e2:.6g} cm", f"{value:.6g} m"][int(rng.randint(0, 4))]

    length = [f"{nominal.length_m}", f"{nominal.length_m} m", f"{nominal.length_m * 1e3:.6g} mm"][int(rng.randint(0, 3))]
    if nominal.section == "round":
        section = [f"d{nominal.dimensions[0] * 1e3:.6g}", f"d {size(nominal.dimensions[0])}"][int(rng.randint(0, 2))]
    elif nominal.section == "square":
        section = f"square {size(nominal.dimensions[0])}"
    else:
        section = f"{nominal.dimensions[0] * 1e3:.6g}x{nominal.dimensions[1] * 1e3:.6g} mm"
    return ["--length", length, "--section", section, "--material", nominal.material]


def measured(program, seed, index, folder, as_drawn):
    """What the program says to one user: the verdict, the marks on the force, the truth, its complaint."""
    path, words, truth = user(seed, index, folder, as_drawn)
    command = [str(program), "measure", str(path), *words, "--json", "--out", str(folder / "out")]
    environment = dict(os.environ, TIRANTE_CACHE_DIR=str(folder / "cache"))
    done = subprocess.run(command, capture_output=True, text=True, env=environment, stdin=subprocess.DEVNULL, check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    verdict = score.judge(truth, lines)
    good = max((line for line in lines if line["rejection"] is None), key=lambda line: line["duration_s"], default=None)
    refused = next((line["rejection"]["message"] for line in lines if line["rejection"]), done.stderr.strip()[-300:])
    if done.returncode != (0 if verdict.claimed else 3):
        sys.exit(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()}")
    path.unlink()
    return verdict, marks(good) if good else [], truth, good["axial_force_n"] if good else refused


def marks(line):
    """The program's marks on a force."""
    found = []
    if line["conflict"] >= CONFLICT:
        found.append("conflict")
    elif line["prior_tail"] is not None and line["prior_tail"] <= PRIOR_TAIL:
        found.append("prior")
    if line["label_probability"] is not None and line["label_probability"] < CERTAIN:
        found.append("orders")
    force = line["axial_force_n"]
    if force["q975"] > WIDE * force["q025"]:
        found.append("wide")
    return found


def is_wrong(verdict):
    """Whether the force a user was told is a wrong one."""
    return verdict.claimed and (
        verdict.wrong or verdict.intruders or (not verdict.force_held and abs(verdict.force_z) > WRONG_SD)
    )


def share(hits, count):
    low, high = score.interval(hits, count)
    return f"{hits} of {count}, {100 * hits / max(count, 1):.1f} % ({100 * low:.0f} to {100 * high:.0f})"


def row(name, found):
    told = [one for one in found if one[0].claimed]
    held = sum(one[0].force_held for one in told)
    width = sorted((one[3]["q975"] - one[3]["q025"]) / (2 * one[3]["mean"]) for one in told) or [math.nan]
    wrong = [one for one in told if is_wrong(one[0])]
    return (
        f"| {name} | {len(found)} | {share(len(told), len(found))} | {share(held, len(told))} "
        f"| ± {100 * width[len(width) // 2]:.0f} % | {sum(bool(one[1]) for one in told)} "
        f"| {len(wrong)} | {sum(not one[1] for one in wrong)} |"
    )


def table(found):
    """All users, then by size of the force, excitation and kind of file."""
    lines = [
        "| users | number | told a force | 95 % interval holds it | half width, median | marked | wrong | wrong, no mark |",
        "|---|---|---|---|---|---|---|---|",
        row("all", found),
    ]
    for low, high, name in ((1e3, 1e4, "1 to 10 kN"), (1e4, 1e5, "10 to 100 kN"), (1e5, 2e6, "0.1 to 2 MN")):
        lines.append(row(name, [one for one in found if low <= one[2]["axial_force_n"] < high]))
    for key in ("ends", "excitation", "discrepancy", "quantity", "class"):
        for name in sorted({one[2][key] for one in found}):
            lines.append(row(name, [one for one in found if one[2][key] == name]))
    return lines


def requirements(found, few):
    """What is required, as (passes, text). With `few`, of a share the favourable end of its exact interval counts: chance alone fails nothing."""
    told = [one for one in found if one[0].claimed]
    held = sum(one[0].force_held for one in told)

    def between(low, high, hits, count):
        ends = score.interval(hits, count) if few else (hits / max(count, 1),) * 2
        return ends[1] >= low and ends[0] <= high

    unmarked = [one[0].rod for one in told if is_wrong(one[0]) and not one[1]]
    return [
        (between(0.95, 1.0, len(told), len(found)), f"at least 95 % are told a force: {share(len(told), len(found))}"),
        (between(0.90, 0.98, held, len(told)), f"95 % intervals hold 90 to 98 %: {share(held, len(told))}"),
        (not unmarked, f"no wrong force is told without a mark: {', '.join(unmarked) or 'none'}"),
    ]


def describe(one):
    verdict, marked, truth, said = one
    text = f"{verdict.rod} ({truth['class']}, {truth['excitation']}): {1e-3 * truth['axial_force_n']:.3g} kN"
    if not verdict.claimed:
        return f"{text}, refused ({verdict.code}): {said}"
    interval = " to ".join(f"{1e-3 * said[end]:.3g}" for end in ("q025", "q975"))
    orders = f", wrong orders {verdict.wrong}, foreign {verdict.intruders}" if verdict.wrong or verdict.intruders else ""
    return f"{text}, told {interval} kN ({verdict.force_z:+.1f} sd), marks: {', '.join(marked) or 'none'}{orders}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, default=ROUND)
    parser.add_argument("--every", type=int, default=1, help="of the users, only every so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", type=Path, default=Path("target/release/tirante"))
    parser.add_argument("--jobs", type=int, default=1, help="users at a time")
    parser.add_argument("--as-drawn", action="store_true", help="whatever the sensor shows, fewer modes too")
    parser.add_argument("--few", action="store_true", help="shares fail only if even the favourable end of their interval does")
    parser.add_argument("--look", action="store_true", help="lists the users a person should look at")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.jobs) as pool:
        found = list(
            pool.map(
                lambda index: measured(arguments.program, arguments.seed, index, Path(folder), arguments.as_drawn),
                range(0, arguments.users, arguments.every),
            )
        )
    required = requirements(found, arguments.few)
    lines = table(found) + [""] + [f"- {'pass' if passes else 'FAIL'}: {text}" for passes, text in required]
    if arguments.look:
        shown = [one for one in found if not one[0].claimed or is_wrong(one[0]) or not one[0].force_held]
        lines += [""] + [f"- {describe(one)}" for one in shown]
    print("\n".join(lines))
    sys.exit(0 if all(passes for passes, _ in required) else 1)


if __name__ == "__main__":
    main()
