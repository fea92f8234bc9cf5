"""Rods before and after a change, by a beam that shares nothing with the program: one JSON object a line.

    python3 tests/worlds/changes.py --rods 200 --seed 1 --prior wide

`wide` is the paper's prior (modulus 30 %, density and side 10 %), `known` that of a rod that was measured (10 %, 3 %, 2 %).
`--rough SHARE`: three masses of that share of the rod's hang on it, before and after, that the model does not know. Frequencies are those of the first five modes; theta is N, E, rho, side, two springs, length.
"""

import argparse
import json

import numpy as np

from beam import Beam, matrices

PRIORS = {
    "wide": ((800e3, 0.20), (2.0e11, 0.30), (7500.0, 0.10), (0.07, 0.10), (400e3, 0.30), (400e3, 0.30)),
    "known": ((800e3, 0.20), (1.9e11, 0.10), (7600.0, 0.03), (0.071, 0.02), (400e3, 0.30), (400e3, 0.30)),
}
LENGTH_M = 14.0
MODES = 5

# Kind of change and its size: the relative change of what is named; of a section its area.
CHANGES = [
    ("force", -0.01), ("force", -0.03), ("force", -0.10), ("force", 0.03),
    ("both-supports", -0.2), ("both-supports", -0.5), ("both-supports", -0.8),
    ("one-support", -0.5), ("one-support", -0.9),
    ("mass", 0.01), ("mass", 0.03),
    ("modulus", -0.01), ("modulus", -0.03),
    ("section", -0.02), ("section", -0.06),
    ("point-mass", 0.01), ("line", 0.005),
]


def frequencies(theta, points=()):
    """The first modes [Hz]; `points` are masses as shares of the rod's, and their places."""
    n, e, rho, side, left, right, length = theta
    beam = Beam(length, e * side**4 / 12, rho * side**2, n, (left, right))
    stiffness, mass = matrices(beam)
    for share, place in points:
        k = np.arange(len(mass))
        legendre = np.polynomial.legendre.legvander(np.array([2.0 * place - 1.0]), len(mass) + 1)[0]
        shape = (legendre[:-2] - legendre[2:]) / (2 * k + 3)
        mass = mass + share * beam.mass_kg * np.outer(shape, shape)
    lower = np.linalg.cholesky(stiffness)
    reduced = np.linalg.solve(lower, np.linalg.solve(lower, mass).T)
    values = np.linalg.eigvalsh(0.5 * (reduced + reduced.T))
    return 1.0 / (2 * np.pi * np.sqrt(values[::-1][:MODES]))


def changed(theta, points, kind, size, rng):
    """Frequencies after a change."""
    theta, points = list(theta), list(points)
    if kind == "force":
        theta[0] *= 1 + size
    elif kind == "both-supports":
        theta[4] *= 1 + size
        theta[5] *= 1 + size
    elif kind == "one-support":
        theta[4 + rng.randint(0, 2)] *= 1 + size
    elif kind == "mass":
        theta[2] *= 1 + size
    elif kind == "modulus":
        theta[1] *= 1 + size
    elif kind == "section":
        theta[3] *= (1 + size) ** 0.5
    elif kind == "point-mass":
        points.append((size, 0.05 + 0.9 * rng.random_sample()))
    found = frequencies(theta, points)
    if kind == "line":
        # One of the first three modes is drawn towards a line.
        found[rng.randint(0, 3)] *= 1 - size
    return found


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rods", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--prior", choices=PRIORS, default="wide")
    parser.add_argument("--rough", type=float, default=0.0)
    arguments = parser.parse_args()
    for rod in range(arguments.rods):
        rng = np.random.RandomState([arguments.seed, rod])
        theta = []
        for mean, cv in PRIORS[arguments.prior]:
            value = -1.0
            while value <= 0.0:
                value = mean * (1 + cv * float(rng.standard_normal()))
            theta.append(value)
        theta.append(LENGTH_M)
        points = [(arguments.rough, rng.random_sample()) for _ in range(3)]
        before = frequencies(theta, points)
        for kind, size in CHANGES:
            after = changed(theta, points, kind, size, rng)
            print(json.dumps({"rod": rod, "kind": kind, "size": size, "before": list(before), "after": list(after)}))


if __name__ == "__main__":
    main()
