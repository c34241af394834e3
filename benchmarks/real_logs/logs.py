"""Where the recorded logs are, and how they become observations; one setting for each robot, stated here."""

import dataclasses
import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

import jax_inertia as ji
from jax_inertia.logs.log_files import read_log
from jax_inertia.model.load import ModelWarning
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation, central_differences
from jax_inertia.signals.filtering import low_pass, resample
from jax_inertia.signals.generalised_motion import generalised

SHARED = Path(
    os.environ.get("JAX_INERTIA_DATA", Path(__file__).parents[2].parent / "shared" / "data")
)


@dataclass(frozen=True)
class Setting:
    """Preparation of a log: grid, low-pass, and the speed below which a joint's rows are left out."""

    folder: str
    rate: float  # Hz
    cutoff: float  # Hz, zero phase
    slowest: float  # rad/s: below it dry friction is not at its kinetic level

    @property
    def path(self) -> Path:
        """The folder of the data."""
        return SHARED / self.folder

    def model(self, name: str) -> Robot:
        """A model file of this data set; what MuJoCo balances is said in RESULTS.md, not here."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            return ji.load_model(self.path / name)

    def observation(self, robot: Robot, name: str) -> Observation:
        """One log, ready for a fit: 0.2 s at both ends, where the filter has half its data, are cut."""
        log = low_pass(resample(read_log(self.path / f"{name}.npz"), self.rate), self.cutoff)
        out = central_differences(generalised(log, robot))
        edge = int(0.2 * self.rate)
        out = jax.tree.map(lambda x: x[edge:-edge], out)
        return moving(out, self.slowest)


def moving(observation: Observation, slowest: float) -> Observation:
    """The same with the rows of joints slower than `slowest` [rad/s] masked."""
    motion = observation.motion
    valid = np.asarray(motion.valid) & (np.abs(np.asarray(motion.v)) >= slowest)
    return dataclasses.replace(observation, motion=dataclasses.replace(motion, valid=valid))


UR10E = Setting("ur10e_dynamic_calibration", rate=100.0, cutoff=5.0, slowest=0.1)
PANDA = Setting("panda_gaz2019", rate=200.0, cutoff=10.0, slowest=0.02)
LWR = Setting("kuka_lwr4_flobaroid", rate=200.0, cutoff=10.0, slowest=0.02)
