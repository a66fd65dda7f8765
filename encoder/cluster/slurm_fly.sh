#!/usr/bin/env bash
# Makes a film with an array of Slurm jobs, each its share of the frames, and joins their parts.
#
#   job=$(sbatch --parsable --array=0-63 slurm_fly.sh SCENE.pcast FILM.mp4 [options of planecast fly])
#   sbatch --dependency=afterok:$job slurm_fly.sh join FILM.mp4
#
# FRAMES=N in the environment makes a film of N frames. A job that failed or was preempted is run again with the same --array
# number: sbatch --array=17 ... with ARRAY_SIZE=64. It goes on with the segments that it has saved.
#SBATCH --cpus-per-task=8
#SBATCH --requeue
set -euo pipefail
planecast=${PLANECAST:-planecast}

if [ "${1:-}" = join ]; then
    [ $# -eq 2 ] || { echo "usage: slurm_fly.sh join FILM.mp4" >&2; exit 2; }
    exec "$planecast" join "$2.jobs"/*.mp4 -o "$2"
fi

[ $# -ge 2 ] || { echo "usage: slurm_fly.sh SCENE.pcast FILM.mp4 [options of planecast fly]" >&2; exit 2; }
scene=$1 film=$2
shift 2
job=$SLURM_ARRAY_TASK_ID
jobs=${ARRAY_SIZE:-$SLURM_ARRAY_TASK_COUNT}
plan=$("$planecast" fly "$scene" -o "$film" ${FRAMES:+--frames "$FRAMES"} "$@" --plan)
frames=$(sed -n 's/.*"frames":\([0-9]*\).*/\1/p' <<<"$plan")
segment=$(sed -n 's/.*"segment":\([0-9]*\).*/\1/p' <<<"$plan")
# Cut where segments begin, so that the film has no key frame more than one made at once.
segments=$(((frames + segment - 1) / segment))
from=$((job * segments / jobs * segment)) to=$(((job + 1) * segments / jobs * segment))
[ "$to" -lt "$frames" ] || to=$frames
[ "$from" -lt "$to" ] || { echo "more jobs than segments: nothing for job $job"; exit 0; }

mkdir -p "$film.jobs"
part=$film.jobs/$(printf '%06d' "$job").mp4
[ -e "$part" ] && { echo "$part is there already"; exit 0; }
exec "$planecast" fly "$scene" "$@" --frames "$from..$to/$frames" -o "$part" --resume \
    ${SLURM_CPUS_PER_TASK:+--threads "$SLURM_CPUS_PER_TASK"}
