#!/bin/bash
# Evaluates the clips of a manifest as a Slurm array, then prints the report of all of them:
#   lookout manifest /data/flights --out flights.csv
#   job=$(sbatch --parsable --array=0-63 slurm_eval.sh flights.csv /shared/run)
#   sbatch --dependency=afterok:$job --wrap 'lookout merge /shared/run'
# Each task takes every 64th clip by what Slurm says in the environment. The same again goes on where it was. Status 42
# (a clip cannot be decoded, the manifest makes no sense) is not worth another try: such tasks are not requeued.
#SBATCH --job-name=lookout
#SBATCH --cpus-per-task=1
#SBATCH --mem=1G
#SBATCH --requeue
set -u
manifest=$1 run=$2
shift 2
srun lookout eval --manifest "$manifest" --out "$run" --jobs 1 "$@"
status=$?
if [ "$status" -ne 0 ] && [ "$status" -ne 42 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 3 ]; then
  scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
fi
exit "$status"
