# Every figure of online.json, 16 processes at a time: bash benchmarks/online/all.sh FOLDER TRIALS SEEDS
# Blind walks are the paper's: python -m benchmarks.paper --only blind
# honest takes a GPU where there is one (two minutes for 1000 trials of all robots); the rest is for CPUs
out=$1; n=$2; s=$3
{
for r in humanoid quadruped arm small; do echo "honest $r $n $out/honest_$r.json"; done
for k in 0 1 2 3; do echo "loops elbow $((k * s / 4)) $((s / 4)) $out/elbow_$k.json"; done
for k in 0 1 2 3; do echo "loops pelvis $((k * s / 4)) $((s / 4)) $out/pelvis_$k.json"; done
for k in 0 1 2 3; do echo "walks touchdowns $((k * s / 4)) $((s / 4)) $out/touchdowns_$k.json"; done
for k in 0 1 2 3; do echo "walks minute $k 1 $out/minute_$k.json"; done
for r in humanoid quadruped arm; do
  for k in calm shocks two_loads; do echo "links $r $k $s $out/links_${r}_$k.json"; done
done
} | XLA_PYTHON_CLIENT_PREALLOCATE=false xargs -P 16 -L 1 sh -c 'timeout ${LIMIT:-3600} python3 -m benchmarks.online.$0 $* 2>&1 | grep -v -i "warp\|of work"'
