#!/bin/bash
# Slurm: one array element a task.
#
#   n=$(wc -l < plan.jsonl)
#   sbatch --array=0-$((n - 1))%200 config/fleet/slurm.sh plan.jsonl /shared/results
#
# `%200` is the most that run at once. An element that failed is put back by hand, or with the two lines below;
# a result that is there costs nothing.
#SBATCH --job-name=tirante
#SBATCH --cpus-per-task=1
#SBATCH --mem=1G
#SBATCH --time=12:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
set -u
plan=$1 results=$2
# The store under way is on the node's own disk: SQLite cannot work on a network file system.
scratch=${SLURM_TMPDIR:-${TMPDIR:-/tmp}}
"${TIRANTE:-tirante}" fleet task "$plan" --out "$results" --scratch "$scratch" --threads "${SLURM_CPUS_PER_TASK:-1}"
code=$?
# 1: try again, three times at most; 2: another attempt ends the same way.
if [ $code -eq 1 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 3 ] && command -v scontrol >/dev/null; then
  scontrol requeue "${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}"
fi
exit $code
