"""Years of monitored rods that nothing in the program made, followed by `tirante track`.

    python3 tests/years/judge.py --program target/release/tirante --worlds benign,full,ar5 --sites 20 --seed 1 --folder /tmp/years

makes the sites, has the program write their configurations and follow them (verdicts in the folder are used again: one folder a program), and
prints a Markdown table a kind of world: nothing happens, and something happens (`benign+loss3`; scenario.py has the names). Brackets are exact 95 %
intervals; rods of one site share the weather, so that true ones are wider. Then what is required (tables.py), as lines that pass or
fail: exit code 1 if one fails.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import scenario
import series
import tables
import verdicts


def followed(program, folder, cache):
    """The JSON lines of a site, and the seconds it took."""
    said = folder / "said.jsonl"
    command = [str(program), "track", "frequencies.csv", "temperatures.csv", "--config", "site.toml", "--json"]
    environment = dict(os.environ, TIRANTE_CACHE_DIR=str(cache), RAYON_NUM_THREADS="1")
    begun = time.monotonic()
    with said.open("w", encoding="utf-8") as out:
        done = subprocess.run(command, cwd=folder, stdout=out, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{folder}: {' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()[:2000]}")
    seconds = time.monotonic() - begun
    return [json.loads(line) for line in said.read_text(encoding="utf-8").splitlines()], seconds


def judged(arguments, folder, name, index):
    """The verdicts on one site and the seconds of the program; those in the folder are used again."""
    count = arguments.rods or int(series.stream(arguments.seed, name + " size", index).integers(1, 8))
    place = folder / f"{name}-{arguments.seed}-{index:04d}-{count}"
    known = place.with_suffix(".json")
    if known.exists():
        kept = json.loads(known.read_text(encoding="utf-8"))
        return [verdicts.Rod(**rod) for rod in kept["rods"]], kept["seconds"]
    site = series.Site(name, arguments.seed, index, count)
    place.mkdir(parents=True, exist_ok=True)
    site.write(place)
    site.configure(arguments.program, place, arguments.settings)
    lines, seconds = followed(arguments.program, place, folder / "cache")
    if not arguments.keep:
        for path in place.iterdir():
            path.unlink()
        place.rmdir()
    rods = verdicts.judge(site, index, lines)
    known.write_text(json.dumps({"rods": [asdict(rod) for rod in rods], "seconds": seconds}), encoding="utf-8")
    return rods, seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, default=Path("target/release/tirante"))
    parser.add_argument("--worlds", default=",".join(scenario.BASES), help="names, separated by commas")
    parser.add_argument("--sites", type=int, default=20, help="sites a world")
    parser.add_argument("--first", type=int, default=0, help="number of the first site")
    parser.add_argument("--rods", type=int, default=5, help="rods a site; 0 draws 1 to 7")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="where sites are made; a temporary one by default")
    parser.add_argument("--keep", action="store_true", help="keeps tables, configuration, truth and what the program said")
    parser.add_argument("--settings", default="", help="TOML put into every configuration")
    parser.add_argument("--jobs", type=int, default=2, help="sites at a time")
    parser.add_argument("--report", type=Path, help="a Markdown file for the tables")
    arguments = parser.parse_args()
    arguments.program = arguments.program.resolve()
    arguments.settings = arguments.settings.replace("\\n", "\n")
    names = arguments.worlds.split(",")
    for name in names:
        try:
            scenario.world(name, series.stream(0, name, 0), 1)
        except ValueError as error:
            sys.exit(str(error))
    temporary = None if arguments.folder else tempfile.TemporaryDirectory()
    folder = (arguments.folder or Path(temporary.name)).resolve()
    found, seconds = {}, Counter()
    with ThreadPoolExecutor(arguments.jobs) as pool:
        work = [(name, index) for name in names for index in range(arguments.first, arguments.first + arguments.sites)]
        for (name, _), (rods, took) in zip(work, pool.map(lambda one: judged(arguments, folder, *one), work)):
            found.setdefault(name, []).extend(rods)
            seconds[name] += took
    lines = tables.report(found, seconds)
    required = tables.requirements(found)
    lines += ["", *(f"- {'pass' if passes else 'FAIL'}: {text}" for passes, text in required)]
    print("\n".join(lines))
    if arguments.report:
        arguments.report.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.exit(0 if all(passes for passes, _ in required) else 1)


if __name__ == "__main__":
    main()
