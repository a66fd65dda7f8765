#!/usr/bin/env bash
# Makes one film three ways and compares the bytes: at once; with Dask, a worker killed in mid-job; with the Slurm script, a
# job killed and repeated. Needs python3 with dask and distributed; PLANECAST names the command.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
export PLANECAST=${PLANECAST:-$here/../../target/release/planecast}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
"$PLANECAST" encode 'procedural:hills?size=128' -o hills.pcast >/dev/null
how=(--size 320x180 --device cpu)
export FRAMES=288
"$PLANECAST" fly hills.pcast -o once.mp4 --frames "$FRAMES" "${how[@]}"

python3 "$here/test_dask_fly.py" "$PLANECAST" hills.pcast dask.mp4 "$FRAMES" "${how[@]}"
cmp once.mp4 dask.mp4

export SLURM_ARRAY_TASK_COUNT=3
for SLURM_ARRAY_TASK_ID in 2 1 0; do
    export SLURM_ARRAY_TASK_ID
    if [ "$SLURM_ARRAY_TASK_ID" = 1 ]; then
        bash "$here/slurm_fly.sh" hills.pcast slurm.mp4 "${how[@]}" & job=$!
        # As soon as it has saved a segment.
        until compgen -G 'slurm.mp4.jobs/000001.mp4.parts/*.segment' >/dev/null || [ -e slurm.mp4.jobs/000001.mp4 ]; do sleep 0.01; done
        kill -KILL "$job" && wait "$job" || true
        [ ! -e slurm.mp4.jobs/000001.mp4 ] || { echo "the job was too quick to be killed"; exit 1; }
    fi
    bash "$here/slurm_fly.sh" hills.pcast slurm.mp4 "${how[@]}"
done
rm slurm.mp4.jobs/000001.mp4
if bash "$here/slurm_fly.sh" join slurm.mp4; then echo "a missing part was not found"; exit 1; fi
SLURM_ARRAY_TASK_ID=1 bash "$here/slurm_fly.sh" hills.pcast slurm.mp4 "${how[@]}"
bash "$here/slurm_fly.sh" join slurm.mp4
cmp once.mp4 slurm.mp4
echo "equal: at once, Dask with a killed worker, Slurm with a killed job"
