"""Scores of the gate sweep, its table and its figure."""

import numpy as np
import scipy.stats

from benchmarks.harness import results
from benchmarks.harness.stepping import CHANGE

ROWS, SETTLED = 29, 2.0
NEAR = 0.05  # s about a touchdown that count as shock
KINDS = (("own", "no"), ("own", "0.1 s"), ("nominal", "no"), ("nominal", "0.1 s"))


def touchdowns(force: np.ndarray) -> np.ndarray:
    """Ticks at which a foot's vertical force rises through 50 N: (rollouts, ticks)."""
    feet = force[..., 2].reshape(*force.shape[:2], 2, 4).sum(axis=-1)
    loaded = feet > 50.0
    out = np.zeros(force.shape[:2], bool)
    out[:, 1:] = (loaded[:, 1:] & ~loaded[:, :-1]).any(axis=-1)
    return out


def near(landed: np.ndarray, tick: float) -> np.ndarray:
    """Ticks within `NEAR` of a touchdown."""
    reach = round(NEAR / tick)
    wide = np.ones(2 * reach + 1)
    return np.stack([np.convolve(row, wide, "same") > 0 for row in landed.astype(float)])


def score(found: dict, force: np.ndarray, load: np.ndarray, nominal: float, tick: float) -> dict:
    """Medians over rollouts for every noise told × reopening × γ; shares are means."""
    mass, used, nis = found["mass"], found["used"], found["nis"]
    ticks = mass.shape[-1]
    time = (1 + np.arange(ticks)) * tick
    truth = nominal + np.where(time < CHANGE, load[:, :1], load[:, 1:])
    away = np.abs(mass - truth[:, None, None, None])
    landed = touchdowns(force)
    shock = near(landed, tick)
    walking = (time > SETTLED) & (time < CHANGE)
    change = np.abs(load[:, 1] - load[:, 0])
    out: dict = {"kinds": [], "landings_per_rollout": float(landed[:, walking].sum(axis=1).mean())}
    for i, (told, reopen) in enumerate(KINDS):
        a, u, n = (x[:, i // 2, i % 2] for x in (away, used, nis))
        calm, hit = walking & ~shock, walking & shock
        spikes = np.array([_spikes(a[k], landed[k] & walking, tick) for k in range(len(a))])
        lag, lost = _lag(a, change, time, tick)
        calm_used = np.array([u[k][:, calm[k]].mean(axis=-1) for k in range(len(u))])
        hit_used = np.array([u[k][:, hit[k]].mean(axis=-1) for k in range(len(u))])
        calm_nis = np.array([np.median(n[k][:, calm[k]], axis=-1) for k in range(len(n))])
        # A gate's own χ² test: of the consistent filter's calm samples, the share below each quantile.
        out["kinds"].append(
            {
                "told": told,
                "reopen": reopen,
                "rms_kg": np.median(np.sqrt((a[..., walking] ** 2).mean(-1)), axis=0).tolist(),
                "spike_kg": np.median(spikes, axis=0).tolist(),
                "lag_s": [None if not np.isfinite(x) else x for x in np.median(lag, axis=0)],
                "rejected_calm": (1 - calm_used).mean(axis=0).tolist(),
                "rejected_shock": (1 - hit_used).mean(axis=0).tolist(),
                "lock_outs": lost.sum(axis=0).tolist(),
                "calm_nis_over_rows": (np.median(calm_nis, axis=0) / ROWS).tolist(),
            }
        )
    out["nis"] = _consistency(nis[:, 0, 0, -1], walking & ~shock, walking & shock)
    return out


def _spikes(away: np.ndarray, landed: np.ndarray, tick: float) -> np.ndarray:
    """Largest error within 0.2 s of each touchdown, median over touchdowns, for every γ [kg]."""
    before, after = round(NEAR / tick), round(0.2 / tick)
    sizes = [away[:, max(k - before, 0) : k + after].max(-1) for k in np.flatnonzero(landed)]
    return np.median(sizes, axis=0) if sizes else np.full(len(away), np.nan)


def _lag(
    away: np.ndarray, change: np.ndarray, time: np.ndarray, tick: float
) -> tuple[np.ndarray, np.ndarray]:
    """Time from the change until the error stays below a fifth of it for half a second, and where it never does."""
    after = away[..., time >= CHANGE] < 0.2 * change[:, None, None]
    hold = round(0.5 / tick)
    sums = np.cumsum(np.pad(after, ((0, 0), (0, 0), (1, 0))), axis=-1)
    kept = sums[..., hold:] - sums[..., :-hold] >= 0.98 * hold
    never = ~kept.any(axis=-1)
    return np.where(never, np.inf, np.argmax(kept, axis=-1) * tick), never


def _consistency(nis: np.ndarray, calm: np.ndarray, shock: np.ndarray) -> dict:
    """NIS of the filter without a gate, told its noise: mean over rows, and share below χ² quantiles."""
    out = {}
    for name, where in (("calm", calm), ("shock", shock)):
        values = np.concatenate([n[w] for n, w in zip(nis, where, strict=True)])
        below = {str(p): float((values < scipy.stats.chi2.ppf(p, ROWS)).mean()) for p in LEVELS}
        quantiles = np.quantile(values, [0.5, 0.9, 0.99]).tolist()
        out[name] = {
            "mean_over_rows": float(values.mean() / ROWS),
            "below_quantile": below,
            "quantiles_50_90_99": quantiles,
        }
    return out


LEVELS = (0.5, 0.9, 0.99, 0.999)


def page(data: dict) -> str:
    """The page's part."""
    rows = []
    for kind in data["kinds"]:
        for j, name in enumerate(data["name"]):
            gamma, lag = data["gamma"][j], kind["lag_s"][j]
            rows.append(
                [
                    kind["told"],
                    kind["reopen"],
                    name,
                    "∞" if gamma is None else f"{gamma:.0f}",
                    f"{kind['rms_kg'][j]:.2f}",
                    f"{kind['spike_kg'][j]:.2f}",
                    "never" if lag is None else f"{lag:.2f}",
                    f"{kind['rejected_calm'][j]:.1%}",
                    f"{kind['rejected_shock'][j]:.1%}",
                    kind["lock_outs"][j],
                ]
            )
    head = ["noise told", "reopens", "gate", "γ", "RMS kg", "spike kg", "lag s"]
    head += ["rejected, calm", "rejected, shock", f"never found, of {data['rollouts']}"]
    nis = [
        [
            name,
            f"{part['mean_over_rows']:.2f}",
            *(f"{part['below_quantile'][str(p)]:.1%}" for p in LEVELS),
        ]
        for name, part in data["nis"].items()
    ]
    return "\n\n".join(
        [
            "## Innovation gate: which γ, and does the χ² reading hold?",
            f"{data['rollouts']} MJX rollouts of the humanoid stepping in place (`harness/stepping.py`: loads, noise, "
            "contact hardness and gait drawn at random), torso weighed by a filter of 10 states and 29 rows. "
            "RMS and spikes (largest error within 0.2 s of a touchdown) from 2 to 5 s; at 5 s the load changes "
            "by 3 to 12 kg; lag: until the error stays below a fifth of the change. Medians over rollouts. "
            "Calm: no touchdown within 0.05 s. `python benchmarks/gate_sweep.py`",
            results.table(head, rows),
            "The χ² reading: NIS without a gate, noise known. Share of samples below each χ² quantile of 29 degrees:",
            results.table(["", "mean NIS / 29", *(f"{p:g}" for p in LEVELS)], nis),
            results.sentence(data["about"]),
            "![Error, spikes, lag and rejections over γ](figures/gate_sweep.png)",
        ]
    )


def draw(data: dict, found: dict, load: np.ndarray, nominal: float, tick: float) -> None:
    """Scores over γ, one rollout, and the distribution of NIS."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 3, figsize=(12, 6.4), layout="constrained")
    at, names = np.arange(len(data["name"])), data["name"]
    order = np.argsort([np.inf if g is None else g for g in data["gamma"]])
    colours = ("#1b6ca8", "#d1701a")
    panels = (("rms_kg", "mass error, RMS [kg]"), ("spike_kg", "spike at a touchdown [kg]"))
    for ax, (key, label) in zip(axes[0], panels, strict=False):
        for kind in data["kinds"]:
            style = "-o" if kind["reopen"] != "no" else "--s"
            colour = colours[kind["told"] != "own"]
            text = f"noise {kind['told']}, " + (
                "reopens" if kind["reopen"] != "no" else "never reopens"
            )
            ax.plot(at, np.array(kind[key])[order], style, color=colour, ms=4, label=text)
        ax.set_ylabel(label)
        ax.set_yscale("log")
    axes[0, 0].legend(fontsize=7)
    for kind in data["kinds"]:
        style = "-o" if kind["reopen"] != "no" else "--s"
        share = np.array(kind["lock_outs"])[order] / data["rollouts"]
        axes[0, 2].plot(at, 100 * share, style, color=colours[kind["told"] != "own"], ms=4)
    axes[0, 2].set_ylabel("new load never found [%]")
    kind = data["kinds"][1]
    axes[1, 0].plot(at, 100 * np.array(kind["rejected_calm"])[order], "-o", ms=4, label="calm")
    axes[1, 0].plot(at, 100 * np.array(kind["rejected_shock"])[order], "-o", ms=4, label="shock")
    promised = [
        np.nan if data["probability"][j] is None else 1 - data["probability"][j] for j in order
    ]
    axes[1, 0].plot(at, 100 * np.array(promised), "k_", ms=12, label="promised by χ²")
    axes[1, 0].set_ylabel("rejected, noise known, reopens [%]")
    axes[1, 0].legend(fontsize=7)
    for ax in (*axes[0], axes[1, 0]):
        ax.set_xticks(at, [names[j] for j in order], rotation=60, fontsize=7)
        ax.grid(alpha=0.3)
    time = (1 + np.arange(found["mass"].shape[-1])) * tick
    ax = axes[1, 1]
    for name in ("none", "χ² 0.999", "1000"):
        ax.plot(time, found["mass"][0, 0, 1, names.index(name)], lw=0.8, label=name)
    truth = nominal + np.where(time < CHANGE, load[0, 0], load[0, 1])
    ax.plot(time, truth, "k", lw=1, label="true")
    ax.set_ylim(0, truth.max() + 15)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("torso mass of one rollout [kg]")
    ax.legend(fontsize=7)
    ax = axes[1, 2]
    grid = np.linspace(1, 120, 400)
    values = np.sort(found["nis"][:, 0, 0, -1][:, (time > SETTLED) & (time < CHANGE)].ravel())
    ax.plot(values, np.linspace(0, 1, len(values)), label="no gate, noise known, all ticks")
    ax.plot(grid, scipy.stats.chi2.cdf(grid, ROWS), "k--", label="χ², 29 degrees")
    ax.set_xscale("log")
    ax.set_xlabel("NIS")
    ax.set_ylabel("share below")
    ax.legend(fontsize=7)
    results.FIGURES.mkdir(exist_ok=True)
    fig.savefig(results.FIGURES / "gate_sweep.png", dpi=110)
    plt.close(fig)
