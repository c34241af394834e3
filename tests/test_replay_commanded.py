"""Torques that were commanded: made of targets before these are late, or after."""

import dataclasses

import mujoco
import numpy as np
import pytest
from link_log import COUNT, KD, KP, LOOP, MODEL, logged, targets

from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.replay.loop import Parameter, ordinary
from jax_inertia.replay.pipeline import diagnose
from jax_inertia.replay.record import record_of
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses, replay


def run(*, delay=0.0, damping=0.0, before=False, seconds=8.0) -> Log:
    """The link by MuJoCo C at 0.5 ms, its targets late; `before`: torques are made of the targets as they are sent."""
    m = mujoco.MjModel.from_xml_string(MODEL)
    m.opt.timestep = 5e-4
    m.dof_damping[:] += damping
    d, told = mujoco.MjData(m), targets(seconds)
    d.qpos[:] = told[0]
    rows, late = [], round(delay / m.opt.timestep)
    for k in range(int(seconds / m.opt.timestep) - 40):
        sent, there = (told[max(i, 0) // 40] for i in (k, k - late))
        if k % 2 == 0:
            seen = np.round(d.qpos[0] / COUNT) * COUNT
            rest = -KP * seen - KD * d.qvel[0]
            rows.append((k * m.opt.timestep, seen, sent, KP * (sent if before else there) + rest))
            d.qfrc_applied[0] = KP * there + rest
        mujoco.mj_step(m, d)
    return logged(*np.array(rows).T, tau_kind=TorqueKind.COMMANDED)


def named(log: Log) -> set[str]:
    return {e.family for e in diagnose([log], lambda: mujoco.MjSpec.from_string(MODEL)).effects}


def test_a_lead_is_of_motion_and_not_of_the_torque():
    log = run(delay=0.02, before=True, seconds=3.0)
    plant = Plant(mujoco.MjSpec.from_string(MODEL), log.joint_names, LOOP)
    record = record_of(log, LOOP, torque=True)
    table = tuple(Parameter(f, -1, 0.0, 1.0, 0.0, 1.0) for f in ("target_delay", "torque_lead"))
    tries = np.array([[0.02, 0.0], [0.0, 0.02], [0.0, 0.0]])
    late, lead = replay(plant, table, tries[:2], record)
    assert np.array_equal(late, lead)
    assert np.abs(lead - record.q).max() < 5e-3
    torques = misses(plant, table, tries, record)[:, record.settled]
    np.testing.assert_allclose(torques[1], torques[2], atol=1e-9)
    assert np.std(torques[1]) < 0.1 * np.std(torques[0])


@pytest.mark.parametrize(
    ("kinds", "longest"),
    [({}, 0.0), ({"commanded": True}, 0.0), ({"torque_logged": True}, 1e-3),
     ({"torque_logged": True, "commanded": True}, 0.3)],
)  # fmt: skip
def test_only_a_commanded_torque_leads_by_more_than_a_clock(kinds, longest):
    table = ordinary(LOOP, *6 * [np.ones(1)], **kinds)
    assert max((p.high for p in table if p.family == "torque_lead"), default=0.0) == longest


@pytest.mark.slow
@pytest.mark.parametrize("before", [True, False])
def test_a_delay_is_named_wherever_its_torque_was_made(before):
    log = run(delay=0.02, before=before)
    assert named(log) == {"target_delay"}
    measured = dataclasses.replace(log, tau_kind=TorqueKind.CURRENT)
    assert ("target_delay" in named(measured)) == (not before)


@pytest.mark.slow
def test_damping_is_no_delay_of_commanded_torques():
    assert named(run(damping=0.5)) == {"viscous_friction"}
