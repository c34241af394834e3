"""What a diagnosis leaves open goes with the corrected model: through its file, and into what is weighed on it."""

import mujoco
import numpy as np
import pytest
from diagnosis_robot import NOMINAL, log_of, motion, needed, ordinary
from hypothesis import given, settings
from hypothesis import strategies as st

import jax_inertia as ji
from jax_inertia.diagnosis.simulate.whole_robot import correction
from jax_inertia.model.load import ModelError, load_model
from jax_inertia.model.model_errors import ModelErrors, NamedErrors, lower_root
from jax_inertia.model.robot_spec import spec_of

BODIES, JOINTS = ("upper", "lower", "hand"), ("shoulder", "elbow", "wrist")


def random_errors(seed: int, columns: int = 9) -> NamedErrors:
    rng = np.random.default_rng(seed)
    bodies = {name: rng.normal(size=(10, columns)) for name in BODIES}
    return NamedErrors(bodies, {name: rng.normal(size=(4, columns)) for name in JOINTS})


def covariance(errors: ModelErrors) -> np.ndarray:
    k = errors.pi.shape[-1]
    root = np.concatenate([np.reshape(errors.pi, (-1, k)), np.reshape(errors.joints, (-1, k))])
    return root @ root.T


def written(errors: NamedErrors) -> ji.Robot:
    """The robot of a file that holds them."""
    spec = mujoco.MjSpec.from_string(NOMINAL)
    errors.add_to(spec)
    return load_model(mujoco.MjModel.from_xml_string(spec.to_xml()))


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 1000))
def test_a_file_holds_the_covariance_of_all_numbers_together(seed):
    errors = random_errors(seed)
    rows = [*errors.bodies.values(), *errors.joints.values()]
    wanted = np.concatenate(rows) @ np.concatenate(rows).T
    read = written(errors).errors
    assert read is not None
    # The texts hold seven digits.
    np.testing.assert_allclose(covariance(read), wanted, atol=1e-5 * np.abs(wanted).max())


def test_errors_that_are_written_again_replace_those_that_were_there():
    spec = mujoco.MjSpec.from_string(NOMINAL)
    random_errors(1).add_to(spec)
    random_errors(2).add_to(spec)
    assert len(spec.texts) == len(BODIES) + len(JOINTS)


def test_errors_of_no_unknown_are_not_written():
    """They would call the model exact, which no diagnosis says of one that it leaves as it is."""
    for columns in (np.zeros((10, 0)), np.zeros((10, 3))):
        spec = mujoco.MjSpec.from_string(NOMINAL)
        NamedErrors({"hand": columns}, {"wrist": columns[:4]}).add_to(spec)
        assert not spec.texts


def test_a_model_that_says_nothing_of_its_errors_has_none():
    assert load_model(mujoco.MjModel.from_xml_string(NOMINAL)).errors is None


def test_some_bodies_errors_are_their_block_of_the_covariance():
    errors = written(random_errors(3)).errors
    assert errors is not None
    some = errors.of([1, 2], [0])
    kept = np.zeros(30 + 12, bool)
    kept[10:30], kept[30:34] = True, True
    wanted = np.where(np.outer(kept, kept), covariance(errors), 0.0)
    np.testing.assert_allclose(covariance(some), wanted, atol=1e-9)


def test_a_root_has_no_more_columns_than_rows():
    root = np.random.default_rng(0).normal(size=(3, 50))
    lower = lower_root(root)
    assert lower.shape == (3, 3)
    np.testing.assert_allclose(lower @ lower.T, root @ root.T)


@pytest.mark.parametrize("data", [" ", "1 2 three", "1 2 3", "nan " * 20, "1e999 " * 10])
def test_a_text_that_holds_no_errors_is_refused_by_name(data):
    spec = mujoco.MjSpec.from_string(NOMINAL)
    spec.add_text(name="errors_of_body/hand", data=data)
    with pytest.raises(ModelError, match="errors_of_body/hand"):
        load_model(spec.compile())


def test_texts_of_several_widths_are_refused():
    spec = mujoco.MjSpec.from_string(NOMINAL)
    spec.add_text(name="errors_of_body/hand", data="1 " * 20)
    spec.add_text(name="errors_of_joint/wrist", data="1 " * 12)
    with pytest.raises(ModelError, match="columns"):
        load_model(spec.compile())


# --- a tool weighed on a corrected model


def drawn_off(rng: np.random.Generator) -> mujoco.MjModel:
    """The robot's drawing: masses and inertias 3 % off, centres 2 mm."""
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    model.body_mass[1:] *= 1.0 + 0.03 * np.array([1.0, -1.0, 1.0])
    model.body_inertia[1:] *= 1.0 + 0.03 * rng.normal(size=(3, 1))
    model.body_ipos[1:] += 0.002 * rng.normal(size=(3, 3))
    return model


def with_tool(mass: float, at: np.ndarray) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(NOMINAL)
    spec.body("hand").add_body(
        name="tool", pos=at, ipos=[0, 0, 0], mass=mass, inertia=3 * [1e-3 * mass], explicitinertial=True
    )  # fmt: skip
    return spec.compile()


def run(model: mujoco.MjModel, seed: int) -> ji.Log:
    t, q, v, a = motion(seed)
    return log_of(t, q, needed(model, q, v, a) + ordinary(v, a), seed)


@pytest.fixture(scope="module")
def weighed():
    """(true mass, load of the report) of tools on a corrected model, and one by usual tolerances instead."""
    rng = np.random.default_rng(0)
    robot = load_model(drawn_off(rng))
    found = ji.diagnose(robot, run(mujoco.MjModel.from_xml_string(NOMINAL), 0))
    corrected = load_model(correction(spec_of(robot), robot, found).spec.compile())
    out = []
    for seed in range(10, 16):
        mass, at = rng.uniform(0.3, 2.0), rng.uniform((-0.04, -0.04, -0.12), (0.04, 0.04, -0.03))
        log = run(with_tool(mass, at), seed)
        out.append((mass, load_of(ji.estimate(corrected, log, ["hand"]))))
    usual = load_of(ji.estimate(corrected, log, ["hand"], tolerance=(0.02, 0.001, 0.05)))
    return out, usual


def load_of(found) -> tuple[float, float]:
    return float(found.loads[1, 0]), found.load_half_widths(0)[1]


@pytest.mark.slow
def test_intervals_of_a_tools_mass_hold_what_the_diagnosis_left_open(weighed):
    z = np.array([(value - mass) / half for mass, (value, half) in weighed[0]])
    # Of six at 95 % five or six hold, and none is two intervals off.
    assert np.sum(np.abs(z) < 1.0) >= 5, z
    assert np.max(np.abs(z)) < 2.0, z


@pytest.mark.slow
def test_a_load_is_known_better_than_by_the_links_own_tolerance(weighed):
    halves, (_, usual) = [half for _, (_, half) in weighed[0]], weighed[1]
    assert np.median(halves) < 0.5 * usual
