#!/usr/bin/env bash
# Tests the Python package: its types, its numbers against the program, the notebook with every cell of it.
#   python/check.sh [PROGRAM]     builds the wheel with the dev profile and tests what it installs; PROGRAM: the one in the wheel, if it is built
#   python/check.sh --built DIR   tests the extension and the program that cargo has built in DIR (target/debug), without a wheel (.ci/run)
#   python/check.sh --fetch DIR   installs what that needs from elsewhere, and stops
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

tools=(ipykernel matplotlib mypy nbclient pytest)
if [[ ${1:-} == --built || ${1:-} == --fetch ]]; then
  mkdir -p "$2"
  built=$(realpath "$2")
  # Kept beside what is built, as that is: packages are fetched once.
  venv=$built/python-check
  [[ -x $venv/bin/pip ]] || python3 -m venv "$venv"
else
  out=$(mktemp -d)
  trap 'rm -rf "$out"' EXIT
  venv=$out/venv
  python3 -m venv "$venv"
fi
export PATH="$venv/bin:$PATH" TIRANTE_CACHE_DIR="$venv/cache" MYPY_CACHE_DIR="$venv/mypy" PYTHONDONTWRITEBYTECODE=1
if [[ ${1:-} == --built || ${1:-} == --fetch ]]; then
  mapfile -t needs < <(python - <<'END'
import tomllib
project = tomllib.load(open("python/pyproject.toml", "rb"))["project"]
print(*project["dependencies"], *project["optional-dependencies"]["arviz"], sep="\n")
END
  )
  pip install --quiet --disable-pip-version-check "${needs[@]}" "${tools[@]}"
  [[ $1 == --built ]] || exit 0
  package=$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/tirante
  rm -rf "$package"
  cp -r python/tirante "$package"
  ln -sf "$built/libtirante_core.so" "$package/_core.abi3.so"
  ln -sf "$built/tirante" "$venv/bin/tirante"
else
  pip install --quiet maturin
  python/wheel.sh --profile dev ${1:+--program "$1"} "$out/wheel"
  pip install --quiet "$(echo "$out"/wheel/*.whl)[arviz]" "${tools[@]}"
fi
python -m mypy.stubtest tirante._core
python -m pytest --quiet -p no:cacheprovider python/tests
