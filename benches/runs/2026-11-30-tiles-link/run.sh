# Worlds in tiles: flights, jumps, and error against time over velocity, link and patience; OLD=… NEW=… bash run.sh
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
# Every 30 frames somewhere else, for 10 of them at once and then on from there.
keys = []
for k in range(16):
    x, z = 300000 + 40000 * (k % 5), 300000 + 50000 * (k % 3)
    keys += [{"t": k, "eye": [x, 700 + 300 * (k % 2), z], "yaw": 73 + 50 * k, "pitch": -12}, {"t": k + 0.97, "eye": [x + 600, 700 + 300 * (k % 2), z + 200], "yaw": 73 + 50 * k, "pitch": -12}]
json.dump(keys, open("jump.json", "w"))
PY
cat > table.py <<'PY'
import csv, sys
for f in sys.argv[1:]:
    rows = list(csv.DictReader(open(f)))[8:]
    v = lambda c: sorted(float(r[c]) for r in rows)
    med = lambda c: v(c)[len(rows) // 2]
    p99 = lambda c: v(c)[int(len(rows) * .99)]
    debt = sum(float(r["debt"]) for r in rows) / len(rows)
    print(f"{f.split('/')[-1]:28} frames {len(rows)} total {med('total_ms'):.3f} p99 {p99('total_ms'):.3f} max {v('total_ms')[-1]:.1f} setup {med('setup_ms'):.3f} traverse {med('traverse_ms'):.4f} shade {med('shade_ms'):.4f} unpack {med('unpack_ms'):.3f} p99 {p99('unpack_ms'):.2f} upload {med('upload_ms'):.3f} p99 {p99('upload_ms'):.2f} wanted {med('tiles_wanted'):.0f} debt/frame {debt:.0f} lod {med('lod'):.2f}", flush=True)
PY
python3 paths.py
W='procedural:hills?size=inf&seed=1'
S="--size 1024x768"
[ -e h16.pcast ] || python3 timed.py "encode 16,384²" $NEW encode "$W&window=536870912,536870912,16384,16384" -o h16.pcast -q
[ -e w.pworld ] || $NEW world h16.pcast -o w.pworld --repeat 64,64
for i in 1 2 3 4 5; do for v in old new; do P=$OLD; [ $v = new ] && P=$NEW
for s in 4 100; do
    python3 timed.py "fly 2^20 $s a frame wait $v" $P fly w.pworld --path world-$s.json --frames 240 $S --view-distance 180000 --memory-gpu 256M --stream wait --device gpu --timeline world-$s-$v-$i.csv -o - -q
done
for d in 0 4; do
    python3 timed.py "fly 2^20 jumps deadline $d $v" $P fly w.pworld --path jump.json --frames 480 $S --view-distance 180000 --memory-gpu 256M --stream deadline:$d --device gpu --timeline jump-$d-$v-$i.csv -o - -q
done
python3 timed.py "fly endless 20 a frame $v" $P fly "$W" --path inf-20.json --frames 240 $S --view-distance 180000 --memory-gpu 256M --stream wait --device gpu --timeline inf-20-$v-$i.csv -o - -q
python3 timed.py "fly 16,384² in tiles $v" $P fly h16.pcast --path h16-4.json --frames 240 $S --residency paged --memory-gpu 4G --device gpu --smooth off --timeline h16-paged-$v-$i.csv -o - -q
python3 timed.py "fly 16,384² whole $v" $P fly h16.pcast --path h16-4.json --frames 240 $S --residency whole --device gpu --smooth off --timeline h16-whole-$v-$i.csv -o - -q
done; python3 table.py *-$i.csv; done
nvidia-smi --query-gpu=clocks.sm --format=csv,noheader
$NEW report --stream w.pworld --path world-100.json --size 640x480 --view-distance 180000 --memory 271M -o stream --device gpu
