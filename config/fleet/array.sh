#!/bin/bash
# Runs an array of tasks on this machine as a scheduler would: it sets the scheduler's variable, runs the scheduler's own
# file, so many at once, and tries an index again that ended with 1.
#
#   config/fleet/array.sh slurm|kubernetes|aws PLAN RESULTS [AT_ONCE]
#
# Variables: TIRANTE, the program; ATTEMPTS, 4. Ends with 0 if every index has its result. Needs python3 for
# kubernetes and aws, whose commands it takes from kubernetes.yaml and aws-batch.json.
set -u
scheduler=$1 plan=$2 results=$3 at_once=${4:-2}
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
export TIRANTE=${TIRANTE:-tirante}

# The words of a container's command, one a line, with the folders of this machine in the place of the volumes.
words() {
  python3 - "$here" "$scheduler" "$plan" "$results" <<'PYTHON'
import json, re, sys
here, scheduler, plan, results = sys.argv[1:]
if scheduler == "aws":
    words = json.load(open(f"{here}/aws-batch.json"))["containerProperties"]["command"]
else:
    text = open(f"{here}/kubernetes.yaml").read()
    listed = re.search(r"command: \[(.*?)\]", text, re.S).group(1)
    words = [word.strip().strip('"') for word in listed.split(",")]
task = json.loads(open(plan).readline())
mounted = {"--out": results, "--scratch": results, "--archive": task["archive"], "--configs": task["configs"]}
for place, word in enumerate(words):
    before = words[place - 1] if place else ""
    print(plan if before == "task" else mounted.get(before, word))
PYTHON
}

element() {
  case $scheduler in
    slurm) SLURM_ARRAY_TASK_ID=$1 SLURM_ARRAY_JOB_ID=1 SLURM_CPUS_PER_TASK=1 SLURM_TMPDIR=$results bash "$here/slurm.sh" "$plan" "$results" ;;
    kubernetes) JOB_COMPLETION_INDEX=$1 "$TIRANTE" "${command[@]:1}" ;;
    aws) AWS_BATCH_JOB_ARRAY_INDEX=$1 "$TIRANTE" "${command[@]:1}" ;;
  esac
}

attempts() {
  local code=1 attempt
  for ((attempt = 0; attempt < ${ATTEMPTS:-4}; attempt++)); do
    element "$1"
    code=$?
    # 0: there; 2: no attempt will do.
    [ $code -eq 0 ] || [ $code -eq 2 ] && return $code
  done
  return $code
}

case $scheduler in
  slurm) ;;
  kubernetes | aws) mapfile -t command < <(words); [ ${#command[@]} -gt 3 ] || exit 2 ;;
  *) echo "slurm, kubernetes or aws" >&2; exit 2 ;;
esac
mkdir -p "$results"
count=$(wc -l < "$plan")
failed=0
for ((index = 0; index < count; index++)); do
  while [ "$(jobs -rp | wc -l)" -ge "$at_once" ]; do wait -n || failed=1; done
  attempts "$index" &
done
while [ -n "$(jobs -p)" ]; do wait -n || { [ $? -eq 127 ] && break; failed=1; }; done
exit $failed
