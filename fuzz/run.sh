#!/usr/bin/env bash
# Coverage-guided fuzzing with the stable toolchain, without cargo-fuzz: builds the targets with address sanitiser, counters of coverage, debug
# assertions and overflow checks, writes the first corpus, and gives every target its turn until the time is over.
#   fuzz/run.sh MINUTES [TARGET...]     e.g. fuzz/run.sh 120    or    fuzz/run.sh 30 protocol
# Findings are in fuzz/artifacts/TARGET, what was found to reach new code in fuzz/target/corpus/TARGET; fuzz/target/TARGET.log tells the executions.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

minutes=${1:?minutes}
shift
targets=("$@")
((${#targets[@]})) || targets=(recording message protocol import stamps)
turn_s=${TURN_S:-240}
host=$(rustc -vV | sed -n 's/^host: //p')

# The flags of cargo-fuzz. The sanitiser's flag is an unstable one, which the variable allows; optimisation level 1 builds in a third of the time.
export RUSTC_BOOTSTRAP=1 CARGO_INCREMENTAL=0 CARGO_PROFILE_RELEASE_OPT_LEVEL=${OPT_LEVEL:-1}
coverage=(-Cpasses=sancov-module --cfg fuzzing -Zsanitizer=address)
for argument in -sanitizer-coverage-{level=4,inline-8bit-counters,pc-table,trace-compares} -simplifycfg-branch-fold-threshold=0; do
  coverage+=("-Cllvm-args=$argument")
done
RUSTFLAGS="${coverage[*]}" cargo build --release --target "$host" --bins
programs=target/$host/release
(cd .. && "fuzz/$programs/seeds")

deadline=$((SECONDS + minutes * 60))
while ((SECONDS < deadline)); do
  for target in "${targets[@]}"; do
    ((SECONDS < deadline)) || break
    left=$((deadline - SECONDS))
    mkdir -p "artifacts/$target" "target/corpus/$target"
    # A finding ends the turn, not the campaign.
    "$programs/$target" "target/corpus/$target" "corpus/$target" -artifact_prefix="artifacts/$target/" -print_final_stats=1 \
      -max_total_time=$((left < turn_s ? left : turn_s)) -timeout=20 -rss_limit_mb=1024 -max_len="${MAX_LEN:-65536}" >>"target/$target.log" 2>&1 ||
      echo "$target: a finding, see fuzz/artifacts/$target and the end of fuzz/target/$target.log"
  done
done

for target in "${targets[@]}"; do
  awk -v target="$target" '/stat::number_of_executed_units/ { runs += $2 } /^Done .* in .* second/ { seconds += $(NF - 1) }
    END { printf "%s: %d executions in %d s\n", target, runs, seconds }' "target/$target.log"
  echo "  findings: $(find "artifacts/$target" -type f 2>/dev/null | wc -l)"
done
