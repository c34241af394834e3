"""The closed-loop likelihood: its linear response against closed forms and MuJoCo C, and what it finds."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from benchmarks.worlds.targets import machines as cases
from jax_inertia.likelihood import batch, motion
from jax_inertia.likelihood.closed_loop import ClosedLoop
from jax_inertia.likelihood.columns import ALL, Number
from jax_inertia.likelihood.evidence import Groups, Normal, selected, solve
from jax_inertia.likelihood.linearised import joints_of
from jax_inertia.likelihood.motion import Run
from jax_inertia.likelihood.response import Loop, response
from jax_inertia.logs.log import Log
from jax_inertia.replay import checks, inputs
from jax_inertia.replay.fitting.fit import fit
from jax_inertia.replay.loop import OFF, SHARES
from jax_inertia.replay.record import record_of
from jax_inertia.replay.search import closed_loop
from jax_inertia.replay.search.candidates import candidates
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay

STEP = 2.5e-4


def test_response_of_one_joint_is_the_closed_form():
    """M q̈ + C q̇ + K q = 1 from rest: a damped oscillation about 1/K."""
    m, c, k, h, steps = 0.02, 0.4, 30.0, 1e-3, 1500
    loop = Loop(*(np.full((steps, 1, 1), x) for x in (m, c, k)), np.zeros((steps, 1)))
    got = np.asarray(response(loop, jnp.ones((steps, 1, 1)), h, 5))[:, 0, 0]
    t = h * 5 * np.arange(1, steps // 5 + 1)
    decay, rate = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    swing = np.cos(rate * t) + decay / rate * np.sin(rate * t)
    np.testing.assert_allclose(got, (1 - np.exp(-decay * t) * swing) / k, atol=2e-3 / k)


def test_a_joint_that_friction_holds_hardly_moves():
    steps, h = 400, 1e-3
    loop = Loop(*(np.full((steps, 1, 1), x) for x in (0.02, 0.1, 5.0)), np.ones((steps, 1)))
    torque = jnp.zeros((steps, 1, 1)).at[:3].set(1.0)
    held = np.asarray(response(loop, torque, h, 1))
    loose = Loop(loop.mass, loop.damping, loop.stiffness, 0.0 * loop.held)
    free = np.asarray(response(loose, torque, h, 1))
    assert np.abs(held).max() < 0.2 * np.abs(free).max()


def test_response_loses_nothing_to_float32_where_inertias_differ_by_ten_thousand():
    rng, steps = np.random.default_rng(0), 600
    size = np.array([3.0, 0.3, 0.02, 3e-4])
    mix = rng.normal(size=(steps, 4, 4)) * 0.15 + np.eye(4)
    mass = np.einsum("tij,tkj->tik", mix, mix) * np.sqrt(np.outer(size, size))
    # As fast and as damped as each other.
    damping, stiffness = 60.0 * np.diag(size), 900.0 * np.diag(size)
    own = (np.tile(x, (steps, 1, 1)) for x in (damping, stiffness))
    loop = Loop(mass, *own, np.zeros((steps, 4)))
    torque = rng.normal(size=(steps, 4, 3)) * size[:, None]
    exact = np.asarray(response(loop, jnp.asarray(torque), 2e-3, 2))
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (loop, torque))
    got = np.asarray(response(*single, jnp.float32(2e-3), 2))
    assert got.dtype == np.float32
    np.testing.assert_allclose(
        got, exact, atol=3e-5 * np.abs(exact).max(axis=(0, 2))[:, None].max()
    )


# --- against MuJoCo C

KP, KD = np.array([28.0, 26.0, 24.0]), np.array([0.9, 0.8, 0.6])
MACHINE = cases.leg()
RUBBING = MACHINE.xml


class Simulated:
    """A leg by MuJoCo C at 0.25 ms, a continuous loop; numbers as the likelihood has them."""

    def __init__(self, seconds: float = 4.0, friction: float = 0.0):
        self.times = np.arange(0.0, seconds, STEP)
        told = cases.targets(MACHINE, seconds, 3)
        self.stamps, self.told, self.friction = 0.02 * np.arange(len(told)), told, friction

    def __call__(self, numbers, theta) -> np.ndarray:
        spec = mujoco.MjSpec.from_string(RUBBING)
        one = {(n.family, n.joint): x for n, x in zip(numbers, theta, strict=True)}

        def of(family: str) -> np.ndarray:
            own = np.array([one.get((family, j), 0.0) for j in range(3)])
            return own + one.get((family, ALL), 0.0)

        for number, x in zip(numbers, theta, strict=True):
            if number.family == "payload":
                body = spec.body(number.body)
                share = 1.0 + x / body.mass
                body.mass, body.inertia = body.mass * share, np.asarray(body.inertia) * share
            if number.family == "com_shift_z":
                body = spec.body(number.body)
                body.ipos = np.add(body.ipos, [0.0, 0.0, x])
            if number.family == "tilt_y":
                spec.option.gravity = [-9.81 * np.sin(x), 0.0, -9.81 * np.cos(x)]
        m = spec.compile()
        m.opt.timestep = STEP
        m.dof_frictionloss[:] = self.friction + of("coulomb_friction")
        m.dof_armature += of("armature")
        m.dof_damping += of("viscous_friction")
        d = mujoco.MjData(m)
        offset, delay, clock = of("encoder_offset"), of("target_delay")[0], of("loop_hold")[0]
        d.qpos[:] = self.told[0] - offset
        kp, out = KP * (1 + of("kp_scale")), np.empty((len(self.times), 3))
        for k, t in enumerate(self.times):
            out[k] = d.qpos + offset
            # The mean over a step, so that a delay of a part of one counts.
            at = np.clip(
                ((t + STEP * np.linspace(0.05, 0.95, 10) - delay) / 0.02).astype(int), 0, None
            )
            seen = d.qpos + offset - clock * d.qvel
            miss = self.told[at].mean(axis=0) - seen
            miss = miss - np.clip(miss, -of("dead_band"), of("dead_band"))
            torque = kp * miss - KD * (d.qvel - clock * d.qacc)
            # The likelihood's number of a limit is 1/L.
            limit = 1.0 / np.maximum(of("torque_saturation"), 1e-9)
            back = of("torque_speed") * d.qvel
            torque = np.clip(torque + back, -limit, limit) - back
            if of("load_friction").any():
                m.dof_frictionloss[:] = self.friction + of("load_friction") * np.abs(torque)
            d.qfrc_applied[:] = torque
            mujoco.mj_step(m, d)
        return out

    def loop(self, numbers, hidden=None) -> ClosedLoop:
        """The likelihood of its nominal run, or of one with hidden numbers, logged at 500 Hz."""
        spec = mujoco.MjSpec.from_string(RUBBING)
        for joint in spec.joints:
            joint.frictionloss = self.friction
        robot = ji.load_model(spec.compile())
        joints = joints_of(robot, MACHINE.joints)
        assert joints is not None
        every = 8
        time = self.times[::every]

        def path(thetas, k, edges):
            paths = [self(numbers, x) for x in thetas]
            return np.array([np.stack([np.interp(edges, self.times, q) for q in p.T], 1) for p in paths])  # fmt: skip

        q = self(numbers, np.zeros(len(numbers)) if hidden is None else hidden)[::every]
        run = Run(time, q, self.stamps, self.told, KP, KD, np.full(3, np.inf), np.ones_like(q))
        return ClosedLoop(robot, joints, [run], numbers, path, np.full(3, 1e-5))


SMALL = [
    (Number("armature", 1), 4e-4),
    (Number("viscous_friction", 0), 0.02),
    (Number("coulomb_friction", 2), 0.01),
    (Number("kp_scale", 1), 0.02),
    (Number("encoder_offset", 1), 0.01),
    (Number("target_delay"), 1e-3),
    (Number("loop_hold"), 2e-4),
    (Number("payload", body="knee_link"), 0.01),
    (Number("com_shift_z", body="hip_link"), 2e-3),
    (Number("tilt_y"), 0.01),
]


@pytest.mark.parametrize("friction", [0.0, 0.08])
@pytest.mark.slow
def test_columns_through_the_loop_are_what_mujoco_replays_change_by(friction):
    """A replay with a little of a number minus the nominal one, against G times its column.

    With dry friction, joints stop and go at other moments in a replay of other numbers, which no linear response has:
    friction itself is asked there, the smooth numbers without it.
    """
    small = [(n, x) for n, x in SMALL if (n.family == "coulomb_friction") == (friction > 0)]
    numbers = [n for n, _ in small]
    loop = Simulated(friction=friction).loop(numbers)
    nothing = np.zeros(len(numbers))
    error = [e[0] for e in loop.errors(nothing[None])]
    columns = loop.rows(nothing, error, along_replay=True).columns[0]
    most = 0.2 if friction else 0.05
    for k, (number, size) in enumerate(small):
        theta = nothing.copy()
        theta[k] = size
        # Measured minus replayed: what the replay changes by, turned round.
        there = -(loop.errors(theta[None])[0][0] - error[0])
        late = slice(150, None)
        missed = there[late] - size * columns[late, :, k]
        share = float(np.sqrt(np.mean(missed**2) / np.mean(there[late] ** 2)))
        assert share < most, (number.family, share)


@pytest.mark.parametrize(
    ("number", "friction", "most"),
    [
        (Number("dead_band", 1, shape=3e-3), 0.0, 0.1),
        (Number("torque_saturation", 1, shape=0.3), 0.0, 0.1),
        # Joints that friction holds let go at other moments, which no linear response has.
        (Number("load_friction", 2), 0.08, 0.35),
    ],
    ids=lambda x: getattr(x, "family", None),
)
def test_a_law_that_is_not_linear_is_compared_with_none(number, friction, most):
    """Along the motion of a robot that has it, the column is all that the nominal model's replay errs by."""
    none, size = np.zeros(1), np.array([number.shape or 0.03])
    loop = Simulated(friction=friction).loop([number], size)
    error = [e[0] for e in loop.errors(none[None])]
    column = loop.rows(none, error).columns[0][150:, :, 0]
    there = error[0][150:]
    missed = there - size * column
    assert np.sqrt(np.mean(missed**2) / np.mean(there**2)) < most


def test_a_limit_that_falls_with_speed_is_two_numbers_together():
    """Its slope does nothing without a limit; both columns, one beside the other, are what the replay errs by."""
    both = {"effect": "torque_speed", "shape": -1.0}
    size = np.array([0.3, 0.15])
    numbers = [
        Number("torque_saturation", 1, **both, size=size[0]),
        Number("torque_speed", 1, **both, size=size[1], beside=size[0]),
    ]
    none = np.zeros(2)
    loop = Simulated(friction=0.0).loop(numbers, size)
    error = [e[0] for e in loop.errors(none[None])]
    columns = loop.rows(none, error).columns[0][150:]
    there = error[0][150:]
    left = [there - columns[:, :, :k] @ size[:k] for k in (1, 2)]
    limit, whole = (np.sqrt(np.mean(x**2) / np.mean(there**2)) for x in left)
    assert whole < 0.1 < limit


def test_a_number_that_stands_in_for_another_goes_on_from_where_that_is():
    """A limit that falls with speed, exchanged for one that does not, keeps the limit."""
    both = {"effect": "torque_speed"}
    numbers = [
        Number("torque_saturation", 1, **both, shape=0.2),
        Number("torque_saturation", 1, **both, shape=-1.0, size=0.4),
        Number("torque_speed", 1, **both, shape=-1.0, size=0.1, beside=0.4),
    ]
    now = np.array([0.0, 0.3, 0.0])
    loop = Simulated(friction=0.0).loop(numbers, now)
    error = [e[0] for e in loop.errors(now[None])]
    columns = loop.rows(now, error).columns[0]
    np.testing.assert_allclose(columns[:, :, 0], columns[:, :, 1])


def test_columns_along_the_measured_motion_lead_back_in_one_step():
    """A loop whose kp is stated four times too large: the relation is exact in the gain, so one round is enough."""
    numbers = [
        *(Number("kp_scale", j, sd=2.0, low=-0.99) for j in range(3)),
        *(Number("viscous_friction", j, sd=1.0) for j in range(3)),
    ]
    run = Simulated(seconds=3.0, friction=0.0)
    loop = run.loop(numbers)
    (log,) = loop.runs
    wrong = log._replace(kp=4.0 * log.kp)

    def path(thetas, k, edges):
        # 4 (1 + x) kp of the loop as stated is the simulator's (1 + y) kp.
        own = [[4.0 * (1.0 + x) - 1.0 for x in t[:3]] + list(t[3:]) for t in thetas]
        paths = [run(numbers, x) for x in own]
        return np.array([np.stack([np.interp(edges, run.times, q) for q in p.T], 1) for p in paths])

    loop = ClosedLoop(loop.robot, loop.joints, [wrong], numbers, path, np.full(3, 1e-5))
    start = np.zeros(6)
    error = [e[0] for e in loop.errors(start[None])]
    rows = loop.rows(start, error)
    best = solve(rows.normal(loop.weights(error)), Groups(numbers), range(6)).theta
    np.testing.assert_allclose(best[:3], -0.75, atol=0.02)


# --- evidence


def test_evidence_is_the_marginal_likelihood():
    """Against the Gaussian of the data with the numbers integrated out."""
    rng = np.random.default_rng(1)
    d, sd = rng.normal(size=(40, 3)), np.array([0.5, 1.0, 2.0])
    y = d @ [0.4, 0.0, -1.0] + rng.normal(size=40)
    numbers = [Number(f"n{k}", sd=float(s), odds=-0.3) for k, s in enumerate(sd)]
    normal = Normal(d.T @ d, d.T @ y, float(y @ y))

    def marginal(rows) -> float:
        cov = np.eye(40) + (d[:, rows] * sd[rows] ** 2) @ d[:, rows].T
        return -0.5 * float(y @ np.linalg.solve(cov, y) + np.linalg.slogdet(cov)[1])

    for rows in ([0], [0, 2], [0, 1, 2]):
        got = solve(normal, Groups(numbers), rows).evidence
        assert got == pytest.approx(marginal(rows) - marginal([]) - 0.3 * len(rows), abs=1e-8)


@pytest.mark.parametrize("start", [(), range(8)])
def test_selection_finds_what_is_there_from_either_side(start):
    rng = np.random.default_rng(2)
    d = rng.normal(size=(400, 8))
    d[:, 5] = 0.9 * d[:, 1] + 0.4 * d[:, 5]
    y = d[:, 1] * 0.8 - d[:, 6] * 0.5 + rng.normal(size=400)
    numbers = [Number(f"n{k}", odds=-2.0) for k in range(8)]
    chosen, _ = selected(Normal(d.T @ d, d.T @ y, float(y @ y)), Groups(numbers), start)
    assert chosen == [1, 6]


def test_one_effect_is_exchanged_for_another_that_is_like_it():
    """Two that pass for what is there: neither adding nor deleting leads from the wrong one to the right one."""
    rng = np.random.default_rng(5)
    d = rng.normal(size=(300, 3))
    d[:, 1] = 0.98 * d[:, 0] + 0.2 * d[:, 1]
    y = 0.6 * d[:, 0] + rng.normal(size=300)
    numbers = [Number("right", odds=-3.0), Number("wrong", odds=-3.0), Number("none", odds=-3.0)]
    chosen, _ = selected(Normal(d.T @ d, d.T @ y, float(y @ y)), Groups(numbers), [1])
    assert chosen == [0]


def test_of_one_effect_at_several_sizes_one_is_chosen():
    rng = np.random.default_rng(6)
    d = rng.normal(size=(300, 3))
    y = d @ [0.3, 0.5, 0.0] + 0.1 * rng.normal(size=300)
    numbers = [Number("band", 0, shape=x, odds=-3.0) for x in (0.01, 0.02)] + [Number("other", 0)]
    groups = Groups(numbers)
    chosen, _ = selected(Normal(d.T @ d, d.T @ y, float(y @ y)), groups)
    assert chosen == [1]
    assert groups.together == [0, 2]


def test_numbers_stay_within_their_bounds():
    rng = np.random.default_rng(3)
    d = rng.normal(size=(50, 2))
    y = d @ [-1.0, 0.5]
    numbers = [Number("a", low=0.0), Number("b", high=0.2)]
    best = solve(Normal(d.T @ d, d.T @ y, float(y @ y)), Groups(numbers), [0, 1]).theta
    assert best[0] == 0.0
    assert best[1] == pytest.approx(0.2)


# --- what is found: another plant (bristles, 0.25 ms, a loop that holds) than the fit's


def asked(name: str, odd: bool = False, seconds: float = 6.0):
    """(plant, ordinary numbers, odd candidates, record, record of another motion, its true positions) of a case."""
    machine, log, other = cases.case(name, seconds)
    truth = other.pop("truth")
    log.pop("truth")
    logs = [Log(**{**x, "joint_names": tuple(x["joint_names"])}) for x in (log, other)]
    spec = mujoco.MjSpec.from_string(machine.xml)
    loops = inputs.loops_of(logs[:1], None, logs[1], spec.compile, None, None)
    plant = Plant(mujoco.MjSpec.from_string(machine.xml), machine.joints, loops.fit[0], holds=True)
    record = record_of(logs[0], loops.fit[0])
    typical = inputs.typical_torque(plant, [record])
    own = inputs.ordinary_numbers(plant, [record], typical, loops.fit, logs[:1])
    table = (*own, *inputs.tolerances(plant))
    now = plant.numbers((), np.zeros(0), None)
    pool = candidates(plant, [record], now, typical) if odd else []
    return plant, table, pool, record, record_of(logs[1], loops.test), truth


def found(name: str, odd: bool = False):
    plant, table, pool, record, held, truth = asked(name, odd)
    result = closed_loop.find(plant, table, pool, [record], checks.least([record], plant.loop))
    assert result is not None
    rms = []
    for theta in (np.array([p.nominal for p in result.table]), result.theta):
        path = replay(plant, result.table, theta[None], held)[0]
        rms.append(float(np.sqrt(np.mean((path - truth)[held.settled] ** 2))))
    there = {
        (result.table[e.rows[0]].family, e.number.body or e.number.joint): x
        for e, x, here in zip(
            result.names.entries, result.found.theta, result.found.there, strict=True
        )
        if here and e.number.family not in (*SHARES, *OFF)
    }
    return rms, there


def test_friction_at_one_joint():
    (before, after), there = found("leg/friction")
    assert after < 1e-3 < 10e-3 < before
    assert there["coulomb_friction", 2] == pytest.approx(0.8, rel=0.07)
    assert not {("coulomb_friction", j) for j in range(2)} & there.keys()
    assert abs(there.get(("kp_scale", 2), 0.0)) < 0.08


def test_a_delay_and_a_gain():
    (before, after), there = found("leg/delay")
    assert after < 0.6e-3 < 15e-3 < before
    assert there["target_delay", ALL] == pytest.approx(0.0205, abs=5e-4)
    (before, after), there = found("leg/kp")
    assert after < 0.6e-3 < 6e-3 < before
    assert there["kp_scale", 1] == pytest.approx(-0.25, abs=0.01)


def test_a_sound_robot_is_a_clock():
    (before, after), there = found("rig/sound")
    assert after < 1e-3 < before
    # Half of 2 ms; when targets are taken; and no gain, no friction.
    assert there["loop_hold", ALL] == pytest.approx(1e-3, abs=4e-4)
    assert not {f for f, _ in there} - {"loop_hold", "own_steps", "target_delay", "armature"}


@pytest.mark.slow
def test_a_load_among_all_effects():
    (_, after), there = found("leg/load", odd=True)
    assert after < 0.7e-3
    assert there["payload", "knee_link"] == pytest.approx(0.2, abs=0.02)


@pytest.mark.slow
def test_what_the_response_finds_starts_a_fit_of_replays():
    """A load that the ordinary numbers pass for: no small step of replays leads to it from there."""
    plant, table, pool, record, *_ = asked("leg/load", True)
    floor = checks.least([record], plant.loop)
    start = np.array([p.nominal for p in table])
    ordinary = fit(plant, table, [record], start, floor=floor, rounds=6)
    result = closed_loop.find(plant, table, pool, [record], floor)
    fits = {
        (c.family, c.parameters[0].body): x
        for c, x in closed_loop.fits(plant, ordinary, result, pool, [record], floor)
    }
    loaded = fits["payload", "knee_link"]
    assert loaded.theta[len(table)] == pytest.approx(0.2, abs=0.02)
    assert np.mean(loaded.error**2) < 0.8 * np.mean(ordinary.error**2)
    assert not closed_loop.fits(plant, ordinary, result, [], [record], floor)


# --- many at once


def logs_of(count: int, seconds: float = 4.0) -> tuple[batch.Logs, dict]:
    machine = cases.leg()
    hidden = [
        cases.Hidden(friction=cases.at(machine, "knee", 0.3 * k), kp=1.0 - 0.1 * k)
        for k in range(count)
    ]
    runs = [cases.simulated(machine, x, seconds, seed=k) for k, x in enumerate(hidden)]
    told = [cases.targets(machine, seconds, k) for k in range(count)]
    gains = (np.tile(x, (count, 1)) for x in (machine.kp, machine.kd))
    logs = batch.Logs(np.array([r["qpos"] for r in runs]), np.array(told), *gains)
    robot = ji.load_model(mujoco.MjModel.from_xml_string(machine.xml))
    joints = joints_of(robot, machine.joints)
    numbers = batch.ordinary(robot, joints, machine.kp, machine.kd, logs.q[0])
    stamps = 0.02 * np.arange(len(told[0]))
    common = {"period": 0.002, "stamps": stamps, "joints": joints, "numbers": numbers}
    common["stiffest"] = 80.0
    return logs, {"robot": robot, **common}


@pytest.mark.slow
def test_a_batch_is_its_logs_one_by_one_and_finds_what_is_hidden():
    logs, common = logs_of(2)
    robot = common.pop("robot")
    # One robot each: leaves with a leading axis.
    whole = batch.fitted(jax.tree.map(lambda x: jnp.stack([x, x]), robot), logs, **common)
    for b in range(2):
        one = batch.fitted(robot, batch.Logs(*(x[b : b + 1] for x in logs)), **common)
        np.testing.assert_allclose(one.theta[0], whole.theta[b], rtol=1e-6, atol=1e-9)
    numbers = {(n.family, n.joint): k for k, n in enumerate(common["numbers"])}
    gain = np.array([whole.theta[1, numbers["kp_scale", j]] for j in range(3)])
    np.testing.assert_allclose(gain, -0.1, atol=0.04)
    assert whole.theta[1, numbers["coulomb_friction", 2]] == pytest.approx(0.3, abs=0.06)
    assert np.all(np.asarray(whole.after) < 2e-3)


def test_smoothing_of_a_batch_is_a_low_pass_without_delay():
    step, every, t = 0.002, 2, 0.004 * np.arange(500)
    q = np.sin(2 * np.pi * 1.3 * t)[:, None] + 0.2 * t[:, None]
    got = batch.smoothed(jnp.asarray(q), jnp.asarray(step), every)
    at = 0.002 * (np.arange(998) + 0.5)
    inside = slice(40, -40)
    w = 2 * np.pi * 1.3
    np.testing.assert_allclose(got.q[inside, 0], (np.sin(w * at) + 0.2 * at)[inside], atol=2e-4)
    np.testing.assert_allclose(got.v[inside, 0], (w * np.cos(w * at) + 0.2)[inside], atol=5e-3)
    np.testing.assert_allclose(got.a[inside, 0], -(w**2) * np.sin(w * at)[inside], atol=0.3)


def test_the_direction_of_friction_is_kept_at_rest():
    v = np.array([[0.0], [0.5], [0.5], [0.001], [-0.001], [0.0], [-0.4], [0.0]])
    side = np.asarray(motion.side_of(v, np.array([0.01])))[:, 0]
    np.testing.assert_allclose(side[1:], [1, 1, 1, 1, 1, -1, -1], atol=1e-6)
