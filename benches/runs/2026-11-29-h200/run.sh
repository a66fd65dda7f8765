P=${PLANECAST:-planecast}; OUT=${OUT:-.}
T="/usr/bin/time -f %es_%MKiB"; [ -x /usr/bin/time ] || T=
nvidia-smi --query-gpu=name,clocks.sm --format=csv,noheader
python3 - <<'PY'
import numpy as np
from PIL import Image
n=16384
z=(np.arange(n)/n).astype('f4')[:,None]; x=(np.arange(n)/n).astype('f4')[None,:]
h=150+60*np.sin(9*x)*np.cos(7*z)+40*np.sin(31*x+5*z)**2+20*np.sin(97*x)*np.sin(83*z)
rng=np.random.default_rng(1)
for i in range(0,n,1024): h[i:i+1024]+=rng.random((1024,n),dtype='f4')*4
np.save('h.npy',h.astype('u2')); del h
c=np.stack([(np.arange(4096)[:,None]//16+np.arange(4096)[None,:]//16)%251]*3,-1).astype('u1')
c[...,1]=rng.integers(0,255,(4096,4096)); Image.fromarray(c).save('c.png')
PY
date +%T; $T $P encode h.npy -o g.pcast --height-scale 1 -q; date +%T
$T $P encode h.npy -o gc.pcast --height-scale 1 --colors c.png -q; date +%T; ls -l *.pcast
for s in g gc; do cat $s.pcast >/dev/null; for d in gpu cpu; do for i in 1 2; do A=$(date +%s%N); $T timeout 100 $P render $s.pcast -o o.png --device $d --size 1024x768 --stats $OUT/$s-$d.json -q --eye 8000,400,8000 --smooth off; B=$(date +%s%N); echo "$s $d render $(( (B-A)/1000000 )) ms"; done; done; done
$P encode 'procedural:rocks?size=1024' -o rocks.pcast -q
F="fly rocks.pcast --size 1920x1080 --repeat xz --view-distance 40000 --device gpu --frames 480"
for o in a.mp4 pngs; do for i in 1 2; do A=$(date +%s%N); $P $F -o $o -q; B=$(date +%s%N); echo "film $o 480 frames $(( (B-A)/1000000 )) ms"; rm -rf a.mp4 pngs; done; done
for x in "" "--shadows on --sun 315,40" "--normals derived --sun 315,40" "--sun 315,40"; do $P fly rocks.pcast --size 1920x1080 --repeat xz --view-distance 40000 --device gpu --frames 240 -o b.mp4 -q $x --stats s.json; echo "rocks fly [$x] $(python3 -c "import json;print(json.load(open('s.json'))['gpu_ms'])")"; done
for k in workgroup raycast raycast-runs workgroup; do $P fly rocks.pcast --size 1024x768 --repeat xz --view-distance 40000 --device gpu --kernel $k --frames 240 -o b.mp4 -q --stats s.json; echo "kernel $k $(python3 -c "import json;d=json.load(open('s.json'));print(d['gpu_ms'],d['bytes_scene_gpu'])")"; done
nvidia-smi --query-gpu=clocks.sm --format=csv,noheader
