#!/bin/sh
# A large cloud in tiles on a Slurm cluster: sh slurm.sh IN WORK OUT [options of `densecloud tiles plan`]
#
# IN and OUT are clouds, WORK is a new folder; each is an address such as s3://bucket/path, or a path that all nodes share. The
# plan is made here; an array makes the tiles, one a task, and a job that waits for all of them joins. Prints the number of
# that job. SBATCH_... in the environment sets partition, account and time.
set -eu
input=$1 work=$2 output=$3
shift 3

tiles=$(densecloud tiles plan "$input" "$work" --for "$output" "$@")
array=$(sbatch --parsable --requeue --array="0-$((tiles - 1))" --cpus-per-task="${CPUS:-4}" \
    --wrap "densecloud tiles run '$work' \$SLURM_ARRAY_TASK_ID --threads \$SLURM_CPUS_PER_TASK")
# Of a cluster's name nothing is wanted.
sbatch --parsable --requeue --dependency="afterok:${array%%;*}" --wrap "densecloud tiles join '$work' '$output'"
