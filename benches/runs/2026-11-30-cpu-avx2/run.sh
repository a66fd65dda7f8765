#!/usr/bin/env bash
# run.sh BEFORE AFTER: two builds of planecast, in turns; milliseconds per frame on the CPU, median of each round's frames.
set -euo pipefail
elevation=$(cd "$(dirname "$0")/../../.." && pwd)/assets/jacksboro-elevation.png
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$2" encode "$elevation" --height-scale 0.1 -o "$work/hills.pcast" --quiet
"$2" encode procedural:cloud --size 256 -o "$work/cloud.pcast" --quiet
"$2" encode procedural:rocks --size 512 -o "$work/rocks.pcast" --quiet

frames() {
    "$1" fly "$work/$3" -o "$work/f.mp4" --device cpu --size 640x360 --timeline "$work/t.csv" --quiet "${@:4}"
    echo "$2 $(tail -n +2 "$work/t.csv" | cut -d, -f2 | sort -n | awk '{v[NR] = $1} END {print v[int((NR + 1) / 2)]}')"
}
for round in 1 2 3 4 5; do
    for build in before after; do
        program=$1
        [ $build = after ] && program=$2
        frames "$program" "$build blocks" hills.pcast --smooth off --frames 24
        frames "$program" "$build surface" hills.pcast --smooth on --frames 24
        frames "$program" "$build surface+shadows" hills.pcast --smooth on --shadows on --frames 24
        frames "$program" "$build shadows" rocks.pcast --shadows on --frames 24
        frames "$program" "$build derived-normals" rocks.pcast --normals derived --frames 24
        # Without the first frame and the last: builds before did not end there.
        frames "$program" "$build cloud" cloud.pcast --frames 1..23/24
        frames "$program" "$build rays" rocks.pcast --kernel raycast --frames 24
    done
done | sort -k1,2 | awk '
    {k = $1 " " $2; n[k]++; v[k] = v[k] " " $3; if (!(k in low) || $3 < low[k]) low[k] = $3; if ($3 > high[k]) high[k] = $3; m[k, n[k]] = $3}
    END {for (k in n) {c = n[k]; for (i = 1; i <= c; i++) a[i] = m[k, i]; for (i = 1; i <= c; i++) for (j = i + 1; j <= c; j++) if (a[j] < a[i]) {t = a[i]; a[i] = a[j]; a[j] = t} printf "%-24s median %8.2f of %d rounds, %8.2f to %8.2f\n", k, a[int((c + 1) / 2)], c, low[k], high[k]}}' | sort -k2,2
