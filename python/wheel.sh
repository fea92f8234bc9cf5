#!/usr/bin/env bash
# Builds the wheel of the Python package, the program in it: python/wheel.sh [--profile dev] [--program FILE] [DIR]
# With --program this program goes into the wheel; otherwise it is built, too.
# Needs a Rust toolchain and maturin (`pip install maturin`). One wheel serves Python 3.10 and later.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

profile=release program=
while [[ ${1:-} == --* ]]; do
  case $1 in
  --profile) profile=$2 ;;
  --program) program=$2 ;;
  *) echo "unknown: $1" >&2 && exit 2 ;;
  esac
  shift 2
done
out=${1:-target/wheel}

if [[ -z $program ]]; then
  program=${CARGO_TARGET_DIR:-target}/$([[ $profile == dev ]] && echo debug || echo "$profile")/tirante
  cargo build --locked --profile "$profile" --package tirante --bin tirante
fi
mkdir -p python/tirante.data/scripts
trap 'rm -rf python/tirante.data' EXIT
cp "$program" python/tirante.data/scripts/tirante
strip python/tirante.data/scripts/tirante
maturin build --locked --profile "$profile" --manifest-path python/Cargo.toml --out "$out"
ls -l "$out"
