"""Exact sampled response of one mode: q'' + 2 zeta w q' + w^2 q = force, by its complex state.

With s = -zeta w + i w_d the state z = (q' - conj(s) q) / (2 i w_d) obeys dz/dt = s z + force / (2 i w_d), and q = 2 Re z,
q' = 2 Re(s z), q'' - force = 2 Re(s^2 z).
"""

import math
from dataclasses import dataclass

import numpy as np

BLOCK = 64


@dataclass(frozen=True)
class Oscillator:
    """Natural frequency [Hz] and damping ratio."""

    frequency_hz: float
    damping: float

    @property
    def omega(self):
        return 2 * math.pi * self.frequency_hz

    @property
    def damped(self):
        return self.omega * math.sqrt(1 - self.damping**2)

    @property
    def pole(self):
        return complex(-self.damping * self.omega, self.damped)


def recursion(rho, steps, start):
    """z_0 = start, z_(k+1) = rho z_k + steps_k; as many values as steps."""
    count = len(steps)
    blocks = -(-count // BLOCK)
    padded = np.zeros(blocks * BLOCK, dtype=complex)
    padded[:count] = steps
    powers = complex(rho) ** np.arange(BLOCK + 1)
    index = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK))
    toeplitz = np.where(index >= 0, powers[np.clip(index, 0, BLOCK)], 0)
    # Within a block: what its own steps add up to; then what came before is carried on.
    own = padded.reshape(blocks, BLOCK) @ toeplitz.T
    begins = np.empty(blocks, dtype=complex)
    carried = complex(start)
    ends = own[:, -1]
    factor = powers[BLOCK]
    for block in range(blocks):
        begins[block] = carried
        carried = carried * factor + ends[block]
    values = np.empty((blocks, BLOCK), dtype=complex)
    values[:, 0] = begins
    values[:, 1:] = own[:, :-1] + begins[:, None] * powers[1:BLOCK]
    return values.reshape(-1)[:count]


def gusts(count, fs_hz, log_sd, correlation_s, rng):
    """A positive amplitude whose logarithm is a stationary Ornstein-Uhlenbeck process; its mean square is one."""
    rho = math.exp(-1.0 / (fs_hz * correlation_s))
    steps = math.sqrt(1 - rho * rho) * rng.standard_normal(count)
    log = log_sd * recursion(rho, steps, rng.standard_normal()).real
    return np.exp(log - log_sd**2)


def ambient(oscillator, amplitude, fs_hz, rng):
    """The state under white force of intensity amplitude^2, constant within a sample interval; starts stationary."""
    s = oscillator.pole
    dt = 1.0 / fs_hz
    scale = 1.0 / (2 * oscillator.damped)
    # E |w|^2 and E w^2 of one step w = integral of exp(s (dt - t)) force / (2 i w_d), for intensity one.
    power = scale**2 * math.expm1(2 * s.real * dt) / (2 * s.real)
    pseudo = -(scale**2) * (np.exp(2 * s * dt) - 1) / (2 * s)
    steps = amplitude * correlated(power, pseudo, rng.standard_normal((2, len(amplitude))))
    begin = correlated(scale**2 / (-2 * s.real), scale**2 / (2 * s), rng.standard_normal((2, 1)))[0]
    return recursion(np.exp(s * dt), steps, amplitude[0] * begin)


def correlated(power, pseudo, normals):
    """Complex normal numbers with E |w|^2 = power and E w^2 = pseudo."""
    xx, yy, xy = 0.5 * (power + pseudo.real), 0.5 * (power - pseudo.real), 0.5 * pseudo.imag
    if yy >= xx:
        first = math.sqrt(max(yy, 0.0))
        mixed = xy / first if first > 0 else 0.0
        second = math.sqrt(max(xx - mixed**2, 0.0))
        return mixed * normals[0] + second * normals[1] + 1j * first * normals[0]
    first = math.sqrt(xx)
    mixed = xy / first
    second = math.sqrt(max(yy - mixed**2, 0.0))
    return first * normals[0] + 1j * (mixed * normals[0] + second * normals[1])


def after(oscillator, times, onset_s):
    """exp(s (t - onset)) from the onset on, zero before."""
    since = times - onset_s
    return np.where(since >= 0, np.exp(oscillator.pole * np.maximum(since, 0.0)), 0)


def blow(oscillator, times, onset_s, impulse, contact_s=0.0):
    """The state after an impulse (force over modal mass, times time); a half sine of contact_s around the onset."""
    s = oscillator.pole
    factor = 1.0
    if contact_s > 0:
        # Integral of (pi / 2 c) sin(pi t / c) exp(-s t) over 0 to c, referred to the middle of the contact.
        rate = math.pi / contact_s
        factor = 0.5 * rate**2 * (1 + np.exp(-s * contact_s)) / (s**2 + rate**2) * np.exp(s * 0.5 * contact_s)
    return impulse * factor / (2j * oscillator.damped) * after(oscillator, times, onset_s)


def release(oscillator, times, onset_s, force, ramp_s):
    """The state under a force (over modal mass) that grows linearly over ramp_s and vanishes at the onset."""
    s = oscillator.pole
    unit = force / (2j * oscillator.damped)
    if ramp_s <= 0:
        # The rod rests in its deflected shape until it is let go.
        held = np.where(times < onset_s, -unit / s, 0)
        return held - unit / s * after(oscillator, times, onset_s)

    def ramp(begin_s):
        since = np.maximum(times - begin_s, 0.0)
        return np.where(times >= begin_s, -unit / ramp_s * (since / s + (1 - np.exp(s * since)) / s**2), 0)

    def step(begin_s):
        since = np.maximum(times - begin_s, 0.0)
        return np.where(times >= begin_s, unit * (np.exp(s * since) - 1) / s, 0)

    return ramp(onset_s - ramp_s) - ramp(onset_s) - step(onset_s)
