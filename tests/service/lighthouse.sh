#!/usr/bin/env bash
# Judges the pages of a store by Lighthouse: tests/service/lighthouse.sh STORE [ROD]
# Needs chromium and `npm install lighthouse` in the present folder; TIRANTE names the program (default: target/release/tirante).
# Prints performance, accessibility and best practices (0 to 100), the layout shift and the time until the largest part is drawn of
# each page, on Lighthouse's phone (slowed four times, slow 4G) and on its desk. Exit code 1 below 90 or from a shift of 0.1 on.
set -euo pipefail
store=$1 rod=${2:-nave-3}
tirante=${TIRANTE:-$(dirname "${BASH_SOURCE[0]}")/../../target/release/tirante}
out=$(mktemp -d)
"$tirante" serve --store "$store" --listen 127.0.0.1:0 2>"$out/log" &
server=$!
trap 'kill $server; rm -rf "$out"' EXIT
until grep -qs 'http://' "$out/log"; do sleep 0.1; done
address=$(grep -o 'http://[0-9.:]*' "$out/log")
export CHROME_PATH=${CHROME_PATH:-$(command -v chromium)}
code=0
printf '%-8s %-12s %12s %14s %15s %6s %8s\n' device page performance accessibility best-practices shift 'LCP [s]'
for device in phone desk; do
  preset=()
  [ $device = desk ] && preset=(--preset=desktop)
  for page in / "/rod?id=$rod" /alarms; do
    npx --no-install lighthouse "$address$page" "${preset[@]}" --quiet --output=json --output-path="$out/page.json" \
      --only-categories=performance,accessibility,best-practices --chrome-flags='--headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage'
    python3 - "$out/page.json" $device "$page" <<'END' || code=1
import json, sys
found = json.load(open(sys.argv[1]))
of = {name: round(100 * one["score"]) for name, one in found["categories"].items()}
value = {name: found["audits"][name]["numericValue"] for name in ("cumulative-layout-shift", "largest-contentful-paint")}
shift = value["cumulative-layout-shift"]
print(f'{sys.argv[2]:8} {sys.argv[3]:12} {of["performance"]:12} {of["accessibility"]:14} {of["best-practices"]:15} {shift:6.3f} '
      f'{value["largest-contentful-paint"] / 1e3:8.2f}')
sys.exit(of["performance"] < 90 or shift >= 0.1)
END
  done
done
exit $code
