# Worlds in tiles: what the host takes, a large real file, many frames; OLD=… NEW=… OUT=… bash run.sh
OUT=${OUT:-.}; mkdir -p "$OUT"
nvidia-smi --query-gpu=name,clocks.sm --format=csv,noheader; nproc
cat > timed.py <<'PY'
import resource, subprocess, sys, time
at = time.time(); rc = subprocess.call(sys.argv[2:], stdout=subprocess.DEVNULL)
peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss >> 10
print(f"{sys.argv[1]}: {time.time() - at:.2f} s, peak {peak} MiB, rc {rc}", flush=True)
PY
cat > paths.py <<'PY'
import json
for name, x, z, y in [("h16", 4000, 8000, 700), ("world", 500000, 500000, 700), ("inf", 1 << 29, 1 << 29, 700), ("h64", 20000, 30000, 700)]:
    for speed in (4, 20, 100):
        frames = 480
        keys = [{"t": k * frames / 30 / 8, "eye": [x + speed * frames * k / 8, y, z + 0.3 * speed * frames * k / 8], "yaw": 73, "pitch": -12} for k in range(9)]
        json.dump(keys, open(f"{name}-{speed}.json", "w"))
# There and back, as often as it takes: the same tiles come and go all the time.
keys = [{"t": k * 10, "eye": [4000 + 8000 * (k % 2), 700, 8000], "yaw": 73, "pitch": -12} for k in range(334)]
json.dump(keys, open("long.json", "w"))
PY
cat > table.py <<'PY'
import csv, sys
for f in sys.argv[1:]:
    rows = list(csv.DictReader(open(f)))[8:]
    v = lambda c: sorted(float(r[c]) for r in rows)
    med = lambda c: v(c)[len(rows) // 2]
    p99 = lambda c: v(c)[int(len(rows) * .99)]
    debt = sum(float(r["debt"]) for r in rows) / len(rows)
    print(f"{f.split('/')[-1]:28} frames {len(rows)} total {med('total_ms'):.3f} p99 {p99('total_ms'):.3f} setup {med('setup_ms'):.3f} traverse {med('traverse_ms'):.4f} remap {med('remap_ms'):.4f} shade {med('shade_ms'):.4f} unpack {med('unpack_ms'):.3f} p99 {p99('unpack_ms'):.2f} upload {med('upload_ms'):.3f} wanted {med('tiles_wanted'):.0f} debt/frame {debt:.0f} lod {med('lod'):.2f}", flush=True)
PY
cat > memory.py <<'PY'
# Resident bytes of a command while it runs, every five seconds.
import subprocess, sys, time
p = subprocess.Popen(sys.argv[2:], stdout=subprocess.DEVNULL); at = time.time(); seen = []
while p.poll() is None:
    time.sleep(5)
    try: seen.append(int([l for l in open(f"/proc/{p.pid}/status") if l.startswith("VmRSS")][0].split()[1]) >> 10)
    except (OSError, IndexError): pass
print(f"{sys.argv[1]}: {time.time() - at:.0f} s, rc {p.returncode}, MiB every 5 s: {seen}", flush=True)
PY
python3 paths.py
W='procedural:hills?size=inf&seed=1'
S="--size 1024x768"
python3 timed.py "encode 16,384²" $NEW encode "$W&window=536870912,536870912,16384,16384" -o h16.pcast -q
$NEW world h16.pcast -o w.pworld --repeat 64,64
for i in 1 2; do for v in old new; do P=$OLD; [ $v = new ] && P=$NEW
for s in 4 100; do
    python3 timed.py "fly 2^20 $s a frame wait $v" $P fly w.pworld --path world-$s.json --frames 240 $S --view-distance 180000 --memory-gpu 256M --stream wait --device gpu --timeline $OUT/world-$s-$v-$i.csv -o - -q
done
python3 timed.py "fly endless 20 a frame $v" $P fly "$W" --path inf-20.json --frames 240 $S --view-distance 180000 --memory-gpu 256M --stream wait --device gpu --timeline $OUT/inf-20-$v-$i.csv -o - -q
python3 timed.py "fly 16,384² in tiles $v" $P fly h16.pcast --path h16-4.json --frames 240 $S --residency paged --memory-gpu 4G --device gpu --smooth off --timeline $OUT/h16-paged-$v-$i.csv -o - -q
python3 timed.py "fly 16,384² whole $v" $P fly h16.pcast --path h16-4.json --frames 240 $S --residency whole --device gpu --smooth off --timeline $OUT/h16-whole-$v-$i.csv -o - -q
done; python3 table.py $OUT/*-$i.csv; done
nvidia-smi --query-gpu=clocks.sm --format=csv,noheader
python3 memory.py "100,000 frames of 96 x 64 in tiles, 64 MiB" $NEW fly h16.pcast --path long.json --frames 100000 --size 96x64 --residency paged --memory-gpu 64M --device gpu --smooth off -o - -q
for k in 0 1 2 3; do python3 timed.py "encode sheet $k of 65,536²" $NEW encode "$W&window=$((536870912 + 32768 * (k % 2))),$((536870912 + 32768 * (k / 2))),32768,32768" -o s$k.pcast -q; done
ls -l *.pcast; $NEW world s0.pcast s1.pcast s2.pcast s3.pcast --across 2 -o real.pworld; $NEW info real.pworld | head -5
R="$NEW render real.pworld $S --eye 20000,700,30000 --yaw 73 --pitch -12 --view-distance 60000 --memory-gpu 256M --memory 512M -q"
sync; echo 3 > /proc/sys/vm/drop_caches && echo "page cache dropped"
python3 timed.py "render of 65,536², cold, gpu" $R --device gpu -o cold.png --stats $OUT/cold.json
python3 timed.py "the same, warm" $R --device gpu -o warm.png --stats $OUT/warm.json
sync; echo 3 > /proc/sys/vm/drop_caches && echo "page cache dropped"
python3 timed.py "the same, cold, deadline 4 ms" $R --device gpu --stream deadline:4 -o first.png --stats $OUT/first.json
sync; echo 3 > /proc/sys/vm/drop_caches
python3 timed.py "fly 65,536² 20 a frame" $NEW fly real.pworld --path h64-20.json --frames 240 $S --view-distance 60000 --memory-gpu 256M --memory 512M --device gpu --timeline $OUT/h64-20.csv -o - -q
python3 table.py $OUT/h64-20.csv
cmp cold.png warm.png && echo "the same picture"
cp cold.png first.png $OUT/
