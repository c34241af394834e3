"""Closed-loop rollouts by the thousand: an arm in MJX that picks up an unknown load, with the estimator in its loop.

    python benchmarks/monte_carlo.py OUT [--rollouts 4096] [--shard 512] [--seed 0]

Results stream to OUT as npz shards with a manifest; the same command goes on where it was stopped. Rollouts are
spread over all devices; over several processes or hosts, each started with its own number:

    python benchmarks/monte_carlo.py OUT --hosts 2 --host 0 --coordinator localhost:9911 &
    python benchmarks/monte_carlo.py OUT --hosts 2 --host 1 --coordinator localhost:9911

A rollout hangs on the seed and its own number alone, and every device works through its share in groups of `--lanes`:
the same numbers come out however many devices there are.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.harness.core import quiet_blas

quiet_blas()

import argparse  # noqa: E402
import math  # noqa: E402

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax._src import distributed  # noqa: E402  (no public barrier without a collective)
from jax.experimental import multihost_utils  # noqa: E402
from jax.sharding import Mesh, NamedSharding  # noqa: E402
from jax.sharding import PartitionSpec as Spec  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: E402

from benchmarks.harness.arm_trial import ROBOTS, arm_trial  # noqa: E402
from benchmarks.harness.shards import Shards  # noqa: E402


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--rollouts", type=int, default=4096)
    parser.add_argument("--shard", type=int, default=512, help="rollouts to a file")
    parser.add_argument("--robot", choices=list(ROBOTS), default="arm")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=2.0, help="simulated, each")
    parser.add_argument("--lanes", type=int, default=16, help="rollouts side by side on a device")
    parser.add_argument("--hosts", type=int, default=1, help="processes altogether")
    parser.add_argument("--host", type=int, default=0, help="which of them this is")
    parser.add_argument("--coordinator", default="localhost:9911", help="address of process 0")
    return parser.parse_args()


def main() -> int:
    args = parsed()
    if args.hosts > 1:
        if jax.config.jax_platforms == "cpu":
            jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(args.coordinator, args.hosts, args.host)
    first = jax.process_index() == 0
    asked = {"robot": args.robot, "seed": args.seed, "seconds": args.seconds, "lanes": args.lanes}
    shards = None
    if first:
        try:
            shards = Shards(args.out, asked, args.rollouts, args.shard)
        except ValueError as error:
            print(f"monte_carlo: {error}", file=sys.stderr)
            return 2
    # Only the first process touches the folder; the others learn from it what is left to do.
    count = -(-args.rollouts // args.shard)
    todo = np.ones(count, bool)
    if shards is not None:
        todo[:] = [k not in shards.done for k in range(count)]
    if args.hosts > 1:
        todo = np.asarray(multihost_utils.broadcast_one_to_all(todo))
    try:
        work(args, shards, np.flatnonzero(todo))
    except KeyboardInterrupt:
        if shards is not None:
            print(f"\nstopped: {len(shards.done)} of {count} shards; the same command goes on")
        return 130
    if shards is not None:
        summary(shards)
    return 0


def work(args: argparse.Namespace, shards: Shards | None, numbers: np.ndarray) -> None:
    """Make the shards of these numbers."""
    mesh = Mesh(np.array(jax.devices()), ("device",))
    split = NamedSharding(mesh, Spec("device"))
    trial, seed = arm_trial(args.robot, args.seconds), jnp.asarray(args.seed)

    def share(indices):
        groups = indices.reshape(-1, args.lanes)
        out = jax.lax.map(jax.vmap(lambda i: trial(seed, i)), groups)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), out)

    run = jax.jit(
        jax.shard_map(
            share, mesh=mesh, in_specs=Spec("device"), out_specs=Spec("device"), check_vma=False
        )
    )
    group = args.lanes * mesh.size
    width = group * math.ceil(args.shard / group)
    with bar(shards is not None) as progress:
        total = args.rollouts
        left = sum(len(range(k * args.shard, min((k + 1) * args.shard, total))) for k in numbers)
        task = progress.add_task("rollouts", total=total, completed=total - left, rate="compiling")
        for number in numbers:
            begin = int(number) * args.shard
            held = min(args.shard, total - begin)
            # Filled up with rollouts that are thrown away, so that one program serves every shard.
            indices = (begin + np.arange(width)).astype(np.int32)
            placed = jax.make_array_from_callback((width,), split, lambda at, x=indices: x[at])
            out = run(placed)
            if args.hosts > 1:
                meet(jax.block_until_ready(out), int(number))
                out = multihost_utils.process_allgather(out, tiled=True)
            arrays = {name: np.asarray(x)[:held] for name, x in vars(out).items()}
            if shards is not None:
                shards.save(int(number), arrays)
            progress.advance(task, held)
            speed = progress.tasks[0].speed
            progress.update(task, rate=f"{speed:.0f}/s" if speed else "")


def meet(_: object, number: int) -> None:
    """Wait for the other processes, an hour if need be: collectives give up after half a minute."""
    client = distributed.global_state.client
    if client is not None:
        client.wait_at_barrier(f"shard {number}", 3_600_000)


def bar(watched: bool) -> Progress:
    """Progress with rate and time left; one process shows it, and only to a terminal."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    # The speed of the last quarter of an hour: one shard may take minutes.
    return Progress(
        *columns,
        console=console,
        disable=not (watched and console.is_terminal),
        speed_estimate_period=900,
    )


def summary(shards: Shards) -> None:
    """What came out, in a few lines."""
    data = shards.load()
    error, sigma = data["error"], data["sigma"]
    low, middle, high = np.quantile(error, [0.05, 0.5, 0.95])
    print(f"{len(error)} rollouts in {len(shards.done)} shards")
    print(f"load less truth: {middle:+.3f} kg, nine in ten from {low:+.3f} to {high:+.3f}")
    print(f"within two sigma: {np.mean(np.abs(error) < 2 * sigma):.1%}")
    print(f"NIS over rows: {np.median(data['nis_over_rows']):.2f}")
    print(f"tracking error: {1e3 * np.median(data['tracking']):.2f} mrad")
    print(f"every estimate physical: {np.mean(data['physical'] == 1.0):.1%}")


if __name__ == "__main__":
    sys.exit(main())
