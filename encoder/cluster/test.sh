#!/usr/bin/env bash
# Encodes one scene three ways and compares the bytes: at once; with Dask, a worker killed in mid-job; with the Slurm script,
# a job killed and repeated. Needs python3 with dask and distributed; PLANECAST names the command.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
export PLANECAST=${PLANECAST:-$here/../../target/release/planecast-encode}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
input='procedural:menger?level=6'
"$PLANECAST" encode "$input" --encoding surface -o once.pcast

python3 "$here/test_dask.py" "$PLANECAST" "$input" dask.pcast
cmp once.pcast dask.pcast

export SLURM_ARRAY_TASK_COUNT=5
for SLURM_ARRAY_TASK_ID in 4 1 0 3 2; do
    export SLURM_ARRAY_TASK_ID
    if [ "$SLURM_ARRAY_TASK_ID" = 1 ]; then
        bash "$here/slurm.sh" "$input" slurm.pcast --encoding surface & job=$!
        sleep 0.3
        kill -KILL "$job" && wait "$job" || true
        [ ! -e slurm.pcast.parts/000001.part ] || { echo "the job was too quick to be killed"; exit 1; }
    fi
    bash "$here/slurm.sh" "$input" slurm.pcast --encoding surface
done
rm slurm.pcast.parts/000003.part
if bash "$here/slurm.sh" merge slurm.pcast; then echo "a missing part was not found"; exit 1; fi
SLURM_ARRAY_TASK_ID=3 bash "$here/slurm.sh" "$input" slurm.pcast --encoding surface
bash "$here/slurm.sh" merge slurm.pcast
cmp once.pcast slurm.pcast
echo "equal: at once, Dask with a killed worker, Slurm with a killed job"
