"""Recordings of rods that nothing in the program made, with the configuration of a user and the truth.

    python3 tests/worlds/worlds.py --out FOLDER --classes white,knocks --count 10 --seed 1 --program target/debug/tirante

writes per class an MCAP file, the configuration of its rods, and the truth as JSON lines; with --npy also CLASS-NNNN.npy
(samples in SI).
The same seed gives the same records. Every record is another rod.
"""

import argparse
import json
import sys
import zlib
from pathlib import Path

import numpy as np

import recording
import rods
import scene as scenes
from classes import CLASSES

# Share of the rods whose user says about how large the force is (`tirante init --force-n`), and how well: 30 % is stated.
KNOWN = 0.4
FORCE_CV = 0.3


def generator(seed, name, index):
    """Random numbers of one record, the same whatever else is drawn and by every version of numpy, which has frozen these."""
    return np.random.RandomState([seed, zlib.crc32(name.encode()), index])


def one(seed, name, index):
    """A record, the factor to its unit, and the truth about it."""
    rng = generator(seed, name, index)
    scene = CLASSES[name](rng)
    unit, factor = recording.UNITS[scene.quantity][int(rng.randint(0, len(recording.UNITS[scene.quantity])))]
    configured = scene.configured or scene.rod
    expected = None
    if rng.random_sample() < KNOWN:
        expected = configured.axial_force_n * max(0.2, 1 + FORCE_CV * float(rng.standard_normal()))
    record = scenes.render(scene, rng)
    rod_id = f"{name}-{index:04d}"
    declared = None if scene.clock.per_message == 1 else scene.fs_hz
    truth = {
        "rod": rod_id,
        "class": name,
        "seed": seed,
        "has_rod": scene.has_rod and scene.configured is None,
        "known": expected is not None,
        "axial_force_n": scene.rod.axial_force_n,
        "stress_pa": scene.rod.stress_pa,
        "fs_hz": scene.fs_hz,
        "duration_s": scene.duration_s,
        "quantity": scene.quantity,
        "sensor_at": scene.sensor_at,
        "frequency_hz": [mode.frequency_hz for mode in scene.rod.modes],
        "modes": record.modes,
        "foreign_hz": record.foreign_hz,
        "init": rods.questions(configured.nominal, rod_id, unit, declared, expected),
    }
    return record, factor, truth


def batch(folder, name, indices, seed, npy=False):
    """Writes some records of a class as one file with their truth; one that exists is left as it is. Returns its stem."""
    stem = folder / f"{name}-{seed}-{indices[0]:04d}-{len(indices)}"
    if stem.with_suffix(".jsonl").exists():
        return stem
    named, truths = [], []
    for index in indices:
        record, factor, truth = one(seed, name, index)
        named.append((truth["rod"], record, factor))
        truths.append(truth)
        if npy:
            np.save(folder / f"{truth['rod']}.npy", record.samples)
    recording.write(stem.with_suffix(".mcap"), named, seed)
    lines = (json.dumps(truth) for truth in truths)
    stem.with_suffix(".jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return stem


def truth_of(stem):
    """The truth about the records of a file."""
    return [json.loads(line) for line in stem.with_suffix(".jsonl").read_text(encoding="utf-8").splitlines()]


def configure(stem, program, settings=""):
    """Writes the configuration of a file's rods, as that program's `init` writes them; false if it writes none of them."""
    answers = [truth["init"] for truth in truth_of(stem)]
    text, refused = rods.configuration(program, answers, stem.parent, settings)
    stem.with_suffix(".toml").write_text(text, encoding="utf-8")
    return refused < len(answers)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--classes", default=",".join(CLASSES), help="names, separated by commas")
    parser.add_argument("--count", type=int, default=10, help="records a class")
    parser.add_argument("--first", type=int, default=0, help="number of the first record")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", type=Path, default=Path("target/release/tirante"))
    parser.add_argument("--npy", action="store_true", help="samples as NPY files as well")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.classes.split(","):
        if name not in CLASSES:
            sys.exit(f"no class {name}; there are {', '.join(CLASSES)}")
        indices = range(arguments.first, arguments.first + arguments.count)
        stem = batch(arguments.out, name, indices, arguments.seed, arguments.npy)
        configure(stem, arguments.program)
        print(stem.with_suffix(".mcap"))


if __name__ == "__main__":
    main()
