"""What the program said of a record, held against the truth."""

import math
from dataclasses import dataclass, field

# A mode counts as clear from here on [dB].
CLEAR_DB = 10.0
# A record tells its orders if it states at least this probability for them.
TOLD = 0.95
Z95 = 1.959964


@dataclass
class Verdict:
    """One record judged."""

    name: str
    rod: str
    has_rod: bool
    known: bool
    clear: int
    claimed: bool = False
    code: str = ""
    probability: float = None
    held: int = 0
    judged: int = 0
    deviations: list = field(default_factory=list)
    wrong: list = field(default_factory=list)
    intruders: list = field(default_factory=list)
    force_held: bool = None
    force_z: float = None
    motion: str = ""
    # The likeliest assignment of a record that was refused: its probability, and if it is right.
    candidate: tuple = None

    @property
    def told(self):
        """Claimed, and without a word of doubt about the orders."""
        return self.claimed and (self.probability is None or self.probability >= TOLD)

    @property
    def right(self):
        return self.claimed and self.has_rod and not self.wrong and not self.intruders


def probability_of(line):
    """The probability stated for the orders; none in versions that did not state one."""
    stated = line.get("label_probability")
    return float(stated) if isinstance(stated, (int, float)) else None


def kind_of(excitation):
    """The motion that was recognised, in a word."""
    if isinstance(excitation, dict):
        return str(excitation.get("kind", ""))
    return str(excitation or "")


def judge(truth, lines):
    """The verdict on the lines a record gave; of several pieces the longest that was identified counts."""
    clear = sum(mode["clear_db"] >= CLEAR_DB for mode in truth["modes"])
    verdict = Verdict(truth["class"], truth["rod"], truth["has_rod"], truth["known"], clear)
    if not lines:
        verdict.code = "nothing"
        return verdict
    good = [line for line in lines if line["rejection"] is None]
    pool = good or lines
    line = max(pool, key=lambda one: one["duration_s"] or 0.0)
    verdict.motion = kind_of(line.get("excitation"))
    verdict.probability = probability_of(line)
    if not good:
        verdict.code = line["rejection"]["code"]
        verdict.candidate = judge_candidate(truth, line.get("candidates") or [])
        return verdict
    verdict.claimed = True
    force = line["axial_force_n"]
    if truth["has_rod"]:
        verdict.force_held = force["q025"] <= truth["axial_force_n"] <= force["q975"]
        verdict.force_z = (force["mean"] - truth["axial_force_n"]) / force["sd"] if force["sd"] > 0 else math.inf
        for mode in line["modes"]:
            judge_mode(verdict, truth, mode)
    return verdict


def judge_candidate(truth, candidates):
    """The probability stated for the likeliest assignment, and if all its orders are right."""
    if not candidates:
        return None
    best = max(candidates, key=lambda one: one["probability"])
    if not truth["has_rod"]:
        return best["probability"], False
    trial = Verdict(truth["class"], truth["rod"], True, truth["known"], 0, claimed=True)
    for mode in best["modes"]:
        # Candidates have no error of their own: a thousandth, small beside the modes' distance.
        judge_mode(trial, truth, dict(mode, sd_hz=1e-3 * mode["frequency_hz"]))
    return best["probability"], trial.right


def judge_mode(verdict, truth, mode):
    order, hz, sd = mode["order"], mode["frequency_hz"], mode["sd_hz"]
    real = truth["frequency_hz"]
    damping = {one["order"]: one["damping"] for one in truth["modes"]}

    def width(which):
        return max(0.01, 8 * damping.get(which, 0.005), 5 * sd / hz)

    nearest = min(range(1, len(real) + 1), key=lambda n: abs(math.log(hz / real[n - 1])))
    off = abs(hz / real[nearest - 1] - 1)
    visible = any(one["order"] == nearest for one in truth["modes"])
    foreign = min((abs(hz / other - 1) for other in truth["foreign_hz"]), default=math.inf)
    own = abs(hz / real[order - 1] - 1) if order <= len(real) else math.inf
    # Within some half-power widths the peaks of a mode and of a neighbour are one: the interval decides. Farther away the
    # neighbour's peak is not the mode's.
    apart = foreign < own / 3 and own > max(8 * damping.get(order, 0.005), 4 * sd / hz)
    if own < width(order) and not apart:
        verdict.judged += 1
        deviation = (hz - real[order - 1]) / sd
        verdict.deviations.append(deviation)
        verdict.held += abs(deviation) < Z95
    elif visible and off < width(nearest) and off < foreign:
        verdict.wrong.append((order, nearest, round(hz, 3)))
    else:
        verdict.intruders.append((order, round(hz, 3)))


def interval(hits, count, level=0.95):
    """The exact binomial interval of a share (Clopper and Pearson)."""
    if count == 0:
        return 0.0, 1.0

    def tail(share, upper):
        # P(X >= hits) or P(X <= hits).
        terms = range(hits, count + 1) if upper else range(0, hits + 1)
        total = 0.0
        for k in terms:
            log = math.lgamma(count + 1) - math.lgamma(k + 1) - math.lgamma(count - k + 1)
            total += math.exp(log + k * math.log(share) + (count - k) * math.log1p(-share))
        return total

    def solve(upper):
        low, high = 1e-12, 1 - 1e-12
        for _ in range(60):
            middle = 0.5 * (low + high)
            too_high = tail(middle, upper) > (1 - level) / 2
            if too_high == upper:
                high = middle
            else:
                low = middle
        return 0.5 * (low + high)

    return (0.0 if hits == 0 else solve(True)), (1.0 if hits == count else solve(False))
