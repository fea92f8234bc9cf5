"""Standard deviation of N that each further measurement of a rod leaves, by an independent sampler.

Shares nothing with the program: the model is a finite-element beam (numpy, dense eigenvectors), the posterior is importance
sampling from a t distribution about the posterior of three frequencies, found by a few adaptive rounds; each measurement reweights
that sample, or where this leaves fewer than 200 effective draws has one of its own. Prints one line per measurement: mean over rods
of the standard deviation left, its standard error, worst effective sample size.
Usage: sampler.py paper|informed [RODS] [DRAWS] [BEGINNING OF THE NAMES OF MEASUREMENTS]
"""
import os
import sys
import numpy as np

ELEMENTS, LENGTH = int(os.environ.get("ELEMENTS", 20)), 14.0
BEND = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
TENSION = np.array([[36, 3, -36, 3], [3, 4, -3, -1], [-36, -3, 36, -3], [3, -1, -3, 4.0]]) / 30
MASS = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4.0]]) / 420
KEEP = [i for i in range(2 * ELEMENTS + 2) if i not in (0, 2 * ELEMENTS)]


def assembled(element):
    whole = np.zeros((2 * ELEMENTS + 2,) * 2)
    for e in range(ELEMENTS):
        whole[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += element
    return whole[np.ix_(KEEP, KEEP)]


K_BEND, K_TENSION, M_UNIT = assembled(BEND), assembled(TENSION), assembled(MASS)
ROOT_INV = np.linalg.inv(np.linalg.cholesky(M_UNIT))


def row(share):
    node = share * ELEMENTS
    assert abs(node - round(node)) < 1e-9, "places are nodes"
    return 2 * int(round(node)) - 1


def model(theta):
    """Answers of every measurement; theta: rows of N, E, rho, a, k_l, k_r."""
    n, e, rho, a, kl, kr = theta.T
    h, ei, m = LENGTH / ELEMENTS, e * a**4 / 12, rho * a**2
    k = (ei / h**3)[:, None, None] * K_BEND + (n / h)[:, None, None] * K_TENSION
    k[:, 0, 0] += kl / h**2
    k[:, -1, -1] += kr / h**2
    values, vectors = np.linalg.eigh(ROOT_INV @ k @ ROOT_INV.T)
    f = np.sqrt(values[:, :3] / (m * h)[:, None]) / (2 * np.pi)
    shape = np.einsum("ij,bjk->bik", ROOT_INV.T, vectors[:, :, :3])
    force = np.zeros((len(k), k.shape[1], 1))
    force[:, row(0.5)] = 300.0
    deflection = np.linalg.solve(k, force)[:, row(0.5), 0]
    # The mass as a rank-one change of the mass matrix: roots of 1 = M w^2 G(w) on all modes of the elements.
    phi2 = np.einsum("j,bjk->bk", ROOT_INV.T[row(0.3)], vectors) ** 2 / (m * h)[:, None]
    w2 = values / (m * h)[:, None]
    ratios = []
    for order in range(3):
        low = np.zeros(len(k)) if order == 0 else w2[:, order - 1]
        high = w2[:, order].copy()
        for _ in range(60):
            mid = 0.5 * (low + high)
            g = 1 - 20.0 * mid * (phi2 / (w2 - mid[:, None])).sum(1)
            low, high = np.where(g > 0, mid, low), np.where(g > 0, high, mid)
        ratios.append(np.sqrt(low / w2[:, order]))
    w = lambda share, mode: shape[:, row(share), mode]
    # Bending moment at a node from the balance of the two elements beside it, mode by mode: far more exact than their cubics' curvature.
    def strain(share, mode):
        whole = np.zeros((len(k), 2 * ELEMENTS + 2))
        whole[:, KEEP] = shape[:, :, mode]
        scaled = lambda matrix, by: by[:, None, None] * matrix
        element = scaled(BEND, ei / h**3) + scaled(TENSION, n / h) - scaled(MASS, values[:, mode])
        end = row(share) + 1
        right = np.einsum("ej,ej->e", element[:, 1], whole[:, end : end + 4])
        left = np.einsum("ej,ej->e", element[:, 3], whole[:, end - 2 : end + 2])
        return -0.25 * a * h / ei * (left - right) / w(0.1, mode)

    each_mode = lambda share: np.stack([strain(share, j) for j in range(3)], 1)
    shapes = np.stack([w(0.1, j) / w(0.4, j) for j in range(3)], 1)
    more = np.stack([w(x, j) / w(0.4, j) for j in range(3) for x in (0.2, 0.3)], 1)
    return dict(f=f, deflection=deflection, ratio=np.stack(ratios, 1), shapes=shapes, more=more,
                strain=strain(0.05, 0), strain_there=strain(0.1, 0),
                strains=each_mode(0.05), strains_there=each_mode(0.1),
                side=a, density=rho, springs=np.stack([kl, kr], 1))


PAPER = np.array([[800e3, 0.20], [2.0e11, 0.30], [7500, 0.10], [0.07, 0.10], [400e3, 0.30], [400e3, 0.30]])
# A gauge is not read more exactly than this where its strain passes through zero [1/m].
LEAST = 1e-3
INFORMED = np.array([[800e3, 0.20], [2.0e11, 0.05], [7700, 0.03], [0.07, 0.02], [400e3, 0.30], [400e3, 0.30]])


def sampled(log_target, centre, cov, counts, rng):
    """Adaptive rounds in logarithms: t with 5 degrees of freedom, tempered while weights are few. Parameters, answers, weights."""
    for step, count in enumerate(counts):
        is_last = step == len(counts) - 1
        root = np.linalg.cholesky(cov)
        t = rng.standard_normal((count, 6)) / np.sqrt(rng.chisquare(5, (count, 1)) / 5)
        x = centre + t @ root.T
        theta = np.exp(x)
        answer = model(theta)
        logq = -5.5 * np.log1p((t**2).sum(1) / 5)
        lw = log_target(theta, answer) - logq
        lw -= lw.max()
        share = 1.0
        while not is_last and share > 1e-6:
            w = np.exp(share * lw)
            if w.sum() ** 2 / (w**2).sum() > 150:
                break
            share *= 0.7
        w = np.exp(share * lw)
        w /= w.sum()
        if not is_last:
            centre, cov = w @ x, 1.2 * np.cov(x.T, aweights=w) + 1e-10 * np.eye(6)
    return theta, answer, lw, w


def main():
    name = sys.argv[1]
    rods = int(sys.argv[2]) if len(sys.argv) > 2 else 12
    draws = int(sys.argv[3]) if len(sys.argv) > 3 else 12000
    only = sys.argv[4] if len(sys.argv) > 4 else ""
    prior, discrepancy = (PAPER, 0.0) if name == "paper" else (INFORMED, 0.01)
    mean, sd = prior[:, 0], prior[:, 0] * prior[:, 1]
    rng = np.random.default_rng(5)
    data = {  # name: (answer, relative error, of at least)
        "load 3 %": [("deflection", 0.03)], "load 1 %": [("deflection", 0.01)],
        "mass 20 kg, 0.14 %": [("ratio", 0.0014)], "strain at 0.05 L, 2 %": [("strains", 0.02, LEAST)],
        "strain at 0.1 L, 2 %": [("strains_there", 0.02, LEAST)], "strain at 0.05 L, mode 1": [("strain", 0.02, LEAST)],
        "strain at 0.1 L, mode 1": [("strain_there", 0.02, LEAST)], "the same, of however little": [("strain_there", 0.02)],
        "four sensors 1 %": [("shapes", 0.01), ("more", 0.01)],
        "caliper 0.7 %": [("side", 0.007)], "density 1 %": [("density", 0.01)],
        "caliper and density": [("side", 0.007), ("density", 0.01)],
        "shape 1 %": [("shapes", 0.01)], "springs 5 %": [("springs", 0.05)],
        "everything": [("deflection", 0.03), ("ratio", 0.0014), ("strains", 0.02, LEAST), ("shapes", 0.01), ("side", 0.007), ("density", 0.01)],
    }
    left = {key: [] for key in data}
    base, worst = [], {key: np.inf for key in data}
    for _ in range(rods):
        truth = mean + sd * rng.standard_normal(6)
        while np.any(truth <= 0):
            truth = mean + sd * rng.standard_normal(6)
        true = model(truth[None])
        seen = true["f"][0] * (1 + discrepancy * rng.standard_normal(3)) + 0.01 * rng.standard_normal(3)

        def log_target(theta, answer):
            v = 0.01**2 + (discrepancy * answer["f"]) ** 2
            fit = -0.5 * (((seen - answer["f"]) ** 2 / v) + np.log(v)).sum(1)
            return fit - 0.5 * (((theta - mean) / sd) ** 2).sum(1) + np.log(theta).sum(1)

        theta, answer, lw, w = sampled(log_target, np.log(mean), np.diag(prior[:, 1] ** 2), [3000] * 6 + [draws], rng)
        n = theta[:, 0]
        sd_of = lambda n, w: np.sqrt(w @ n**2 - (w @ n) ** 2)
        base.append(sd_of(n, w) / (w @ n))
        for key, parts in data.items():
            if not key.startswith(only):
                continue
            told = []
            for what, error, *least in parts:
                y0 = true[what][0]
                s = error * np.maximum(np.abs(y0), *least) if least else error * np.abs(y0)
                told.append((what, y0 + s * rng.standard_normal(np.shape(y0)), s))

            def fit(answer):
                z = [(answer[what] - value) / s for what, value, s in told]
                return -0.5 * sum(one**2 if one.ndim == 1 else (one**2).sum(1) for one in z)

            lv = lw + fit(answer)
            v = np.exp(lv - lv.max())
            v /= v.sum()
            m, effective = n, 1 / (v**2).sum()
            if effective < 200:
                # Too few of them: a sample of its own, from the widened posterior of the frequencies.
                spread = np.cov(np.log(theta).T, aweights=w)
                own = lambda theta, answer: log_target(theta, answer) + fit(answer)
                found, _, _, v = sampled(own, w @ np.log(theta), spread, [1500] * 4 + [draws // 2], rng)
                m, effective = found[:, 0], 1 / (v**2).sum()
            left[key].append(sd_of(m, v) / sd_of(n, w))
            worst[key] = min(worst[key], effective)
    show = lambda values: f"{np.mean(values):.3f} +- {np.std(values, ddof=1) / np.sqrt(len(values)):.3f}"
    print(f"{name}: CV of N after three frequencies {show(base)}, {rods} rods, base effective {1 / (w**2).sum():.0f}")
    for key in filter(lambda key: left[key], data):
        print(f"{key:28} {show(left[key])}   worst effective {worst[key]:.0f}")


if __name__ == "__main__":
    main()
