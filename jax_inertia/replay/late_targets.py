"""Targets that arrive late, from the first step on: what a model's file cannot say of them.

MuJoCo keeps the targets that are on their way in a buffer that starts at 0, whatever a keyframe says: for as long as
the delay lasts, a robot is pulled to its zero posture.

start(model, data, targets)        # model: corrected.xml; after each reset
while ...:
    data.ctrl[:] = targets
    mujoco.mj_step(model, data)
"""

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.model.mujoco_types import MjData, MjModel


def start(model: MjModel, data: MjData, targets: Float[np.ndarray, " u"]) -> None:
    """Let every target that is on its way to an actuator (u of them) be its first one, as if it had been held.

    >>> import mujoco, numpy as np
    >>> model = mujoco.MjModel.from_xml_string('''<mujoco><worldbody><body><joint name="hinge"/><geom size="0.1"/>
    ... </body></worldbody><actuator><position joint="hinge" kp="5" delay="0.01" nsample="8"/></actuator></mujoco>''')
    >>> data = mujoco.MjData(model)
    >>> start(model, data, np.array([0.2]))
    >>> mujoco.mj_step(model, data)
    >>> float(data.actuator_force[0])
    1.0
    """
    data.ctrl[:] = targets
    for i in np.flatnonzero(model.actuator_delay > 0):
        past = np.full(model.actuator_history[i, 0], data.ctrl[i])
        mujoco.mj_initCtrlHistory(model, data, int(i), None, past)
