#!/usr/bin/env bash
# Makes the Debian package: target/debian/tirante_*.deb. Needs `cargo install cargo-deb`.
#
#   systemd/package.sh                     for this machine
#   systemd/package.sh --target TRIPLE     for another one, such as aarch64-unknown-linux-gnu (arm64): needs its standard
#                                          library (`rustup target add`) and its C compiler (`apt install gcc-aarch64-linux-gnu`)
#   systemd/package.sh --binary FILE       packs a program that is there, of the machine that --target names
#
# Arguments behind `--` go to `cargo deb`.
set -euo pipefail

target= binary=
while [ $# -gt 0 ]; do
  case $1 in
    --target) target=$2; shift 2 ;;
    --binary) binary=$(realpath "$2"); shift 2 ;;
    --) shift; break ;;
    *) echo "systemd/package.sh [--target TRIPLE] [--binary FILE] [-- ARGUMENTS OF CARGO DEB]" >&2; exit 2 ;;
  esac
done
cd "$(dirname "${BASH_SOURCE[0]}")/.."

built=target/${target:+$target/}release/tirante
if [ -n "$binary" ]; then
  install -D "$binary" "$built"
else
  if [ -n "$target" ]; then
    # Debian names compilers by the triple without its vendor.
    compiler=${target/-unknown/}-gcc
    name=${target//-/_}
    export "CARGO_TARGET_${name^^}_LINKER=$compiler" "CC_$name=$compiler"
  fi
  cargo build --locked --release --bin tirante ${target:+--target "$target"}
fi
# Man pages and completions come from the program itself; none is kept in the project.
rm -rf target/package
if [ -n "$target" ]; then
  cargo run --locked --quiet -- manual --out target/package
else
  "$built" manual --out target/package
fi
version=$(sed -n '0,/^version = /s/^version = "\(.*\)"/\1/p' Cargo.toml)
cat > target/package/changelog <<CHANGES
tirante ($version-1) unstable; urgency=medium

  * Version $version: see CHANGELOG.md of its source.

 -- $(sed -n 's/^maintainer = "\(.*\)"/\1/p' Cargo.toml)  $(git log -1 --format=%cD 2>/dev/null || date -R)
CHANGES
# Without symbols it is a fifth of the size; a panic still says file and line.
cargo deb --locked --no-build --strip ${target:+--target "$target"} "$@"
