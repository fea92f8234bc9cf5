#!/usr/bin/env bash
# Makes the Debian package: target/debian/tirante_*.deb. Needs `cargo install cargo-deb`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

cargo build --locked --release
# Man pages and completions come from the program itself; none is kept in the project.
rm -rf target/package
target/release/tirante manual --out target/package
# Without symbols it is a fifth of the size; a panic still says file and line.
cargo deb --locked --no-build --strip "$@"
