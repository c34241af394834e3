# Every figure of online.json, 16 processes at a time: bash benchmarks/online/all.sh FOLDER TRIALS SEEDS
out=$1; n=$2; s=$3
{
for k in 0 1 2 3; do echo "loops blind $((k * s / 4)) $((s / 4)) $out/blind_$k.json"; done
for k in 0 1 2 3; do echo "loops elbow $((k * s / 4)) $((s / 4)) $out/elbow_$k.json"; done
for k in 0 1 2 3; do echo "loops pelvis $((k * s / 4)) $((s / 4)) $out/pelvis_$k.json"; done
for k in 0 1 2 3; do echo "walks touchdowns $((k * s / 4)) $((s / 4)) $out/touchdowns_$k.json"; done
for k in 0 2; do echo "walks minute $k 2 $out/minute_$k.json"; done
for r in humanoid quadruped arm; do echo "links $r $s $out/links_$r.json"; done
for r in humanoid quadruped arm small; do
  for d in float64 float32; do echo "honest $r $n $d exact $out/honest_${r}_${d}_exact.json"; done
done
for r in humanoid quadruped arm small; do echo "honest $r $n float64 extended $out/honest_${r}_float64_extended.json"; done
} | xargs -P 16 -L 1 sh -c 'timeout ${LIMIT:-3600} python3 -m benchmarks.online.$0 $* 2>&1 | grep -v -i "warp\|of work"'
