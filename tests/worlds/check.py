"""The generator against closed forms: `python3 tests/worlds/check.py` fails loudly if it is wrong."""

import math

import numpy as np

import beam
import response
import rods


def close(found, wanted, tolerance, what):
    error = abs(found / wanted - 1)
    assert error < tolerance, f"{what}: {found} for {wanted}, off by {error:.2e}"


def test_hinged():
    for force in (1e3, 8e5):
        real = beam.Beam(14.0, 4e5, 37.0, force, (0.0, 0.0))
        for n, mode in enumerate(beam.modes(real, 12), 1):
            wave = n * math.pi / 14.0
            close(mode.frequency_hz, wave / (2 * math.pi) * math.sqrt((force + 4e5 * wave**2) / 37.0), 1e-9, f"hinged {n}")
            for x in (0.1, 0.37, 0.5, 0.8):
                assert abs(abs(mode.at(x)) - abs(math.sqrt(2) * math.sin(n * math.pi * x))) < 1e-6


def test_clamped():
    # beta L of a clamped beam without tension (tabulated everywhere).
    real = beam.Beam(2.0, 50.0, 3.0, 1e-9, (2.5e8, 2.5e8))
    for root, mode in zip((4.730040744862704, 7.853204624095838, 10.995607838001671), beam.modes(real, 3)):
        close(mode.frequency_hz, (root / 2.0) ** 2 / (2 * math.pi) * math.sqrt(50.0 / 3.0), 1e-6, "clamped")


def test_string():
    # Clamped ends of a nearly flexible rod shorten it by lambda at either end: f = n/(2 L) c (1 + 2 lambda + ...).
    real = beam.Beam(10.0, 90.0, 2.0, 1e5, (1e9, 1e9))
    layer = math.sqrt(90.0 / 1e5) / 10.0
    for n, mode in enumerate(beam.modes(real, 12), 1):
        series = 1 + 2 * layer + (4 + 0.5 * (n * math.pi) ** 2) * layer**2
        close(mode.frequency_hz, n / 20.0 * math.sqrt(1e5 / 2.0) * series, 1e-7 + 3 * (n * math.pi) ** 2 * layer**3, f"string {n}")


def test_springs():
    # The characteristic equation of a tensioned beam on equal springs, symmetric modes, which the method never uses:
    # with w = cos(b x)/cos(b h) - cosh(a x)/cosh(a h), h = L/2: EI w''(h) + k w'(h) = 0.
    length, rigidity, mass, force, spring = 6.0, 2e4, 12.0, 3e4, 5e4
    for mode in beam.modes(beam.Beam(length, rigidity, mass, force, (spring, spring)), 9)[::2]:
        inertia = mass * (2 * math.pi * mode.frequency_hz) ** 2
        root = math.sqrt(force**2 + 4 * rigidity * inertia)
        a, b = math.sqrt((force + root) / (2 * rigidity)), math.sqrt((root - force) / (2 * rigidity))
        half = length / 2
        curvature = -(b * b) - a * a
        slope = -b * math.tan(b * half) - a * math.tanh(a * half)
        assert abs(rigidity * curvature + spring * slope) < 1e-6 * rigidity * a * a


def test_terms():
    # The thinnest end layers drawn: twice as many functions change nothing.
    thin = beam.Beam(20.0, 160.0, 2.5, 6e4, (1e4, 1e7))
    for one, two in zip(beam.modes(thin, 12), beam.modes(thin, 12, 144)):
        close(one.frequency_hz, two.frequency_hz, 1e-6, "terms")


def test_recursion():
    rng = np.random.RandomState(1)
    steps = rng.standard_normal(1000) + 1j * rng.standard_normal(1000)
    rho, value = 0.99 * np.exp(0.3j), 0.7 - 0.2j
    fast = response.recursion(rho, steps, value)
    for k in range(1000):
        assert abs(fast[k] - value) < 1e-11
        value = rho * value + steps[k]


def test_ambient_spectrum():
    # One-sided density of q under white force of two-sided intensity one: 2 / ((w0^2 - w^2)^2 + (2 zeta w0 w)^2).
    oscillator, fs_hz, count = response.Oscillator(4.0, 0.03), 50.0, 1_000_000
    rng = np.random.RandomState(2)
    q = 2 * response.ambient(oscillator, np.ones(count), fs_hz, rng).real
    close(float(np.var(q)), 1 / (4 * 0.03 * oscillator.omega**3), 0.03, "variance")
    import spectra

    lines, density = spectra.welch(q, fs_hz, 2000)
    for hz in (2.0, 3.8, 4.0, 4.2, 6.0):
        w, w0 = 2 * math.pi * hz, oscillator.omega
        # 1000 averages: 3 %; the taper widens the peak by a few per cent.
        close(float(density[np.argmin(np.abs(lines - hz))]), 2 / ((w0**2 - w**2) ** 2 + (0.06 * w0 * w) ** 2), 0.15, f"{hz} Hz")


def test_strokes():
    # Classical Runge-Kutta of order four knows nothing of the closed forms.
    oscillator = response.Oscillator(3.0, 0.02)
    w, ramp_s, onset_s, step = oscillator.omega, 0.7, 1.1, 1e-3

    def force(t):
        return max(0.0, (t - onset_s + ramp_s) / ramp_s) if t < onset_s else 0.0

    def slope(t, y):
        return np.array([y[1], force(t) - 2 * 0.02 * w * y[1] - w * w * y[0]])

    y, times, values = np.zeros(2), np.arange(0, 3, step), []
    for t in times:
        values.append(y[0])
        a = slope(t, y)
        b = slope(t + step / 2, y + step / 2 * a)
        c = slope(t + step / 2, y + step / 2 * b)
        # The force ends within no step: its right value belongs to the end of one.
        d = slope(t + step - 1e-12, y + step * c)
        y = y + step / 6 * (a + 2 * b + 2 * c + d)
    closed = 2 * response.release(oscillator, times, onset_s, 1.0, ramp_s).real
    assert np.max(np.abs(closed - values)) < 1e-6 * np.max(np.abs(closed)) + 2e-6
    struck = 2 * response.blow(oscillator, times, 0.0, 1.0).real
    exact = np.exp(-0.02 * w * times) * np.sin(oscillator.damped * times) / oscillator.damped
    assert np.max(np.abs(struck - exact)) < 1e-12


def test_gusts():
    amplitude = response.gusts(400_000, 20.0, 0.6, 5.0, np.random.RandomState(3))
    assert abs(np.std(np.log(amplitude)) - 0.6) < 0.03 and abs(np.mean(amplitude**2) - 1) < 0.1


def test_rods():
    rng = np.random.RandomState(4)
    for _ in range(20):
        rod = rods.draw(rng)
        hz = [mode.frequency_hz for mode in rod.modes]
        assert hz == sorted(hz) and 0.3 < hz[0] < 500
        same = rods.retuned(rod, rod.axial_force_n)
        assert max(abs(a.frequency_hz / b.frequency_hz - 1) for a, b in zip(rod.modes, same.modes)) < 1e-9


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name}: ok")
