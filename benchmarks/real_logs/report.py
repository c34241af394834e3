"""RESULTS.md: every number comes from the run, and so do the verdicts."""

import os
import platform

import jax
import numpy as np

from benchmarks.real_logs import arms, ur10e
from benchmarks.real_logs.logs import LWR, PANDA, UR10E
from jax_inertia.maths.inertial_parameters import PI_NAMES


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def machine() -> str:
    """What a page was made on."""
    return f"{os.cpu_count()} CPUs, Python {platform.python_version()}, jax {jax.__version__}"


def _interval(value: tuple[float, float]) -> str:
    return f"{value[0]:.3f} ± {value[1]:.3f}"


def _covers(value: tuple[float, float], truth: float) -> str:
    return "yes" if abs(value[0] - truth) <= value[1] else "no"


def _numbers(x: np.ndarray, digits: int = 3) -> list[str]:
    return [f"{v:.{digits}f}".replace(f"-{0:.{digits}f}", f"{0:.{digits}f}") for v in x]


def _truth(log: str) -> float:
    return ur10e.TRUE_KG if log == ur10e.PAIR_PAYLOAD else 0.0


def render(
    weighings: list[ur10e.Weighing],
    held_out: list[tuple[str, str, tuple[float, float]]],
    online: list[ur10e.Online],
    by_joint: list,
    by_setting: list,
    race: list[ur10e.ChartRun],
    results: list[arms.ArmResult],
    wall: dict[str, float],
    machine: str,
) -> str:
    """The whole text."""
    parts = [
        "# Real logs\n\n`python -m benchmarks.real_logs.run` writes this page and its figures. "
        "Intervals are 95 % (± 1.96 σ). Nothing was tuned on the payload or on held-out logs.",
        _ur10e(weighings, held_out, by_joint, by_setting),
        _online(online),
        _charts(race),
        *[_arm(result) for result in results],
        "## Wall time\n\n"
        + table(["part", "s"], [[name, f"{s:.0f}"] for name, s in wall.items()])
        + f"\n\nCompiling included; {machine}, shared with other work at the time.",
    ]
    return "\n\n".join(parts) + "\n"


def _ur10e(weighings, held_out, by_joint, by_setting) -> str:
    rows = [
        [
            w.calibration,
            w.log,
            _interval(w.value),
            _covers(w.value, _truth(w.log)),
            " ".join(_numbers(w.com)) if w.log == ur10e.PAIR_PAYLOAD else "",
            "yes" if w.fit.converged else "no",
            str(w.fit.steps),
            f"{w.seconds:.1f}",
        ]
        for w in weighings
    ]
    head = ["gains and bodies", "log", "load [kg]", "covers the truth", "centre of mass [m]"]
    pair = table([*head, "converged", "LM steps", "s"], rows)
    fitted = [w for w in weighings if w.log == ur10e.PAIR_FREE and np.any(w.fit.gains_sigma > 0)]
    gains = table(
        ["calibration", *(f"joint {j}" for j in range(1, 7))],
        [
            [w.calibration]
            + [
                f"{g:.2f} ± {1.96 * s:.2f}"
                for g, s in zip(w.fit.gains, w.fit.gains_sigma, strict=True)
            ]
            for w in fitted
        ],
    )
    worst = max(abs(value[0]) for _, _, value in held_out)
    return f"""## UR10e: a payload of {ur10e.TRUE_KG} kg, weighed by motor currents

Settings: {UR10E.rate:g} Hz grid, {
        UR10E.cutoff:g} Hz zero-phase low-pass, central differences, rows of a joint slower
than {
        UR10E.slowest:g} rad/s left out (dry friction is not at its kinetic level there, and a low-pass smears its
reversal), 0.2 s cut at both ends. Fitted on dev_free_1 to 3: six bodies, and damping, dry friction, rotor inertia and
offset of each joint; the load (10 signed parameters, prior 0 ± 3 kg) is fitted in the same problem on the log in
question. `dev_pair_free` and `dev_pair_payload` are in no calibration of each other.

How far a model is trusted (1 σ, set before any load was weighed): the URDF's masses to 10 %, centres of mass to
5 cm; the maker's to 3 % and 2 cm. The published gain sets are taken as exact, as they were published.

{pair}

![Load by every calibration](ur10e_load.png)

Free gains as calibrated [N m/A]:

{gains}

**Why the answer depends on the model.** A current log has no scale of torque: gains, bodies and friction multiplied
by one number give the same currents, and the payload with them. The scale comes from the gains where they are taken
as known, and otherwise from the bodies, through gravity. Both published sets are precise about two different numbers.
Calibrated gains inherit the trust in the model. The data set's URDF is of the cylinder kind (its upper arm balances
7 cm further out than the maker's, its wrist 3 has a third of the mass), so the maker's published masses and centres
of mass are a third source, independent of the payload; see `ur10e_model.py`. The interval of a calibrated weighing
carries gains, bodies, friction and load jointly; that of an exact gain set cannot know that the gains are wrong.

No load, each free run held out of its own calibration (largest {worst:.3f} kg; the goal was 0.1):

{
        table(
            ["gains and bodies", "log", "load [kg]", "within 0.1"],
            [[n, log, _interval(v), "yes" if abs(v[0]) <= 0.1 else "no"] for n, log, v in held_out],
        )
    }

**What single joints say** (payload log restricted to one joint's rows, gains on the maker's inertias). The wrist's
axis that carries no gravity moment of mass alone tells nothing and says so:

{table(["joint", "load [kg]"], [[name, _interval(value)] for name, value in by_joint])}

**Other preparations of the logs** (gains on the maker's inertias). The answer does not hang on them:

{
        table(
            ["low-pass [Hz]", "slowest [rad/s]", "no load [kg]", "payload [kg]"],
            [
                [f"{s.cutoff:g}", f"{s.slowest:g}", _interval(a), _interval(b)]
                for s, a, b in by_setting
            ],
        )
    }

**What is left.** Friction that grows with load is not in the model: harmonic drives lose more when they carry more.
Where a motion goes up and down evenly it cancels in the mean and stays in the residual; what does not cancel scales
the payload like a gain error and is in no interval here. Rotational inertias of the links were never published; they
are fitted. Joints 1 and 6 carry little gravity, so their gains rest on inertia alone and are poorly known, which
costs nothing for the mass."""


def _online(online: list[ur10e.Online]) -> str:
    rows = [
        [
            o.calibration,
            o.variant,
            o.log,
            f"{o.value:.3f}",
            f"{o.own:.3f}",
            f"{o.total:.3f}",
            _covers((o.value, o.total), _truth(o.log)),
            f"{o.seconds:.2f}",
        ]
        for o in online
    ]
    head = ["gains and bodies", "filter", "log", "load [kg]", "± own", "± with calibration"]
    return f"""### Online

The filter on the calibrated model (free runs only), one load of 0 ± 3 kg on wrist 3, measurement noise as the
calibration found it (correlation time included), no process noise, no gate; read after the last sample. "± own" takes
the calibration as exact; "± with calibration" adds the spread over {ur10e.DRAWS} models drawn from its posterior.

{table([*head, "covers the truth", "s a run"], rows)}

![Load over time](ur10e_online.png)

One iteration in the paper's chart is the documented reproduction: on a wrist of 0.2 to 0.6 kg that picks up several
times its mass, the linearisation at the bare wrist throws the estimate far off at the first samples, with a
covariance that claims to know. Five iterations from the prior in the U Uᵀ chart, one argument each, do not."""


def _charts(race: list[ur10e.ChartRun]) -> str:
    rows = [
        [
            r.gains,
            r.chart,
            str(r.fit.steps),
            "yes" if r.fit.converged else "no",
            f"{r.fit.cost:.1f}",
            f"{r.seconds:.1f}",
            " ".join(_numbers(r.fit.rms_after, 2)),
        ]
        for r in race
    ]
    head = ["gains", "chart", "LM steps", "converged", "cost", "s", "rms after [N m]"]
    return f"""## Which chart converges best

The same calibration (dev_free_1 to 3, the maker's inertias to 3 % and 2 cm) in every chart from the same start, each run
twice and the second timed. Steps are Levenberg–Marquardt steps over both rounds; the prior is the same Gaussian to
first order only, so costs differ a little where bodies move far.

{table(head, rows)}

`LogCholeskyUUt` is the default of the batch fit for this reason: α and t are mass and centre of mass themselves, so
what gravity sees is one coordinate each, whereas in the paper's factor (UᵀU) every one of d, s and t moves mass
moments and inertia together. `Linear` needs few steps too, but nothing keeps it physical."""  # noqa: E501


def _arm(result: arms.ArmResult) -> str:
    arm, fit = result.arm, result.fit
    setting = PANDA if arm.setting is PANDA else LWR
    joints = [f"joint {j}" for j in range(1, len(fit.noise) + 1)]
    rows = []
    for log, models in result.residuals.items():
        rows.append([log, "torque about its mean", *_numbers(result.torque[log])])
        rows += [[log, label, *_numbers(rms)] for label, rms in models.items()]
    terms = [
        [f"{name} {unit}", *_pairs(getattr(fit.robot, name), fit.joint_sigma[name])]
        for name, unit in (
            ("damping", "[N m s/rad]"),
            ("frictionloss", "[N m]"),
            ("armature", "[kg m²]"),
        )
    ]
    terms.append(["offset [N m]", *_pairs(fit.joint_terms["offset"], fit.joint_sigma["offset"])])
    learnt = np.asarray(fit.estimate.sigma_pi) / np.asarray(result.prior.sigma_pi)
    known = [
        [name, *(p if r < 0.5 else "·" for p, r in zip(PI_NAMES, row, strict=True))]
        for name, row in zip(fit.robot.body_names, learnt, strict=True)
    ]
    structural, by_log = result.structural, result.by_log
    unseen = [n for n, i in zip(structural.names, structural.invisible, strict=True) if i]
    return f"""## {arm.name}: fitted on {arm.train}, judged on {", ".join(arm.tests)}

Settings: {setting.rate:g} Hz grid, {setting.cutoff:g} Hz zero-phase low-pass, rows slower than {setting.slowest:g} rad/s
left out; the model trusted to {100 * float(arm.trust.mass):.0f} % of mass, {100 * float(arm.trust.com):.0f} cm of centre of mass and
{100 * float(arm.trust.spread):.0f} % of radii of gyration (1 σ). Converged: {"yes" if fit.converged else "no"}, {fit.steps} steps, {result.seconds:.0f} s with
compiling. Residual rms [N m]:

{table(["log", "model", *joints], rows)}

Joint terms, in total, ± 95 % (a term that the data push below zero is held at zero and has no interval):

{table(["term", *joints], terms)}

{_remark(result)}

What the log cannot determine: of {len(structural.names)} parameters (10 a body, 4 a joint) only {structural.rank} combinations exist at
all, whatever the motion, and this log shows {by_log.rank} of them (condition {by_log.condition:.0f} after scaling, {structural.condition:.0f} for random
motion). Alone determined are {int(by_log.determined.sum())}, in combination only {int((~by_log.determined & ~by_log.invisible).sum())}, never seen {int(by_log.invisible.sum())}: {", ".join(unseen)}.
Parameters whose prior σ the log at least halved (a dot: it did not; what is printed for them elsewhere is the prior's word):

{table(["body", *[""] * 10], known)}"""  # noqa: E501


def _pairs(value, sigma) -> list[str]:
    return [
        f"{v:.3f} ± {1.96 * s:.3f}" if s > 0 else f"{v:.3f}"
        for v, s in zip(np.asarray(value), np.asarray(sigma), strict=True)
    ]


def _remark(result: arms.ArmResult) -> str:
    if result.arm.name == "Panda":
        largest = float(np.max(result.fit.robot.armature))
        return (
            f"The torque sensor sits behind the gear, so no rotor inertia may appear: largest {largest:.3f} kg m².\n\n"
            "Published friction of this very trajectory (classical least squares, Gaz et al. 2019, Table III): viscous "
            "0.0665 0.1987 0.0399 0.2257 0.1023 −0.0132 0.0638 N m s/rad, Coulomb 0.2450 0.1523 0.1827 0.3591 0.2669 "
            "0.1658 0.2109 N m, offset −0.1073 −0.1566 −0.0686 −0.2522 0.0045 0.0910 −0.0127 N m."
        )
    return (
        "Offsets that the data set's page gives from fits of its own, with three other models: joint 1 +0.84, joint 5 "
        "−0.63 to −0.68, joint 6 +0.56 to +0.68 N m; Coulomb friction about 0.5 (1), 0.2 to 0.6 (3), 1.0 to 1.2 (5), "
        "0.15 to 0.3 (6) N m."
    )
