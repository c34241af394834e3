"""What is handed to trainers: draws replay as the fit does, in MuJoCo by the exported file, and files are right.

The robot is MuJoCo C's at another step and loop than the fit's (`test_replay.run`).
"""

import copy
import json
import sys
import types

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from scipy.spatial.transform import Rotation
from test_replay import ARM, NAMES, run, without_torque

from jax_inertia.cli.main import main
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.replay import handover
from jax_inertia.replay.entry import diagnose
from jax_inertia.replay.fitting.draws import drawn
from jax_inertia.replay.fitting.file_form import file_form
from jax_inertia.replay.loop import position_loop
from jax_inertia.replay.record import record_of
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay
from jax_inertia.trainers import exports

# Fields of DelayedPDActuatorCfg, and parameters of three events, in Isaac Lab 2.3.2.
ACTUATOR = {
    "class_type", "joint_names_expr", "effort_limit", "velocity_limit", "effort_limit_sim", "velocity_limit_sim",
    "stiffness", "damping", "armature", "friction", "dynamic_friction", "viscous_friction", "min_delay", "max_delay",
}  # fmt: skip
_ANY = {"asset_cfg", "operation", "distribution"}
EVENTS = {
    "randomize_actuator_gains": _ANY | {"stiffness_distribution_params", "damping_distribution_params"},
    "randomize_joint_parameters": _ANY | {"friction_distribution_params", "armature_distribution_params"},
    "randomize_rigid_body_mass": _ANY | {"mass_distribution_params", "recompute_inertia", "min_mass"},
}  # fmt: skip


def diagnosed(log, out, *more) -> None:
    """The command, which ends well."""
    model = log.with_name("arm.xml")
    assert main(["diagnose", str(log), "--model", str(model), "--out", str(out), *more]) == 0


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """A folder with an arm whose elbow is softer than its model, and the command's files."""
    folder = tmp_path_factory.mktemp("soft")
    (folder / "arm.xml").write_text(ARM)
    for k in (0, 1):
        log = without_torque(run(kp=(1.0, 0.7), dry=(0.05, 0.0), delay=0.02, seed=k, seconds=6.0))
        write_log(log, folder / f"{k}.npz")
    more = "--test-log", str(folder / "1.npz"), "--export", "isaaclab", "playground"
    diagnosed(folder / "0.npz", folder / "out", *more)
    return folder


def executed(path):
    namespace = {"__file__": str(path), "__name__": path.stem}
    exec(compile(path.read_text(), path.name, "exec"), namespace)
    return namespace


@pytest.mark.slow
def test_draws_replay_in_mujoco_as_the_corrected_model_does(soft):
    made = executed(soft / "out" / "playground.py")
    model = mujoco.MjModel.from_xml_path(str(soft / "out" / "corrected.xml"))
    fields, delay = made["fields"](model), made["DRAWS"]["delay"]
    log = read_log(soft / "1.npz")
    loop = position_loop(log, mujoco.MjModel.from_xml_string(ARM))
    record = record_of(log, loop)

    def error(m) -> float:
        off = handover.replayed(m, NAMES, loop, record) - record.q
        return float(np.sqrt(np.mean(off[record.settled] ** 2)))

    own, errors = error(model), []
    for d in range(0, 64, 8):
        one = copy.copy(model)
        for name, x in fields.items():
            getattr(one, name)[:] = x[d]
        one.actuator_delay[:] = delay[d]
        errors.append(error(one))
    told = json.loads((soft / "out" / "policy.json").read_text())["draws"]
    assert own == pytest.approx(told["replay"]["corrected"], rel=0.05)
    assert np.median(errors) < 1.5 * own
    assert np.median(errors) == pytest.approx(told["replay"]["median"], rel=0.3)
    assert min(x.min() for x in made["DRAWS"].values() if x.dtype == float and x.ndim == 2) >= -1e-9


@pytest.mark.slow
def test_numbers_drawn_one_by_one_replay_worse(soft):
    """The same values, but each number's from another draw: what numbers have in common is lost."""
    log, loop_of = read_log(soft / "0.npz"), mujoco.MjModel.from_xml_string(ARM)
    fit = diagnose(soft / "arm.xml", log).found
    plant = Plant(mujoco.MjSpec.from_string(ARM), NAMES, position_loop(log, loop_of), holds=True)
    record = record_of(log, plant.loop)
    together = drawn(plant, fit, file_form(plant, fit, [], np.zeros(0)), 32).vectors
    rng = np.random.default_rng(0)
    apart = np.stack([rng.permutation(x) for x in together.T], axis=1)
    away = [
        replay(plant, fit.table, x, record) - record.q for x in (fit.theta[None], together, apart)
    ]
    own, joint, single = (np.mean(x[:, record.settled] ** 2, axis=(1, 2)) for x in away)
    assert np.median(single - own) > 4.0 * abs(np.median(joint - own))


def inertias(principal, quaternions):
    """Along bodies' own axes [kg m²]."""
    turns = [Rotation.from_quat(q, scalar_first=True).as_matrix() for q in quaternions]
    return np.array([r @ np.diag(x) @ r.T for r, x in zip(turns, principal, strict=True)])


@pytest.mark.slow
def test_a_draw_at_the_fit_is_the_file(soft):
    log, spec = read_log(soft / "0.npz"), mujoco.MjSpec.from_string(ARM)
    found = diagnose(soft / "arm.xml", log)
    sharp = found.found._replace(covariance=found.found.covariance * 1e-14)
    plant = Plant(spec, NAMES, position_loop(log, mujoco.MjModel.from_xml_string(ARM)), holds=True)
    draws = drawn(plant, sharp, file_form(plant, sharp, [], np.zeros(0)), 1)
    folder = soft / "sharp"
    folder.mkdir()
    (folder / "draws.npz").write_bytes(exports.draws_file(NAMES, draws))
    (folder / "playground.py").write_text(
        exports.export("playground", found, draws, "log.npz", "arm.xml")
    )
    model = mujoco.MjModel.from_xml_string(found.text)
    fields = executed(folder / "playground.py")["fields"](model)
    # Principal axes may come in another order: inertias are compared along the body's axes.
    whole = inertias(fields.pop("body_inertia")[0], fields.pop("body_iquat")[0])
    np.testing.assert_allclose(
        whole, inertias(model.body_inertia, model.body_iquat), rtol=1e-4, atol=1e-7
    )
    for name, x in fields.items():
        np.testing.assert_allclose(x[0], getattr(model, name), rtol=1e-4, atol=1e-7, err_msg=name)


def test_the_randomiser_gives_mjx_one_draw_for_each_key(soft):
    made = executed(soft / "out" / "playground.py")
    model = mujoco.MjModel.from_xml_path(str(soft / "out" / "corrected.xml"))
    keys = jax.random.split(jax.random.key(0), 5)
    many, axes = made["domain_randomizer"](model)(mjx.put_model(model), keys)
    friction = jax.vmap(lambda m: m.dof_frictionloss, in_axes=(axes,))(many)
    assert friction.shape == (5, model.nv)
    of_draws = made["DRAWS"]["frictionloss"]
    assert all(np.isclose(x, of_draws, rtol=1e-5).all(axis=1).any() for x in friction)
    late = np.asarray(made["command_delays"](jax.random.split(jax.random.key(1), 4000), 0.005))
    assert late.shape == (4000, 2)
    np.testing.assert_allclose(0.005 * late.mean(axis=0), 0.02, atol=1.5e-3)


def test_isaac_lab_is_given_what_its_classes_have(soft, monkeypatch):
    def made(name, allowed):
        def of(*args, **values):
            assert set(values) <= set(allowed), set(values) - set(allowed)
            return types.SimpleNamespace(args=args, **values)

        of.__name__ = name
        return of

    mdp = types.ModuleType("isaaclab.envs.mdp")
    for name in EVENTS:
        setattr(mdp, name, name)
    modules = {
        "isaaclab": {},
        "isaaclab.actuators": {"DelayedPDActuatorCfg": made("DelayedPDActuatorCfg", ACTUATOR)},
        "isaaclab.envs": {"mdp": mdp},
        "isaaclab.managers": {
            "EventTermCfg": made("EventTermCfg", ("func", "mode", "params")),
            "SceneEntityCfg": made("SceneEntityCfg", ("joint_names", "body_names")),
        },
        "isaaclab.utils": {"configclass": lambda cls: cls},
    }
    for name, values in modules.items():
        module = types.ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
    file = executed(soft / "out" / "isaaclab.py")
    actuator = file["ACTUATORS"]["diagnosed"]
    assert actuator.stiffness["^elbow$"] == pytest.approx(0.7 * 25.0, rel=0.02)
    assert actuator.friction["^shoulder$"] == pytest.approx(0.15, rel=0.1)
    assert actuator.min_delay <= 0.02 / file["PHYSICS_DT"] <= actuator.max_delay + 1
    terms = [x for x in vars(file["Events"]).values() if isinstance(x, types.SimpleNamespace)]
    assert {t.func for t in terms} == set(EVENTS)
    for term in terms:
        assert set(term.params) <= set(EVENTS[term.func])
        for low, high in (x for n, x in term.params.items() if n.endswith("_params")):
            assert 0.0 <= low <= high


def test_nothing_is_exported_of_a_sound_robot(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM)
    write_log(without_torque(run(seconds=5.0)), tmp_path / "log.npz")
    diagnosed(tmp_path / "log.npz", tmp_path / "out", "--export", "isaaclab")
    assert "nothing to export" in capsys.readouterr().err
    assert not (tmp_path / "out" / "isaaclab.py").exists()
