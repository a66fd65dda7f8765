#!/bin/bash
# Times of one pose with and without each kind of light: the last of FRAMES frames of a film that stands still.
# light.sh PLANECAST OUT DEVICE THREADS FRAMES SIZE
set -e
bin=$1 out=$2 device=$3 threads=$4 frames=$5 size=$6
mkdir -p "$out"
root=$(cd "$(dirname "$0")/../../.." && pwd)
[ -e "$out/hills.pcast" ] || "$bin" -q encode "$root/assets/jacksboro-elevation.png" --colors "$root/assets/jacksboro-colors.png" --height-scale 0.1 --fractions -o "$out/hills.pcast"
[ -e "$out/terrain.pcast" ] || "$bin" -q encode "procedural:terrain?size=1024&seed=1" -o "$out/terrain.pcast"
[ -e "$out/rocks.pcast" ] || "$bin" -q encode "procedural:rocks?size=1024&seed=1" -o "$out/rocks.pcast"
pose() { echo "[{\"t\":0,\"eye\":[$1],\"yaw\":$2,\"pitch\":$3},{\"t\":1,\"eye\":[$1],\"yaw\":$2,\"pitch\":$3}]" > "$out/pose.json"; }
echo "scene,pose,light,device,setup,traverse,remap,shade,total"
while read -r scene name eye yaw pitch more; do
    pose "$eye" "$yaw" "$pitch"
    while read -r light flags; do
        "$bin" -q fly "$out/$scene.pcast" -o "$out/film" --path "$out/pose.json" --frames "$frames" --size "$size" --device "$device" \
            --threads "$threads" $more $flags --stats "$out/s.json" >/dev/null
        rm -rf "$out/film"
        ms=$(tr -d '\n ' < "$out/s.json" | sed 's/.*"[cg]pu_ms":{\([^}]*\)}.*/\1/; s/"[a-z]*"://g')
        echo "$scene,$name,$light,$device,$ms"
    done <<'LIGHTS'
plain --sun 300,25 --smooth off
shadows --sun 300,25 --smooth off --shadows on
smooth --sun 300,25 --smooth on
smooth+shadows --sun 300,25 --smooth on --shadows on
derived --sun 300,25 --smooth off --normals derived
plain-again --sun 300,25 --smooth off
LIGHTS
done <<'POSES'
hills low 500,75,700 20 -8
hills high 500,260,1000 0 -30
terrain far 512,420,512 30 -12 --repeat xz --view-distance 40000
terrain down 512,520,512 30 -60 --repeat xz --view-distance 40000
rocks far 512,420,512 30 -12 --repeat xz --view-distance 40000
POSES
