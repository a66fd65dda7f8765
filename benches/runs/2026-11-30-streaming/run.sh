# Worlds in tiles, on one machine in one go: PLANECAST=… OUT=… bash run.sh
P=${PLANECAST:-planecast}; OUT=${OUT:-.}; mkdir -p "$OUT"
nvidia-smi --query-gpu=name,clocks.sm --format=csv,noheader; nproc
cat > timed.py <<'PY'
import resource, subprocess, sys, time
at = time.time(); rc = subprocess.call(sys.argv[2:], stdout=subprocess.DEVNULL)
peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss >> 10
print(f"{sys.argv[1]}: {time.time() - at:.2f} s, peak {peak} MiB, rc {rc}", flush=True)
PY
cat > paths.py <<'PY'
import json
for name, x, z, y in [("h16", 4000, 8000, 700), ("world", 500000, 500000, 700), ("inf", 1 << 29, 1 << 29, 700)]:
    for speed in (4, 20, 100):
        frames = 480
        keys = [{"t": k * frames / 30 / 8, "eye": [x + speed * frames * k / 8, y, z + 0.3 * speed * frames * k / 8], "yaw": 73, "pitch": -12} for k in range(9)]
        json.dump(keys, open(f"{name}-{speed}.json", "w"))
PY
cat > table.py <<'PY'
import csv, sys
for f in sys.argv[1:]:
    rows = list(csv.DictReader(open(f)))[8:]
    v = lambda c: sorted(float(r[c]) for r in rows)
    med = lambda c: v(c)[len(rows) // 2]
    p99 = lambda c: v(c)[int(len(rows) * .99)]
    debt = sum(float(r["debt"]) for r in rows) / len(rows)
    print(f"{f.split('/')[-1]:28} frames {len(rows)} total {med('total_ms'):.3f} p99 {p99('total_ms'):.3f} traverse {med('traverse_ms'):.4f} remap {med('remap_ms'):.4f} shade {med('shade_ms'):.4f} unpack {med('unpack_ms'):.3f} p99 {p99('unpack_ms'):.2f} upload {med('upload_ms'):.3f} wanted {med('tiles_wanted'):.0f} used {med('tiles_used'):.0f} debt/frame {debt:.0f} lod {med('lod'):.2f} MB up {sum(float(r['bytes_uploaded']) for r in rows)/1e6:.0f}", flush=True)
PY
python3 paths.py
W='procedural:hills?size=inf&seed=1'
python3 timed.py "encode 16,384²" $P encode "$W&window=536870912,536870912,16384,16384" -o h16.pcast -q
$P world h16.pcast -o w.pworld --repeat 64,64; ls -l *.pcast *.pworld
S="--size 1024x768"
for i in 1 2; do for r in whole paged; do
    python3 timed.py "fly 16,384² $r" $P fly h16.pcast --path h16-4.json --frames 480 $S --residency $r --memory-gpu 4G --device gpu --smooth off --timeline $OUT/h16-$r-$i.csv -o - -q
done; done
for r in whole paged; do python3 timed.py "render 16,384² $r" $P render h16.pcast --residency $r $S --device gpu --eye 4000,700,8000 --pitch -12 --smooth off -o o-$r.png -q; done
cmp o-whole.png o-paged.png && echo "same picture"
for d in gpu cpu; do python3 timed.py "render 2^20 x 2^20 $d" $P render w.pworld $S --device $d --memory 512M --memory-gpu 256M --view-distance 180000 --eye 500000,700,500000 --yaw 73 --pitch -12 -o $OUT/world-$d.png --stats $OUT/world-$d.json -q; done
for v in 4 100; do for m in wait deadline:4; do
    python3 timed.py "fly 2^20 $v a frame $m" $P fly w.pworld --path world-$v.json --frames 480 $S --view-distance 180000 --memory-gpu 256M --stream $m --device gpu --timeline $OUT/world-$v-${m%:*}.csv -o - -q
done; done
python3 timed.py "fly 2^20 cpu" $P fly w.pworld --path world-4.json --frames 240 $S --view-distance 180000 --memory 128M --shading none --device cpu --timeline $OUT/world-4-cpu.csv -o - -q
for m in wait deadline:4; do python3 timed.py "fly endless 20 a frame $m" $P fly "$W" --path inf-20.json --frames 480 $S --view-distance 180000 --memory-gpu 256M --stream $m --device gpu --timeline $OUT/inf-20-${m%:*}.csv -o - -q; done
python3 timed.py "render endless" $P render "$W" $S --device gpu -o $OUT/endless.png -q
python3 table.py $OUT/*.csv
nvidia-smi --query-gpu=clocks.sm --format=csv,noheader
