# Worlds in tiles, before and after, on one machine in one go: OLD=… NEW=… OUT=… bash run.sh
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
    print(f"{f.split('/')[-1]:28} frames {len(rows)} total {med('total_ms'):.3f} p99 {p99('total_ms'):.3f} setup {med('setup_ms'):.3f} traverse {med('traverse_ms'):.4f} remap {med('remap_ms'):.4f} shade {med('shade_ms'):.4f} unpack {med('unpack_ms'):.3f} p99 {p99('unpack_ms'):.2f} upload {med('upload_ms'):.3f} wanted {med('tiles_wanted'):.0f} used {med('tiles_used'):.0f} debt/frame {debt:.0f} lod {med('lod'):.2f} MB up {sum(float(r['bytes_uploaded']) for r in rows)/1e6:.0f}", flush=True)
PY
python3 paths.py
W='procedural:hills?size=inf&seed=1'
python3 timed.py "encode 16,384²" $NEW encode "$W&window=536870912,536870912,16384,16384" -o h16.pcast -q
$NEW world h16.pcast -o w.pworld --repeat 64,64; ls -l *.pcast *.pworld
S="--size 1024x768"
for i in 1; do for v in old new; do P=$OLD; [ $v = new ] && P=$NEW
  for r in whole paged; do
    python3 timed.py "render 16,384² $r $v" $P render h16.pcast --residency $r $S --device gpu --eye 4000,700,8000 --pitch -12 --smooth off -o o-$r-$v.png --stats $OUT/render-$r-$v.json -q
    python3 timed.py "fly 16,384² $r $v" $P fly h16.pcast --path h16-4.json --frames 480 $S --residency $r --memory-gpu 4G --device gpu --smooth off --timeline $OUT/h16-$r-$v-$i.csv -o - -q
  done
  python3 timed.py "fly 16,384² paged, nothing counted $v" $P fly h16.pcast --path h16-4.json --frames 480 $S --residency paged --memory-gpu 4G --device gpu --smooth off -o - -q
done; done
for a in o-*.png; do cmp o-whole-old.png $a && echo "$a: the same picture"; done
for i in 1; do for v in old new; do P=$OLD; [ $v = new ] && P=$NEW
for s in 4 100; do
    python3 timed.py "fly 2^20 $s a frame wait $v" $P fly w.pworld --path world-$s.json --frames 240 $S --view-distance 180000 --memory-gpu 256M --stream wait --device gpu --timeline $OUT/world-$s-wait-$v-$i.csv -o - -q
done
python3 timed.py "fly 2^20 20 a frame deadline $v" $P fly w.pworld --path world-20.json --frames 240 $S --view-distance 180000 --memory-gpu 256M --stream deadline:4 --device gpu --timeline $OUT/world-20-deadline-$v-$i.csv -o - -q
for m in 256M; do python3 timed.py "fly endless 20 a frame $m $v" $P fly "$W" --path inf-20.json --frames 240 $S --view-distance 180000 --memory-gpu $m --stream wait --device gpu --timeline $OUT/inf-20-$m-$v-$i.csv -o - -q; done
done
python3 table.py $OUT/*-$i.csv
done
nvidia-smi --query-gpu=clocks.sm --format=csv,noheader

