# Every figure of online.json, JOBS (16) processes at a time: bash benchmarks/online/all.sh FOLDER TRIALS SEEDS [PARTS]
# PARTS: a pattern for grep, e.g. "links\|honest". Longest first; all ends after LIMIT (3600) seconds; parts whose file is
# in FOLDER are left out, so that a run that was cut off goes on where it was.
# Blind walks are the paper's: python -m benchmarks.paper --only blind
# honest takes a GPU where there is one (two minutes for 1000 trials of all robots); the rest is for CPUs
export out=$1 n=$2 s=$3 jobs=${JOBS:-16} end=$(($(date +%s) + ${LIMIT:-3600}))
mkdir -p "$out"
{
for k in 0 1 2 3; do echo "walks minute $k 1 $out/minute_$k.json"; done
for k in 0 1 2 3; do echo "loops pelvis $((k * s / 4)) $((s / 4)) $out/pelvis_$k.json"; done
for k in 0 1 2 3; do echo "walks touchdowns $((k * s / 4)) $((s / 4)) $out/touchdowns_$k.json"; done
for k in 0 1 2 3; do echo "loops elbow $((k * s / 4)) $((s / 4)) $out/elbow_$k.json"; done
for r in humanoid quadruped arm small; do echo "honest $r $n $out/honest_$r.json"; done
for k in two_loads shocks calm; do
  for r in humanoid quadruped arm; do echo "links $r $k $s $out/links_${r}_$k.json"; done
done
} | grep "${4:-.}" | XLA_PYTHON_CLIENT_PREALLOCATE=false xargs -P "$jobs" -L 1 --process-slot-var=slot sh -c '
left=$((end - $(date +%s)))
for file; do :; done
[ $left -gt 0 ] && ! [ -s "$file" ] || exit 0
# One core each: XLA starts as many threads as it sees cores.
timeout $left taskset -c $(((slot - 1) % $(nproc) + ${FIRST_CORE:-0})) \
  ${PY:-python3} -m benchmarks.online.$0 $* 2>&1 | grep -v -i "warp\|of work"'
