#!/usr/bin/env bash
# Measures encoding: the rows of README.md beside this, as Markdown on standard output.
#
#   PLANECAST=planecast HEIGHTS=heights DATA=folder WORK=folder bash run.sh
#
# Needs the command, optionally what `cargo bench --bench heights --no-run` builds (for the large terrain) and a folder of small real
# inputs; what is not there leaves its row out. All else is made here, 9 GiB in WORK. No network.
set -euo pipefail
planecast=${PLANECAST:-planecast} heights=${HEIGHTS:-} data=${DATA:-/nowhere}
work=${WORK:-$(mktemp -d)}
mkdir -p "$work"
cd "$work"

echo "$(nproc) cores of $(sed -n 's/model name[^:]*: //p' /proc/cpuinfo | head -1), $(free -g | awk '/Mem/ {print $2}') GiB of memory; $("$planecast" --version)"
echo
echo "| input | size, MiB | time, s | GB/s of input | peak memory, MiB | B/voxel | file, MB |"
echo "|---|---|---|---|---|---|---|"

# row NAME INPUT [options]: the quicker of two runs.
row() {
    local name=$1 input=$2 size= best= line=
    shift 2
    [ ! -e "$input" ] || size=$(($(stat -c %s "$input") / 1048576))
    for _ in 1 2; do
        line=$("$planecast" encode "$input" -o scene.pcast "$@" 2>&1 | tail -1) || { echo "$line" >&2; exit 1; }
        best=$(printf '%s\n%s\n' "$best" "$line" | grep . | awk -F', ' '{t = $3 + 0; if (!n++ || t < least) {least = t; l = $0}} END {print l}')
    done
    local seconds rate peak
    seconds=$(echo "$best" | sed -n 's/.* \([0-9.]*\) s,.*/\1/p')
    rate=$(echo "$best" | sed -n 's/.* \([0-9.]*\) GB\/s.*/\1/p')
    peak=$(echo "$best" | sed -n 's/.*at most \([0-9.]*\) \([MG]\)iB.*/\1 \2/p' | awk '{print int($1 * ($2 == "G" ? 1024 : 1))}')
    local voxel file
    voxel=$("$planecast" info scene.pcast | sed -n 's/^density *\([0-9.]*\).*/\1/p')
    file=$(awk "BEGIN {printf \"%.1f\", $(stat -c %s scene.pcast) / 1e6}")
    echo "| $name | $size | $seconds | $rate | $peak | $voxel | $file |"
}

row 'mixing layer 2,048³, made slice by slice' 'procedural:mixing?size=2048' --color none
cp scene.pcast mixing.pcast
"$planecast" decode mixing.pcast -o mixing.raw
dims='--dims 2048,2048,2048'
row 'the same as a raw u8 volume' mixing.raw $dims
cmp scene.pcast mixing.pcast >&2
row 'the same, `--memory 64M`' mixing.raw $dims --memory 64M
cmp scene.pcast mixing.pcast >&2
row 'the same, `--up z` (columns along the slow axis)' mixing.raw $dims --up z
row 'the same, `--up x` (columns along the fast axis)' mixing.raw $dims --up x
row 'the same, `--zstd 3`' mixing.raw $dims --zstd 3
copy=$(dd if=mixing.raw of=/dev/null bs=256K 2>&1 | sed -n 's/.*, \([0-9.]* .B\/s\)$/\1/p')
cached=$(awk '/^Cached/ {print int($2 / 1048576)}' /proc/meminfo)
rm mixing.raw

"$planecast" encode 'procedural:terrain?size=1024' --color none -o terrain.pcast 2>/dev/null
size=$("$planecast" info terrain.pcast | sed -n 's/^world *\([0-9]*\) × \([0-9]*\) × \([0-9]*\) .*/\1,\2,\3/p')
"$planecast" decode terrain.pcast -o terrain.raw
row "fractal terrain with caves as a raw u8 volume, ${size//,/ × }" terrain.raw --dims "$size"
rm terrain.raw

if [ -n "$heights" ]; then
    "$heights" heights.npy 16384
    row 'fractal terrain, 16,384² u16 heights (NPY), `--height-scale 0.5`' heights.npy --height-scale 0.5
    row 'the same, `--memory 256M`' heights.npy --height-scale 0.5 --memory 256M
    rm heights.npy
    cp scene.pcast heights.pcast
fi
real() { [ ! -e "$2" ] || row "$@"; }
real 'microscope stack, TIFF, 263 × 263 × 6, `--iso 40 --up z`' "$data/stack.tiff" --format stack --iso 40 --up z
real 'CT of an engine, NIfTI gzip, `--iso 80 --up z`' "$data/engine.nii.gz" --iso 80 --up z
real 'lidar, LAZ, 110,000 points with colours' "$data/cloud.laz"
real 'Stanford dragon, 11,102 triangles, `--size 1024`' "$data/dragon.ply.gz" --size 1024
real 'the same, `--size 2048`' "$data/dragon.ply.gz" --size 2048
real 'the same, `--size 4096`' "$data/dragon.ply.gz" --size 4096

echo
echo "Reading the 8 GiB in pieces of 256 KiB (dd): $copy; $cached GiB were cached."
echo
echo "| scene | \`verify --quick\` | \`verify\` | \`verify --deep\` | read (dd, warm) | read (dd, cold) |"
echo "|---|---|---|---|---|---|"
speed() { sed -n 's/.* \([0-9.]* [kMG]B\/s\)$/\1/p'; }
for scene in mixing heights; do
    [ -e "$scene.pcast" ] || continue
    rates=
    for how in --quick '' --deep; do
        "$planecast" verify $how "$scene.pcast" >/dev/null
        rates="$rates $("$planecast" verify $how "$scene.pcast" | sed -n 's/.* \([0-9.]*\) GB\/s$/\1 GB\/s |/p')"
    done
    warm=$(dd if="$scene.pcast" of=/dev/null bs=1M 2>&1 | speed)
    sync
    cold=$(dd if="$scene.pcast" of=/dev/null bs=1M iflag=direct 2>&1 | speed || true)
    echo "| $scene, $(($(stat -c %s "$scene.pcast") / 1000000)) MB |$rates $warm | ${cold:-not measured} |"
done
