# Every figure of online.json, 16 processes at a time: bash benchmarks/online/all.sh FOLDER TRIALS SEEDS
# Elbow, pelvis and blind walks are the paper's: python -m benchmarks.paper --only elbow pelvis blind
out=$1; n=$2; s=$3
{
for r in humanoid quadruped arm small; do echo "honest $r $n $out/honest_$r.json"; done
for k in 0 1 2 3; do echo "walks touchdowns $((k * s / 4)) $((s / 4)) $out/touchdowns_$k.json"; done
for k in 0 1 2 3; do echo "walks minute $k 1 $out/minute_$k.json"; done
for r in humanoid quadruped arm; do
  for k in calm shocks two_loads; do echo "links $r $k $s $out/links_${r}_$k.json"; done
done
} | xargs -P 16 -L 1 sh -c 'timeout ${LIMIT:-3600} python3 -m benchmarks.online.$0 $* 2>&1 | grep -v -i "warp\|of work"'
