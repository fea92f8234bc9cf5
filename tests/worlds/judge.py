"""The program against rods that nothing in it made.

    python3 tests/worlds/judge.py --records 3000 --seed 1 --program target/release/tirante --folder /tmp/worlds

makes the records (those in the folder are used again), has the program write a configuration of each rod and replay them, and
prints a table by class, the calibration of the stated probability, and what is required as lines that pass or fail. Exit code 1 if
one fails.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import score
import tables
import worlds
from classes import CLASSES

# Records in one file.
BATCH = 25
# What the user of a class has to say besides: of one mode alone orders cannot be told.
SETTINGS = {"one-mode": "[modes]\ncount = 1\n"}


def replayed(program, stem, cache):
    """What the program says of every rod of a file."""
    command = [str(program), "replay", str(stem.with_suffix(".mcap")), "--config", str(stem.with_suffix(".toml")), "--json"]
    environment = dict(os.environ, TIRANTE_CACHE_DIR=str(cache))
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()[:2000]}")
    stem.with_suffix(".out").write_text(done.stdout, encoding="utf-8")
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    found = {}
    for line in lines:
        found.setdefault(line["rod"], []).append(line)
    return found


def judged(arguments, name, first, count, folder, settings):
    """The verdicts on one file."""
    stem = worlds.batch(folder, name, range(first, first + count), arguments.seed)
    said = replayed(arguments.program, stem, folder / "cache") if worlds.configure(stem, arguments.program, settings + SETTINGS.get(name, "")) else {}
    return [score.judge(truth, said.get(truth["rod"], [])) for truth in worlds.truth_of(stem)]


def doubtful(verdict):
    """Whether a person should look at it."""
    return verdict.wrong or verdict.intruders or (verdict.claimed and not verdict.has_rod) or any(abs(z) > 5 for z in verdict.deviations)


def describe(verdict):
    parts = [f"{verdict.rod}: {verdict.clear} clear, {'claimed' if verdict.claimed else verdict.code}"]
    if verdict.motion:
        parts.append(verdict.motion)
    if verdict.probability is not None:
        parts.append(f"p {verdict.probability:.3f}")
    if verdict.wrong:
        parts.append(f"wrong (said, true, Hz) {verdict.wrong}")
    if verdict.intruders:
        parts.append(f"foreign {verdict.intruders}")
    if verdict.force_held is not None:
        parts.append(f"N {'held' if verdict.force_held else 'missed'} ({verdict.force_z:+.1f} sd)")
    parts.append("z " + " ".join(f"{z:+.1f}" for z in verdict.deviations))
    return ", ".join(parts)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=3000, help="in all; the classes get equal shares")
    parser.add_argument("--classes", default=",".join(CLASSES), help="names, separated by commas")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", type=Path, default=Path("target/release/tirante"))
    parser.add_argument("--folder", type=Path, help="where records are kept; a temporary one by default")
    parser.add_argument("--settings", default="", help="TOML put into every configuration")
    parser.add_argument("--draws", type=int, default=20000, help="draws of the posterior")
    parser.add_argument("--jobs", type=int, default=1, help="files at a time")
    parser.add_argument("--report", type=Path, help="a Markdown file for the tables")
    parser.add_argument("--few", action="store_true", help="shares fail only if even the favourable end of their interval does")
    parser.add_argument("--look", action="store_true", help="lists records a person should look at")
    arguments = parser.parse_args()
    names = arguments.classes.split(",")
    if unknown := [name for name in names if name not in CLASSES]:
        sys.exit(f"no class {', '.join(unknown)}; there are {', '.join(CLASSES)}")
    temporary = None if arguments.folder else tempfile.TemporaryDirectory()
    folder = arguments.folder or Path(temporary.name)
    folder.mkdir(parents=True, exist_ok=True)
    each = max(1, math.ceil(arguments.records / len(names)))
    settings = f"[abc]\ndraws = {arguments.draws}\n" + arguments.settings.replace("\\n", "\n")
    work = [(name, first, min(BATCH, each - first)) for name in names for first in range(0, each, BATCH)]
    with ThreadPoolExecutor(arguments.jobs) as pool:
        parts = list(pool.map(lambda one: judged(arguments, *one, folder, settings), work))
    verdicts = [verdict for part in parts for verdict in part]
    required = tables.requirements(verdicts, arguments.few)
    lines = tables.by_class(verdicts) + [""]
    if any(v.probability is not None for v in verdicts):
        lines += tables.calibration(verdicts) + [""]
    lines += [f"- {'pass' if passes else 'FAIL'}: {text}" for passes, text in required]
    if arguments.look:
        lines += ["", *(f"- {describe(v)}" for v in verdicts if doubtful(v))]
    print("\n".join(lines))
    if arguments.report:
        arguments.report.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.exit(0 if all(passes for passes, _ in required) else 1)


if __name__ == "__main__":
    main()
