#!/usr/bin/env bash
# Makes an OCI image without a registry and without a container tool: target/image/tirante-VERSION-ARCH.tar, an OCI layout
# for `podman load -i`, `skopeo copy oci-archive:`, `docker load -i` (25 and later). One static program, no shell, no libraries.
#
#   systemd/image.sh                    builds the program statically and packs it
#   systemd/image.sh --binary FILE      packs a static program that is there; with --out FILE elsewhere
#
# The same program gives the same bytes.
set -euo pipefail

binary= out=
while [ $# -gt 0 ]; do
  case $1 in
    --binary) binary=$(realpath "$2"); shift 2 ;;
    --out) out=$(realpath "$2"); shift 2 ;;
    *) echo "systemd/image.sh [--binary FILE] [--out FILE]" >&2; exit 2 ;;
  esac
done
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [ -z "$binary" ]; then
  # With a target of its own the flag does not reach procedural macros.
  host=$(rustc -vV | sed -n 's/^host: //p')
  RUSTFLAGS="-C target-feature=+crt-static" cargo build --locked --release --target "$host"
  binary=target/$host/release/tirante
fi
if readelf --program-headers --wide "$binary" | grep -q INTERP; then
  echo "$binary is not static: it would need libraries that the image does not have" >&2
  exit 1
fi
case $(readelf --file-header "$binary" | sed -n 's/ *Machine: *//p') in
  *X86-64*) arch=amd64 ;;
  *AArch64*) arch=arm64 ;;
  *) echo "$binary is for a machine without a name here" >&2; exit 1 ;;
esac
version=$(sed -n '0,/^version = /s/^version = "\(.*\)"/\1/p' Cargo.toml)
out=${out:-target/image/tirante-$version-$arch.tar}

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pack() { # FOLDER: a tar whose bytes depend on nothing but the files
  tar --create --sort=name --mtime=@0 --owner=0 --group=0 --numeric-owner --format=ustar --directory "$1" .
}
digest() { sha256sum "$1" | cut -d' ' -f1; }
size() { stat --format=%s "$1"; }

# The file system: the program, a user, the folder of the data (volume), a folder for small files. Roots of certificates are in the program.
root=$work/root
mkdir -p "$root"/{usr/bin,etc/tirante,var/lib/tirante,var/cache/tirante,tmp}
strip --strip-all -o "$root/usr/bin/tirante" "$binary"
chmod 755 "$root/usr/bin/tirante"
chmod 1777 "$root/tmp"
chmod 777 "$root/var/lib/tirante" "$root/var/cache/tirante"
echo 'tirante:x:65532:65532:tirante:/var/lib/tirante:/nonexistent' > "$root/etc/passwd"
echo 'tirante:x:65532:' > "$root/etc/group"

blobs=$work/layout/blobs/sha256
mkdir -p "$blobs"
add() { # FILE: puts it among the blobs, prints its digest
  local name; name=$(digest "$1")
  cp "$1" "$blobs/$name"
  echo "$name"
}
pack "$root" > "$work/layer.tar"
inner=$(digest "$work/layer.tar")
gzip -9 --no-name "$work/layer.tar"
layer=$(add "$work/layer.tar.gz")

cat > "$work/config.json" <<JSON
{"architecture":"$arch","os":"linux","config":{"User":"65532:65532","Entrypoint":["/usr/bin/tirante"],"Cmd":["run","--config","/etc/tirante/tirante.toml"],"WorkingDir":"/var/lib/tirante","Env":["TIRANTE_CACHE_DIR=/var/cache/tirante"],"Volumes":{"/var/lib/tirante":{}},"ExposedPorts":{"7415/tcp":{},"7416/tcp":{}},"StopSignal":"SIGTERM","Labels":{"org.opencontainers.image.title":"tirante","org.opencontainers.image.version":"$version"}},"rootfs":{"type":"layers","diff_ids":["sha256:$inner"]},"history":[{"created_by":"systemd/image.sh"}]}
JSON
config=$(add "$work/config.json")
cat > "$work/manifest.json" <<JSON
{"schemaVersion":2,"mediaType":"application/vnd.oci.image.manifest.v1+json","config":{"mediaType":"application/vnd.oci.image.config.v1+json","digest":"sha256:$config","size":$(size "$work/config.json")},"layers":[{"mediaType":"application/vnd.oci.image.layer.v1.tar+gzip","digest":"sha256:$layer","size":$(size "$work/layer.tar.gz")}]}
JSON
manifest=$(add "$work/manifest.json")
cat > "$work/layout/index.json" <<JSON
{"schemaVersion":2,"mediaType":"application/vnd.oci.image.index.v1+json","manifests":[{"mediaType":"application/vnd.oci.image.manifest.v1+json","digest":"sha256:$manifest","size":$(size "$work/manifest.json"),"platform":{"architecture":"$arch","os":"linux"},"annotations":{"org.opencontainers.image.ref.name":"tirante:$version","io.containerd.image.name":"localhost/tirante:$version"}}]}
JSON
echo '{"imageLayoutVersion":"1.0.0"}' > "$work/layout/oci-layout"

mkdir -p "$(dirname "$out")"
pack "$work/layout" > "$out"
echo "$out: $(size "$out") bytes, tirante $version for linux/$arch, sha256:$manifest"
