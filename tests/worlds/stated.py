"""Coverage of the stated 95 % interval, from frequencies alone: rods as the configuration states them, and rods as users have them.

    python3 tests/worlds/stated.py --rods 200 --program target/release/tirante

Each rod has a configuration as `tirante init` writes it for its length, section and material. Its true modes come from the beam of
this folder; `tirante identify --frequencies` gets the first five. Rows of the table:

- as stated: force, dimensions, modulus, density, supports and model error drawn from the configuration itself. The intervals must hold
  95 % of these forces: it is the definition of a stated probability.
- users, 0 / 0.5 / 1 %: the rods of users.py, with a model error of so much. Their forces are those of rods that do their work (12 to
  240 MPa), while the configuration must also allow slack rods.
"""

import argparse
import json
import math
import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import beam
import rods
import score
import users

# Standard error of a frequency, small beside the model's error of 1 %.
RELATIVE_SD = 5e-4
MODES = 5


def configured(program, nominal, path):
    """Writes the configuration for a rod; the bounds of its prior of the force [N]."""
    path.unlink(missing_ok=True)
    command = [str(program), "init", "--out", str(path), *rods.questions(nominal, "a", "m", 1000.0)]
    subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL)
    found = re.search(r"axial_force_n = \{ low = ([0-9.e+]+), high = ([0-9.e+]+)", path.read_text(encoding="utf-8"))
    return float(found[1]), float(found[2])


def as_stated(rng, nominal, force_n):
    """The beam of a rod drawn from the priors of its configuration."""
    modulus, modulus_cv, density, density_cv = rods.MATERIALS[nominal.material]
    z = rng.standard_normal(3)
    area, inertia = nominal.area_and_inertia(1 + rods.DIMENSION_CV * z[0])
    rigidity = modulus * (1 + modulus_cv * z[1]) * inertia
    # `fixity_low = 0, fixity_high = 0.99, ends = 2`: v = 1 / (1 + (3 EI / (k l))^(1/2)) is uniform.
    most = 1 / (1 + 99**-0.5)
    shares = [rods.between(rng, 0.0, most) for _ in range(2)]
    springs = tuple(3 * rigidity / nominal.length_m * (share / (1 - share)) ** 2 for share in shares)
    return beam.Beam(nominal.length_m, rigidity, density * (1 + density_cv * z[2]) * area, force_n, springs)


def interval(program, rod, path, environment):
    """The force the program states [N]."""
    found = [mode.frequency_hz for mode in rod.modes[:MODES]]
    words = [",".join(f"{factor * hz:.9g}" for hz in found) for factor in (1.0, RELATIVE_SD)]
    command = [str(program), "identify", "--frequencies", words[0], "--sd", words[1], "--config", str(path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, stdin=subprocess.DEVNULL, check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return lines[0]["axial_force_n"] if lines else None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rods", type=int, default=200, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", type=Path, default=Path("target/release/tirante"))
    arguments = parser.parse_args()
    print("| rods | told a force | 95 % interval holds it | rms of (mean - truth) / sd | half width, median |\n|---|---|---|---|---|")
    kinds = [("as stated", 0.01), *((f"users, {100 * error:g} %", error) for error in (0.0, 0.005, 0.01))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rod.toml"
        environment = dict(os.environ, TIRANTE_CACHE_DIR=str(Path(folder) / "cache"))
        for number, (name, error) in enumerate(kinds):
            rods.DISCREPANCIES = (error,)
            held, scores, widths = 0, [], []
            for index in range(arguments.rods):
                rng = np.random.RandomState([arguments.seed, number, index])
                rod = users.rod_of(rng, rods.even_in_log(rng, *users.FORCE_N))
                low, high = configured(arguments.program, rod.nominal, path)
                if name == "as stated":
                    real = as_stated(rng, rod.nominal, rods.even_in_log(rng, low, high))
                    rod = rods.of_beam(rod.nominal, real, rng, 12, math.nan)
                told = interval(arguments.program, rod, path, environment)
                if told is None:
                    continue
                truth = rod.axial_force_n
                held += told["q025"] <= truth <= told["q975"]
                scores.append((told["mean"] - truth) / (told["mean"] * told["cv"]))
                widths.append((told["q975"] - told["q025"]) / (2 * told["mean"]))
            rms = math.sqrt(sum(one * one for one in scores) / len(scores))
            width = sorted(widths)[len(widths) // 2]
            ends = score.interval(held, len(scores))
            share = f"{held} of {len(scores)}, {100 * held / len(scores):.1f} % ({100 * ends[0]:.0f} to {100 * ends[1]:.0f})"
            print(f"| {name} | {len(scores)} | {share} | {rms:.2f} | ± {100 * width:.0f} % |", flush=True)


if __name__ == "__main__":
    main()
