#!/usr/bin/env bash
# Builds the wheel of the Python package, the program in it: python/wheel.sh [--profile dev] [DIR]
# Needs a Rust toolchain and maturin (`pip install maturin`). One wheel serves Python 3.10 and later.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

profile=release
if [[ ${1:-} == --profile ]]; then
  profile=$2
  shift 2
fi
out=${1:-target/wheel}

built=${CARGO_TARGET_DIR:-target}/$([[ $profile == dev ]] && echo debug || echo "$profile")
cargo build --locked --profile "$profile" --package tirante --bin tirante
mkdir -p python/tirante.data/scripts
trap 'rm -rf python/tirante.data' EXIT
cp "$built/tirante" python/tirante.data/scripts/
strip python/tirante.data/scripts/tirante
maturin build --locked --profile "$profile" --manifest-path python/Cargo.toml --out "$out"
ls -l "$out"
