"""Forms that compete and name no cause, against MuJoCo C's inverse dynamics of a robot that has them."""

import mujoco
import numpy as np
import pytest
from diagnosis_robot import NOMINAL, log_of, motion, needed

from jax_inertia import load_model
from jax_inertia.diagnosis.effects import generic_forms as forms
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.maths.precision import in_double_precision

ELBOW = Place("joint", "elbow", 1)


@pytest.fixture(scope="module")
@in_double_precision
def residual():
    t, q, v, a = motion(1)
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    robot = load_model(model).astype("float64")
    return Residual(robot, log_of(t, q, needed(model, q, v, a), 1), Settings())


@in_double_precision
def seen(residual, effect, place, theta, shape=()):
    """What an effect makes of the residual, on its rows, at some numbers."""
    columns = effect.columns(residual.context, place, shape)
    values, row = residual.rows_of(columns)
    out = np.zeros(residual.y.shape)
    out[:, slice(None) if row is None else row] = values @ np.asarray(theta)
    return out


@in_double_precision
def missing(residual, tau):
    """Torque residual of the nominal model where the robot needs `tau` on the log's grid (T, n)."""
    context = residual.context
    values, _ = residual.rows_of(forms.Columns((context.inverse - tau)[..., None]))
    return values[..., 0]


def moves(residual):
    context = residual.context
    return context.q, context.v, context.a


def close(found, expected, share):
    """Off by at most a share of what is expected, rms over all rows."""
    assert np.sqrt(np.mean((found - expected) ** 2)) < share * np.sqrt(np.mean(expected**2))


def test_a_link_of_another_length_needs_what_mujoco_says(residual):
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    before = needed(model, *moves(residual))
    shift = np.array([0.002, -0.001, 0.003])
    body = model.body("hand")
    body.pos += shift
    # The nominal model of `missing` is this package's; what changes is MuJoCo's.
    tau = residual.context.inverse + needed(model, *moves(residual)) - before
    place = Place("body", "hand", residual.robot.body_index("hand"))
    close(seen(residual, forms.OtherLength(), place, shift), missing(residual, tau), 0.01)


def test_an_encoder_that_errs_with_its_angle_moves_the_model_along_another_path(residual):
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    q, v, a = (x.copy() for x in moves(residual))
    span = np.ptp(q[:, 1])
    at = 2 * (q[:, 1] - q[:, 1].min()) / span - 1
    # P₂ and its derivatives along the motion.
    rate, bend = 2 / span, 1e-3
    before = needed(model, q, v, a)
    q[:, 1] -= bend * (3 * at**2 - 1) / 2
    v[:, 1] *= 1 - bend * 3 * at * rate
    speed = moves(residual)[1][:, 1]
    a[:, 1] -= bend * (3 * at * rate * a[:, 1] + 3 * (rate * speed) ** 2)
    tau = residual.context.inverse + needed(model, q, v, a) - before
    theta = bend * np.eye(forms.WARPS - 1)[0]
    close(seen(residual, forms.WarpedEncoder(), ELBOW, theta), missing(residual, tau), 0.03)


def test_a_clock_that_runs_apart_shifts_a_torque_more_and_more(residual):
    context = residual.context
    end = context.time[-1]
    # Together at the first sample, 4 ms apart at the last.
    ahead = context.time + 0.004 * context.time / end
    tau = np.stack([np.interp(ahead, context.time, x) for x in context.inverse.T], axis=1)
    found = seen(residual, forms.DriftingClock(), Place("global", "global", -1), [0.002, 0.002])
    inner = slice(5, -5)
    close(-found[inner], missing(residual, tau)[inner], 0.1)


def test_what_goes_with_a_joint_s_torque_or_its_depth_is_there_alone(residual):
    context = residual.context
    q, v, tau = context.q[:, 1], context.v[:, 1], context.inverse[:, 1]
    up = (q - q.min()) / np.ptp(q)
    gain = seen(residual, forms.GainOfPosition(), ELBOW, np.linspace(0, 1, forms.KNOTS))
    into = np.maximum(up - 0.8, 0.0) / 0.2
    stop = seen(residual, forms.SoftStop(), ELBOW, [1.0, 0.0, 0.0, 0.5], (0.2, 1.0))
    waves = seen(residual, forms.LoadRipple(), ELBOW, [0.3, 0.4], (12.0,))
    ripple = np.abs(tau) * (0.3 * np.sin(12.0 * q) + 0.4 * np.cos(12.0 * q))
    for found, expected in ((gain, up * tau), (stop, into + 0.5 * into * v), (waves, ripple)):
        values, _ = residual.rows_of(forms.of_row(expected, ELBOW))
        scale = np.abs(values).max()
        np.testing.assert_allclose(np.abs(found[:, 1]), np.abs(values[:, 0]), atol=1e-6 * scale)
        assert not found[:, [0, 2]].any()
