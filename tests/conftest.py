"""Float64, shape annotations checked at run time, and one compiled set of functions per test robot."""

import functools
import gc
import os
from dataclasses import dataclass
from importlib.metadata import version

# Workers share the cores, and threads of their own beside them cost a quarter of the time. NumPy is loaded by now, so
# this is for the workers, which inherit it; jax is not.
os.environ.update({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"})
# Compiling is what these tests spend their time on: as little of it as XLA can be asked for. Without optimising, a
# compilation takes a fifth of its time and a third of its memory, and what it makes runs at a third of its speed.
FLAGS = ["--xla_backend_optimization_level=0", "--xla_cpu_parallel_codegen_split_count=1"]
# A flag that XLA does not know aborts the process, and jax 0.12's has no choice of emitters.
if version("jaxlib").startswith("0.9."):
    FLAGS.append("--xla_cpu_use_fusion_emitters=false")
if "PYTEST_XDIST_WORKER" in os.environ:
    FLAGS.append("--xla_cpu_multi_thread_eigen=false")
os.environ["XLA_FLAGS"] = " ".join([*FLAGS, os.environ.get("XLA_FLAGS", "")])
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # as the command line has it

import annotations  # noqa: E402
import jax  # noqa: E402
from jaxtyping import config  # noqa: E402

jax.config.update("jax_enable_x64", True)
annotations.install()

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from models import MODELS  # noqa: E402

import jax_inertia as ji  # noqa: E402
from jax_inertia.robots import humanoid_mjcf  # noqa: E402

# Tracing makes millions of objects that live on, and each collection calls jax's own too: a fifth of the time.
gc.set_threshold(200_000, 20, 20)

ROBOTS = (*MODELS, "humanoid")
# Compiling is what these tests spend their time on.
FAST = {"xla_backend_optimization_level": 0}


@pytest.fixture(autouse=True)
def checked_anew():
    """Every test has its functions' first calls checked."""
    annotations.calls.clear()


@pytest.fixture
def unchecked():
    """Annotations not looked at, as users have it: shapes are then for the package itself to refuse."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)


@dataclass(frozen=True, eq=False)
class Case:
    """A test robot as MuJoCo and as the package see it, with everything compiled once."""

    name: str
    model: mujoco.MjModel
    robot: ji.Robot

    @property
    def chosen(self) -> list[str]:
        """A few bodies out of order: the last, the first, and one in between."""
        names = self.robot.body_names
        return list(dict.fromkeys([names[-1], names[0], names[len(names) // 2]]))

    def states(self, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Random q (quaternions of unit length), v and a, far from home and fast."""
        rng = np.random.default_rng([seed, self.model.nv])
        q = 1.5 * rng.normal(size=(count, self.model.nq))
        for row in q:
            mujoco.mj_normalizeQuat(self.model, row)
        v, a = rng.normal(size=(2, count, self.model.nv))
        return q, 2.0 * v, 5.0 * a

    @functools.cached_property
    def core(self):
        """Torque, regressor, mass matrix and poses for a batch of states."""

        def one(robot, q, v, a):
            rotation, position = ji.body_poses(robot, q)
            return {
                "torque": ji.inverse_dynamics(robot, q, v, a),
                "regressor": ji.torque_regressor(robot, q, v, a),
                "mass_matrix": ji.mass_matrix(robot, q),
                "rotation": rotation,
                "position": position,
            }

        return jax.jit(jax.vmap(one, in_axes=(None, 0, 0, 0)), compiler_options=FAST)

    @functools.cached_property
    def chosen_bodies(self):
        """What `dynamics` computes for chosen bodies, with wrenches on them, for a batch of states."""
        chosen = self.chosen

        def one(robot, q, v, a, wrenches):
            condensed, nominal = ji.condensed_dynamics(robot, q, v, a, chosen)
            return {
                "regressor": ji.torque_regressor(robot, q, v, a, chosen),
                "condensed": condensed,
                "nominal": nominal,
                "jacobian": ji.body_jacobian(robot, q, chosen[0]),
                "contact": ji.contact_torque(robot, q, wrenches, chosen),
            }

        return jax.jit(jax.vmap(one, in_axes=(None, 0, 0, 0, 0)), compiler_options=FAST)


@functools.cache
def case_of(name: str) -> Case:
    text = humanoid_mjcf() if name == "humanoid" else MODELS[name]
    model = mujoco.MjModel.from_xml_string(text)
    return Case(name, model, ji.load_model(model))


@pytest.fixture(params=ROBOTS, scope="session")
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(request.param)


@pytest.fixture(scope="session")
def cases():
    """Test robots by name."""
    return case_of
