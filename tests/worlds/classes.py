"""Classes of records: each draws a scene. Names are those of the tables the judge prints."""

import math

import rods
from rods import between, even_in_log
from scene import Clock, Foreign, Scene, Stroke, Tone

RATES = (50.0, 100.0, 128.0, 200.0, 256.0, 400.0, 512.0, 1000.0, 1024.0, 2000.0)
LENGTHS_S = (30.0, 60.0, 60.0, 60.0, 120.0, 300.0)


def damping(rng, low=0.0007, high=0.012):
    base = even_in_log(rng, low, high)
    return [float(min(base * math.exp(0.3 * rng.standard_normal()), 0.03)) for _ in range(12)]


def rate_for(rod, bands):
    """The slowest usual rate that shows `bands` modes."""
    wanted = rod.modes[bands - 1].frequency_hz / 0.42
    return next((rate for rate in RATES if rate >= wanted), RATES[-1])


def base(rng, bands=None, rod=None, **drawn):
    """A white ambient record of a rod as found in buildings, through one of three kinds of sensors."""
    rod = rod or rods.draw(rng, **drawn)
    bands = bands or int(rng.randint(3, 9))
    return Scene(
        rod=rod,
        damping=damping(rng),
        fs_hz=rate_for(rod, bands),
        duration_s=float(rng.choice(LENGTHS_S)),
        sensor_at=between(rng, 0.06, 0.48),
        quantity=str(rng.choice(["displacement", "velocity", "acceleration"], p=[0.4, 0.35, 0.25])),
        clearance_db=between(rng, 30, 55),
        sd_si=even_in_log(rng, 3e-6, 1e-4),
    )


def white(rng):
    return base(rng)


def gusts(rng, log_sd):
    scene = base(rng)
    scene.gust_log_sd, scene.gust_s = log_sd, float(rng.choice([5.0, 20.0]))
    scene.duration_s = float(rng.choice([60.0, 120.0]))
    return scene


def gusts_06(rng):
    return gusts(rng, 0.6)


def gusts_12(rng):
    return gusts(rng, 1.2)


def knocks(rng):
    scene = base(rng)
    scene.duration_s = float(rng.choice([60.0, 120.0]))
    at, onset = between(rng, 0.05, 0.95), between(rng, 1.0, 15.0)
    while onset < scene.duration_s - 2:
        sign = float(rng.choice([-1.0, 1.0]))
        size = sign * math.exp(0.3 * rng.standard_normal())
        scene.strokes.append(Stroke("blow", onset, at, size, contact_s=0.3 / scene.fs_hz))
        onset += 20 * math.exp(0.05 * rng.standard_normal())
    scene.ambient = 1 / even_in_log(rng, 3, 20)
    return scene


def struck(rng, onset_s, kind=None, ambient=True):
    """One stroke in a record of 20 to 60 s."""
    scene = base(rng)
    scene.duration_s = float(rng.choice([20.0, 30.0, 60.0]))
    kind = kind or str(rng.choice(["release", "blow"]))
    ramp = between(rng, 0.5, 3.0) if kind == "release" and onset_s > 0 else 0.0
    scene.strokes = [Stroke(kind, onset_s, between(rng, 0.08, 0.45), ramp_s=ramp, contact_s=0.3 / scene.fs_hz)]
    scene.ambient = 1 / even_in_log(rng, 20, 1000) if ambient else 0.0
    scene.clearance_db = between(rng, 40, 70)
    scene.sd_si = even_in_log(rng, 3e-5, 1e-3)
    return scene


def decay_at_0(rng):
    """Let go, or struck, at or just before the first sample."""
    return struck(rng, -between(rng, 0.0, 0.2), ambient=rng.random_sample() < 0.5)


def clean_decay_at_0(rng):
    """A pluck of a rod at rest: little damping, no ambient force, little noise."""
    scene = struck(rng, -between(rng, 0.0, 0.05), ambient=False)
    scene.damping = damping(rng, 0.0005, 0.002)
    scene.clearance_db = between(rng, 60, 90)
    return scene


def pull(rng):
    """A slow pull and a release after some seconds."""
    return struck(rng, between(rng, 3.0, 8.0), "release")


def pulls(rng):
    scene = struck(rng, between(rng, 2.0, 6.0))
    scene.duration_s = float(rng.choice([60.0, 90.0]))
    first = scene.strokes[0]
    for onset in (first.onset_s + 18, first.onset_s + 36):
        size = math.exp(0.2 * rng.standard_normal())
        scene.strokes.append(Stroke(first.kind, onset, first.at, size, first.ramp_s, first.contact_s))
    return scene


def blow_in_ambient(rng):
    scene = struck(rng, between(rng, 5.0, 15.0), "blow")
    scene.duration_s = 60.0
    scene.ambient = 1 / even_in_log(rng, 5, 40)
    scene.gust_log_sd = float(rng.choice([0.0, 0.6]))
    return scene


def triggered(rng):
    """A recorder with a pre-trigger."""
    return struck(rng, between(rng, 0.05, 0.6), "blow", ambient=rng.random_sample() < 0.5)


def many_modes(rng):
    """Seven to twelve modes in the band."""
    scene = base(rng, bands=int(rng.randint(7, 13)), slenderness=(120, 350))
    scene.quantity = str(rng.choice(["velocity", "acceleration"]))
    scene.clearance_db = between(rng, 45, 65)
    return scene


def laboratory(rng):
    """A laboratory tie-rod at 512 Hz: 1 to 60 kN, hammer, accelerometer."""
    rod = rods.draw(rng, length_m=(1.5, 4.0), slenderness=(100, 250), stress_pa=(10e6, 150e6))
    scene = struck(rng, between(rng, 0.02, 1.0), "blow", ambient=False)
    scene.rod, scene.fs_hz, scene.quantity = rod, 512.0, "acceleration"
    scene.duration_s = between(rng, 10.0, 20.0)
    return scene


def strings(rng):
    """Plucked strings and wires of a laboratory: a millimetre thick, under a metre to three."""
    scene = struck(rng, -between(rng, 0.0, 0.02), "release", ambient=False)
    scene.rod = rods.draw(rng, length_m=(0.6, 3.0), side=even_in_log(rng, 0.0012, 0.005), stress_pa=(50e6, 250e6))
    scene.fs_hz = rate_for(scene.rod, int(rng.randint(4, 10)))
    scene.damping = damping(rng, 0.0005, 0.003)
    scene.duration_s = between(rng, 10.0, 20.0)
    return scene


def midspan(rng):
    scene = base(rng, bands=int(rng.randint(5, 10)))
    scene.sensor_at = 0.5
    return scene


def first_missing(rng):
    """The first mode drowns: a velocity sensor under its corner frequency."""
    scene = base(rng, bands=int(rng.randint(4, 8)))
    scene.quantity, scene.pink = "acceleration", 30 * scene.rod.modes[0].frequency_hz
    scene.clearance_db = between(rng, 35, 45)
    return scene


def foreign(rng, count):
    scene = base(rng)
    top = 0.42 * scene.fs_hz
    low = 0.6 * scene.rod.modes[0].frequency_hz
    for _ in range(count):
        hz = even_in_log(rng, low, top)
        scene.foreign.append(Foreign(hz, even_in_log(rng, 0.002, 0.02), between(rng, -12, 6), int(rng.randint(0, 3))))
    return scene


def foreign_1(rng):
    return foreign(rng, 1)


def foreign_3(rng):
    return foreign(rng, 3)


def foreign_near(rng):
    """A foreign resonance 3 to 12 % from a mode."""
    scene = base(rng)
    beside = int(rng.randint(0, 3))
    off = float(rng.choice([-1, 1])) * between(rng, 0.03, 0.12)
    hz = scene.rod.modes[beside].frequency_hz * (1 + off)
    scene.foreign.append(Foreign(hz, even_in_log(rng, 0.002, 0.01), between(rng, -12, 3), beside))
    return scene


def neighbour(rng):
    """A like rod beside it: each of its first modes 1 to 4 half-power widths (2 zeta f) away."""
    scene = base(rng)
    widths, sign = between(rng, 1.0, 4.0), float(rng.choice([-1, 1]))
    level = between(rng, -20, -6)
    for beside, mode in enumerate(scene.rod.modes[:3]):
        own = scene.damping[beside]
        hz = mode.frequency_hz * (1 + sign * widths * 2 * own)
        scene.foreign.append(Foreign(hz, own * math.exp(0.2 * rng.standard_normal()), level, beside))
    return scene


def tones(rng):
    """Mains, a motor, and a tone that breathes."""
    scene = base(rng)
    top = 0.45 * scene.fs_hz
    mains = [hz for hz in (16.7, 50.0, 100.0, 150.0) if hz < top]
    scene.tones = [Tone(hz, between(rng, -15, 5)) for hz in mains[:2]]
    low = 0.6 * scene.rod.modes[0].frequency_hz
    scene.tones.append(Tone(even_in_log(rng, low, top), between(rng, -15, 5), breath=between(rng, 0.1, 0.5)))
    return scene


def tone_beside(rng):
    """A steady tone 0.4 to 5 % from a mode, a tenth to a hundred times its power."""
    scene = base(rng)
    beside = int(rng.randint(0, 3))
    off = float(rng.choice([-1, 1])) * even_in_log(rng, 0.004, 0.05)
    hz = scene.rod.modes[beside].frequency_hz * (1 + off)
    scene.tones = [Tone(hz, between(rng, -10, 20), beside=beside)]
    return scene


def coarse(rng):
    """A coarse converter: steps of a tenth to the whole of the standard deviation, ambient or decaying."""
    scene = base(rng) if rng.random_sample() < 0.5 else decay_at_0(rng)
    scene.clearance_db = between(rng, 50, 80)
    scene.step = even_in_log(rng, 0.1, 1.0)
    return scene


def drift(rng):
    """1/f noise that reaches the first modes."""
    scene = base(rng)
    scene.pink = even_in_log(rng, 0.3, 3.0) * scene.rod.modes[0].frequency_hz
    return scene


def late_block(rng):
    scene = base(rng) if rng.random_sample() < 0.5 else decay_at_0(rng)
    late = even_in_log(rng, 0.003, 0.05)
    scene.clock = Clock(int(scene.fs_hz * between(rng, 0.3, 1.5)), late_s=late, late_at=between(rng, 0.1, 0.9))
    return scene


def jitter(rng):
    """Samples stamped one by one by a computer that is busy."""
    scene = base(rng, bands=3) if rng.random_sample() < 0.5 else struck(rng, -0.01)
    scene.fs_hz = min(scene.fs_hz, 256.0)
    scene.duration_s = min(scene.duration_s, 60.0)
    scene.clock = Clock(1, jitter_s=even_in_log(rng, 0.0002, 0.002))
    return scene


def lost(rng):
    """Samples sent one by one of which some never arrive."""
    scene = base(rng, bands=3)
    scene.fs_hz = min(scene.fs_hz, 256.0)
    scene.duration_s = min(scene.duration_s, 60.0)
    scene.clock = Clock(1, lost=even_in_log(rng, 0.0005, 0.01), jitter_s=even_in_log(rng, 1e-5, 1e-4))
    return scene


def force_change(rng):
    """The sun on the rod: the force changes by up to one per cent within the record."""
    scene = base(rng)
    scene.force_change = float(rng.choice([-1, 1])) * even_in_log(rng, 0.001, 0.01)
    return scene


def softening(rng):
    """A decay whose frequency falls with its amplitude."""
    scene = decay_at_0(rng)
    scene.softening = even_in_log(rng, 0.0001, 0.001)
    return scene


def slack(rng):
    return base(rng, stress_pa=(1.5e6, 12e6))


def slender(rng):
    return base(rng, slenderness=(300, 700), length_m=(6.0, 20.0))


def stocky(rng):
    return base(rng, bands=3, slenderness=(30, 70), length_m=(2.0, 8.0))


def soft_supports(rng):
    """0 to 6 EI/L."""
    return base(rng, fixity=(0.0, 0.667))


def clamped(rng):
    return base(rng, fixity=(0.85, 0.99))


def heavy(rng):
    """Up to 2 MN."""
    return base(rng, length_m=(8.0, 20.0), side=between(rng, 0.07, 0.12), stress_pa=(80e6, 200e6))


def two_modes(rng):
    return base(rng, bands=2)


def one_mode(rng):
    """A slow camera at mid-span: mode 2 has a node there, mode 3 lies above half of the rate."""
    scene = base(rng, bands=1)
    scene.sensor_at = 0.5
    scene.fs_hz = round(5 * float(scene.rod.modes[0].frequency_hz), 1)
    return scene


def no_rod(rng):
    """Noise, resonances of other things, and tones."""
    scene = foreign(rng, int(rng.randint(0, 7)))
    scene.has_rod = False
    for other in scene.foreign:
        other.level_db = between(rng, -15, 5)
    if rng.random_sample() < 0.3:
        scene.tones = [Tone(even_in_log(rng, 1.0, 0.4 * scene.fs_hz), between(rng, -10, 0))]
    return scene


def other_rod(rng):
    """A rod of another length and section than the one configured."""
    scene = base(rng)
    while True:
        other = rods.draw(rng)
        # Bending over mass is what a configuration knows: another rod differs in it by more than half.
        stiff = [math.sqrt(r.beam.flexural_rigidity_n_m2 / r.beam.mass_per_length_kg_m) / r.beam.length_m**2 for r in (scene.rod, other)]
        if abs(math.log(stiff[1] / stiff[0])) > 0.4:
            scene.configured, scene.rod = scene.rod, other
            scene.fs_hz = rate_for(other, int(rng.randint(3, 9)))
            return scene


WITH_ROD = (
    white, gusts_06, gusts_12, knocks, decay_at_0, clean_decay_at_0, pull, pulls, blow_in_ambient, triggered, many_modes,
    laboratory, strings, midspan, first_missing, foreign_1, foreign_3, foreign_near, neighbour, tones, tone_beside, coarse, drift,
    late_block, jitter, lost, force_change, softening, slack, slender, stocky, soft_supports, clamped, heavy, two_modes, one_mode,
)  # fmt: skip
WITHOUT = (no_rod, other_rod)
CLASSES = {make.__name__.replace("_", "-"): make for make in WITH_ROD + WITHOUT}
