"""Rods as they stand in buildings and laboratories, and the configuration a user would write for each."""

import math
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import beam

MATERIALS = {"iron": (190e9, 0.10, 7650.0, 0.03), "steel": (206e9, 0.04, 7850.0, 0.01)}
# The tape and the calliper: true over nominal dimensions scatter by this much.
DIMENSION_CV = 0.02
# True frequencies over those of the beam scatter by up to the discrepancy a configuration states by default.
DISCREPANCIES = (0.002, 0.005, 0.01)


@dataclass(frozen=True)
class Nominal:
    """What the user knows: length [m], kind of section and its dimensions [m], material."""

    length_m: float
    section: str
    dimensions: tuple
    material: str

    def area_and_inertia(self, factor=1.0):
        if self.section == "rectangle":
            width, height = (factor * value for value in self.dimensions)
            return width * height, width * height**3 / 12
        side = factor * self.dimensions[0]
        if self.section == "round":
            return math.pi / 4 * side**2, math.pi / 64 * side**4
        return side**2, side**4 / 12

    def flags(self):
        """Arguments of `tirante init`."""
        names = {
            "square": ["--side-m"],
            "round": ["--diameter-m"],
            "rectangle": ["--width-m", "--height-m"],
        }[self.section]
        words = ["--length-m", repr(self.length_m), "--material", self.material]
        for name, value in zip(names, self.dimensions):
            words += [name, repr(value)]
        return words


@dataclass(frozen=True)
class Rod:
    """A rod: what is known of it, what it is, its true modes, and by how much they are off those of the beam (sd of the ratio)."""

    nominal: Nominal
    beam: beam.Beam
    modes: tuple
    stress_pa: float
    discrepancy: float

    @property
    def axial_force_n(self):
        return self.beam.axial_force_n


def fixity_spring(fixity, rigidity, length_m):
    """The spring of a fixity factor 1 / (1 + 3 EI / (k L)): 0 hinged, 1 clamped."""
    return 3 * rigidity / length_m * fixity / (1 - min(fixity, 0.999))


def between(rng, low, high):
    return float(rng.uniform(low, high))


def even_in_log(rng, low, high):
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def draw(rng, slenderness=(70, 350), length_m=(3.0, 18.0), stress_pa=(12e6, 240e6), fixity=(0.0, 0.97), side=None, count=12):
    """A rod; slenderness is length over the side in the plane of vibration."""
    length = round(between(rng, *length_m), 2)
    side = side or length / even_in_log(rng, *slenderness)
    side = round(min(max(side, 0.001), 0.12), 4)
    section = str(rng.choice(["square", "round", "rectangle"], p=[0.35, 0.45, 0.2]))
    dimensions = (side,) if section != "rectangle" else (round(side * between(rng, 0.5, 2.5), 4), side)
    material = str(rng.choice(["iron", "steel"], p=[0.7, 0.3]))
    nominal = Nominal(length, section, dimensions, material)
    modulus, modulus_cv, density, density_cv = MATERIALS[material]
    z = np.clip(rng.standard_normal(3), -3.0, 3.0)
    area, inertia = nominal.area_and_inertia(1 + DIMENSION_CV * z[0])
    rigidity = modulus * (1 + modulus_cv * z[1]) * inertia
    stress = even_in_log(rng, *stress_pa)
    springs = tuple(fixity_spring(between(rng, *fixity), rigidity, length) for _ in range(2))
    real = beam.Beam(length, rigidity, density * (1 + density_cv * z[2]) * area, stress * area, springs)
    return of_beam(nominal, real, rng, count, stress)


def of_beam(nominal, real, rng, count, stress_pa):
    """A rod whose frequencies differ a little from the beam's, as those in a wall do."""
    sd = float(rng.choice(DISCREPANCIES))
    off = [math.exp(sd * float(z)) for z in rng.standard_normal(count)]
    found = sorted(
        (replace(mode, frequency_hz=mode.frequency_hz * factor) for mode, factor in zip(beam.modes(real, count), off)),
        key=lambda mode: mode.frequency_hz,
    )
    return Rod(nominal, real, tuple(found), stress_pa, sd)


def retuned(rod, axial_force_n):
    """The same rod under another force."""
    real = replace(rod.beam, axial_force_n=axial_force_n)
    count = len(rod.modes)
    ratios = [a.frequency_hz / b.frequency_hz for a, b in zip(rod.modes, beam.modes(rod.beam, count))]
    found = tuple(
        replace(mode, frequency_hz=mode.frequency_hz * ratio) for mode, ratio in zip(beam.modes(real, count), ratios)
    )
    return replace(rod, beam=real, modes=found, stress_pa=rod.stress_pa * axial_force_n / rod.axial_force_n)


def questions(nominal, name, unit, fs_hz, expected_n=None):
    """Arguments with which a user has `tirante init` write a rod; with `expected_n` there is an idea of the force."""
    words = ["--id", name, "--topic", f"/{name}", "--unit", unit, *nominal.flags()]
    if fs_hz is not None:
        words += ["--field", "values", "--fs-hz", repr(fs_hz)]
    if expected_n is not None:
        words += ["--force-n", f"{expected_n:.4g}"]
    return words


def configuration(program, answers, folder, settings=""):
    """One configuration of several rods, each as `tirante init` writes it, and how many it would not write."""
    head, tables, refused = "", [], 0
    # Its own: several files may be configured in one folder at a time.
    own_folder = tempfile.TemporaryDirectory(dir=folder)
    out = Path(own_folder.name) / "init.toml"
    for words in answers:
        out.unlink(missing_ok=True)
        command = [str(program), "init", "--out", str(out), *words]
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
        if done.returncode != 0:
            refused += 1
            print(f"{' '.join(command)}: {done.stderr.strip()}", file=sys.stderr)
            continue
        head, own = parts(out.read_text(encoding="utf-8"))
        tables.append(own)
    own_folder.cleanup()
    return "\n".join([head, settings, *tables]), refused


def parts(text):
    """A configuration's tables for the whole site, and those of its rod."""
    site, rods, inside = [], [], False
    for line in text.splitlines():
        head = line.strip()
        if head.startswith("["):
            inside = head.startswith(("[[rod", "[rod"))
        (rods if inside else site).append(line)
    return "\n".join(site), "\n".join(rods)
