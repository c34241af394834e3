# Every figure of online.json, 15 processes at a time: bash benchmarks/online/all.sh FOLDER TRIALS SEEDS
out=$1; n=$2; s=$3
{
for k in 0 1 2 3; do echo "walks touchdowns $((k * s / 4)) $((s / 4)) $out/touchdowns_$k.json"; done
for k in 0 2; do echo "walks minute $k 2 $out/minute_$k.json"; done
for r in humanoid quadruped arm; do echo "links $r $s $out/links_$r.json"; done
for r in humanoid quadruped arm small; do
  for d in float64 float32; do echo "honest $r $n $d constant $out/honest_${r}_${d}_constant.json"; done
done
for r in humanoid quadruped arm small; do
  for f in exact extended; do echo "honest $r $n float64 $f $out/honest_${r}_float64_$f.json"; done
done
} | xargs -P 16 -L 1 sh -c 'timeout ${LIMIT:-3600} python3 -m benchmarks.online.$0 $* 2>&1 | grep -v -i "warp\|of work"'
