"""A record: what moves a rod, what else moves, what the sensor and its clock make of it, and the truth."""

import math
from dataclasses import dataclass, field

import numpy as np

import response
import rods
import spectra
from response import Oscillator

# Time under force before the record begins, so that gusts have left their mark on the state [s].
LEAD_S = 30.0


@dataclass
class Stroke:
    """A blow or a release at a time [s], at a share of the length; size relative to the record's others."""

    kind: str
    onset_s: float
    at: float
    size: float = 1.0
    ramp_s: float = 0.0
    contact_s: float = 0.0


@dataclass
class Foreign:
    """A resonance that is no mode of the rod: its peak stands `level_db` over that of mode `beside`."""

    frequency_hz: float
    damping: float
    level_db: float
    beside: int = 0
    shares_force: bool = True


@dataclass
class Tone:
    """A sinusoid, `level_db` over the peak of the strongest mode, or over the power of the mode `beside` (0 is the first); its amplitude
    breathes with sd `breath` of the logarithm."""

    frequency_hz: float
    level_db: float
    breath: float = 0.0
    breath_s: float = 10.0
    beside: int | None = None


@dataclass
class Clock:
    """How samples become messages: samples a message (one writes scalars), and what happens to the stamps."""

    per_message: int = 0
    jitter_s: float = 0.0
    late_s: float = 0.0
    late_at: float = 0.5
    lost: float = 0.0


@dataclass
class Scene:
    """Everything a record needs. Sizes are relative; `sd_si` scales the whole."""

    rod: object
    damping: list
    fs_hz: float
    duration_s: float
    sensor_at: float = 0.4
    quantity: str = "displacement"
    ambient: float = 1.0
    gust_log_sd: float = 0.0
    gust_s: float = 5.0
    strokes: list = field(default_factory=list)
    foreign: list = field(default_factory=list)
    tones: list = field(default_factory=list)
    clearance_db: float = 40.0
    pink: float = 0.0
    step: float = 0.0
    sd_si: float = 20e-6
    force_change: float = 0.0
    softening: float = 0.0
    clock: Clock = field(default_factory=Clock)
    has_rod: bool = True
    configured: object = None


@dataclass
class Record:
    """Samples as the sensor gives them (SI), with the truth about every mode and foreign resonance."""

    samples: np.ndarray
    scene: Scene
    modes: list
    foreign_hz: list


def seen(oscillator, state, quantity):
    """What a sensor of that quantity sees of a mode."""
    s = oscillator.pole
    factor = {"displacement": 1.0, "velocity": s, "acceleration": s * s}[quantity]
    return 2 * (factor * state).real


class Drift:
    """What a changing axial force does to each mode within a record: from minus to plus half of the change."""

    def __init__(self, scene, times):
        self.scene, self.times = scene, times
        half = 0.5 * scene.force_change
        force = scene.rod.axial_force_n
        self.ends = [rods.retuned(scene.rod, force * (1 + sign * half)) for sign in (-1, 1)] if half else None

    def phase(self, order):
        """Phase gained on the fixed frequency [rad]; none if the force stays."""
        if self.ends is None:
            return None
        low, high = (end.modes[order - 1].frequency_hz for end in self.ends)
        change = (high - low) * (np.clip(self.times / self.scene.duration_s, 0.0, 1.0) - 0.5)
        return 2 * math.pi * np.cumsum(change) / self.scene.fs_hz


def motion(scene, oscillator, participation, amplitude, times, phase, rng):
    """The complex state of one oscillator: ambient force and strokes."""
    state = np.zeros(len(times), dtype=complex)
    if scene.ambient > 0:
        state += response.ambient(oscillator, amplitude, scene.fs_hz, rng)
    for stroke in scene.strokes:
        part = participation(stroke.at) * stroke.size
        if stroke.kind == "blow":
            own = response.blow(oscillator, times, stroke.onset_s, part, stroke.contact_s)
        else:
            own = response.release(oscillator, times, stroke.onset_s, part, stroke.ramp_s)
        if scene.softening:
            since = np.maximum(times - stroke.onset_s, 0.0)
            rate = oscillator.damping * oscillator.omega
            own = own * np.exp(-1j * scene.softening / oscillator.damping * (1 - np.exp(-rate * since)))
        state += own
    if phase is not None:
        state = state * np.exp(1j * phase)
    return state


def render(scene, rng):
    """Makes the record."""
    fs_hz = scene.fs_hz
    lead = int(LEAD_S * fs_hz) if scene.ambient > 0 else 0
    count = int(round(scene.duration_s * fs_hz))
    times = (np.arange(lead + count) - lead) / fs_hz
    amplitude = np.ones(lead + count)
    if scene.gust_log_sd > 0:
        amplitude = response.gusts(lead + count, fs_hz, scene.gust_log_sd, scene.gust_s, rng)
    parts, modes, foreign_hz = [], [], []
    drift = Drift(scene, times)
    amplitude *= ambient_size(scene)
    for order, (mode, damping) in enumerate(zip(scene.rod.modes, scene.damping), 1):
        if not scene.has_rod or mode.frequency_hz > 0.47 * fs_hz:
            continue
        oscillator = Oscillator(mode.frequency_hz, damping)
        state = motion(scene, oscillator, mode.at, amplitude, times, drift.phase(order), rng)
        parts.append(mode.at(scene.sensor_at) * seen(oscillator, state, scene.quantity)[lead:])
        modes.append({"order": order, "frequency_hz": mode.frequency_hz, "damping": damping})
    level = [spectra.peak(part, scene, mode["frequency_hz"]) for part, mode in zip(parts, modes)] or [1.0]
    for other in scene.foreign:
        oscillator = Oscillator(other.frequency_hz, other.damping)
        own = amplitude if other.shares_force else np.full(lead + count, ambient_size(scene))
        state = motion(scene, oscillator, lambda at: 1.0, own, times, None, rng)
        part = seen(oscillator, state, scene.quantity)[lead:]
        beside = level[min(other.beside, len(level) - 1)]
        part *= math.sqrt(beside / spectra.peak(part, scene, other.frequency_hz)) * 10 ** (other.level_db / 20)
        parts.append(part)
        foreign_hz.append(other.frequency_hz)
    total = np.sum(parts, axis=0) if parts else np.zeros(count)
    strongest = max(level)
    noise_density = strongest / 10 ** (scene.clearance_db / 10)
    total = total + noise(count, fs_hz, noise_density, scene.pink, rng)
    for tone in scene.tones:
        wave = np.cos(2 * math.pi * tone.frequency_hz * times[lead:] + rng.uniform(0, 2 * math.pi))
        if tone.breath > 0:
            wave *= response.gusts(count, fs_hz, tone.breath, tone.breath_s, rng)
        if tone.beside is None:
            wave *= math.sqrt(strongest / spectra.peak(wave, scene, tone.frequency_hz))
        else:
            wave *= float(np.std(parts[tone.beside])) / float(np.std(wave))
        wave *= 10 ** (tone.level_db / 20)
        total = total + wave
        foreign_hz.append(tone.frequency_hz)
    scale = scene.sd_si / max(float(np.std(total)), 1e-300)
    total = total * scale
    if scene.step > 0:
        step = scene.step * scene.sd_si
        total = step * np.round(total / step)
    for mode, part in zip(modes, parts):
        mode["clear_db"] = spectra.clearance_db(scale * part, total, mode["frequency_hz"], scene)
    return Record(total, scene, modes, foreign_hz)


def ambient_size(scene):
    """Amplitude of the ambient force that makes strokes of size one stand `1 / ambient` over it in the first mode."""
    if not scene.strokes:
        return scene.ambient
    mode, damping = scene.rod.modes[0], scene.damping[0]
    oscillator = Oscillator(mode.frequency_hz, damping)
    stationary = 1 / (2 * oscillator.damped) / math.sqrt(2 * damping * oscillator.omega)
    stroke = scene.strokes[0]
    struck = abs(mode.at(stroke.at)) / (2 * oscillator.damped)
    if stroke.kind != "blow":
        struck /= oscillator.omega
    return scene.ambient * struck / stationary


def noise(count, fs_hz, density, pink, rng):
    """White noise of a one-sided density, and beside it 1/f noise of the same density at `pink` Hz."""
    white = math.sqrt(0.5 * density * fs_hz) * rng.standard_normal(count)
    if pink <= 0:
        return white
    spectrum = np.fft.rfft(rng.standard_normal(2 * count))
    frequency = np.fft.rfftfreq(2 * count, 1 / fs_hz)
    spectrum[0] = 0
    spectrum[1:] *= np.sqrt(pink / frequency[1:])
    return white + math.sqrt(0.5 * density * fs_hz) * np.fft.irfft(spectrum)[:count]
