#!/usr/bin/env bash
# Builds the wheel with the dev profile, installs it into an environment of its own, and tests it: types, numbers
# against the program, the notebook, every cell of it. python/check.sh [PROGRAM]: the program in the wheel, if it is built.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
python3 -m venv "$out/venv"
export PATH="$out/venv/bin:$PATH" TIRANTE_CACHE_DIR="$out/cache"
pip install --quiet maturin
python/wheel.sh --profile dev ${1:+--program "$1"} "$out/wheel"
pip install --quiet "$(echo "$out"/wheel/*.whl)[arviz]" ipykernel matplotlib mypy nbclient pytest
python -m mypy.stubtest tirante._core
python -m pytest --quiet python/tests
