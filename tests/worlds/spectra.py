"""How high a part of a record stands over the rest of it, by plain averaged periodograms."""

import math

import numpy as np


def segment(count, fs_hz, duration_s):
    """Samples of a segment: a sixth of the record, 10 to 40 s, as far as there are so many."""
    return int(min(count, max(16, fs_hz * min(max(duration_s / 6, 10.0), 40.0))))


def welch(samples, fs_hz, length):
    """One-sided density of segments of `length` samples, half overlapping, under a Hann taper, less their means."""
    taper = np.hanning(length + 1)[:-1]
    step = max(length // 2, 1)
    begins = range(0, len(samples) - length + 1, step)
    windows = np.stack([samples[b : b + length] for b in begins])
    windows = windows - windows.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(windows * taper, axis=1)) ** 2
    return np.fft.rfftfreq(length, 1 / fs_hz), 2 * power.mean(axis=0) / (fs_hz * np.sum(taper**2))


def looks(samples, scene):
    """Spectra of a record; after strokes also of the seconds that follow the first one."""
    fs_hz = scene.fs_hz
    yield welch(samples, fs_hz, segment(len(samples), fs_hz, scene.duration_s))
    if scene.strokes:
        begin = max(0, math.ceil(scene.strokes[0].onset_s * fs_hz) + 1)
        for seconds in (4, 12, 36):
            piece = samples[begin : begin + int(seconds * fs_hz)]
            if len(piece) > 16:
                yield welch(piece, fs_hz, len(piece))


def near(frequency, frequency_hz):
    """The lines about a frequency."""
    return np.abs(frequency - frequency_hz) < max(1.0, 0.1 * frequency_hz, 4 * frequency[1])


def peak(samples, scene, frequency_hz):
    """The highest density of a part about its frequency."""
    return max(float(np.max(own[near(lines, frequency_hz)])) for lines, own in looks(samples, scene)) + 1e-300


def clearance_db(part, total, frequency_hz, scene):
    """The peak of a mode over the median of everything else about it [dB], in the look that shows it best."""
    best = -99.0
    for (frequency, own), (_, rest) in zip(looks(part, scene), looks(total - part, scene)):
        about = near(frequency, frequency_hz)
        level = np.max(own[about]) / max(np.median(rest[about]), 1e-300)
        best = max(best, 10 * math.log10(max(level, 1e-10)))
    return best
