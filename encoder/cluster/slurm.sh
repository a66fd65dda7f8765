#!/usr/bin/env bash
# Encodes a scene with an array of Slurm jobs, each its share of the tiles, and joins their parts.
#
#   job=$(sbatch --parsable --array=0-63 slurm.sh INPUT SCENE.pcast [options of planecast encode])
#   sbatch --dependency=afterok:$job slurm.sh merge SCENE.pcast
#
# A job that failed or was preempted is run again with the same --array number: sbatch --array=17 ... with ARRAY_SIZE=64.
# INPUT and SCENE may be URLs of objects (s3://bucket/scene.pcast), where planecast was built with object storage.
#SBATCH --cpus-per-task=8
#SBATCH --requeue
set -euo pipefail
planecast=${PLANECAST:-planecast}

if [ "${1:-}" = merge ]; then
    [ $# -eq 2 ] || { echo "usage: slurm.sh merge SCENE.pcast" >&2; exit 2; }
    case $2 in *://*) exec "$planecast" merge "$2.parts/" -o "$2" ;; esac
    exec "$planecast" merge "$2.parts"/*.part -o "$2"
fi

[ $# -ge 2 ] || { echo "usage: slurm.sh INPUT SCENE.pcast [options of planecast encode]" >&2; exit 2; }
input=$1 scene=$2
shift 2
job=$SLURM_ARRAY_TASK_ID
jobs=${ARRAY_SIZE:-$SLURM_ARRAY_TASK_COUNT}
tiles=$("$planecast" encode "$input" "$@" --plan | sed -n 's/.*"tiles":\([0-9]*\).*/\1/p')
from=$((job * tiles / jobs)) to=$(((job + 1) * tiles / jobs))
[ "$from" -lt "$to" ] || { echo "more jobs than tiles: nothing for job $job"; exit 0; }

case $scene in *://*) ;; *) mkdir -p "$scene.parts" ;; esac
part=$scene.parts/$(printf '%06d' "$job").part
[ -e "$part" ] && { echo "$part is there already"; exit 0; }
exec "$planecast" encode "$input" "$@" --tiles "$from..$to" -o "$part" ${SLURM_CPUS_PER_TASK:+--threads "$SLURM_CPUS_PER_TASK"}
