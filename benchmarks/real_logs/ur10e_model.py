"""The UR10e's inertias as its maker publishes them, in the frames of the data set's URDF.

Masses and centres of mass: Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR10e
(universal-robots.com/articles/ur/application-installation/dh-parameters-for-calculations-of-kinematics-and-dynamics).
The page gives no rotational inertias; those of the URDF about the centre of mass are kept, in proportion to mass.

The URDF's own figures are of another kind: it treats links as cylinders (upper arm's centre of mass at mid-length,
7 cm beyond the maker's, and a wrist 3 of 0.2 kg instead of 0.6 kg).
"""

import jax.numpy as jnp
import numpy as np

import jax_inertia as ji
from jax_inertia.maths import inertial_parameters
from jax_inertia.model.robot import Robot

LINKS = (
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
)
# a [m], d [m], α [rad] of each link, its mass [kg], its centre of mass [m] in its Denavit–Hartenberg frame.
_MAKER = (
    (0.0, 0.1807, np.pi / 2, 7.369, (0.021, 0.0, 0.027)),
    (-0.6127, 0.0, 0.0, 13.051, (0.38, 0.0, 0.158)),
    (-0.57155, 0.0, 0.0, 3.989, (0.24, 0.0, 0.068)),
    (0.0, 0.17415, np.pi / 2, 2.1, (0.0, 0.007, 0.018)),
    (0.0, 0.11985, -np.pi / 2, 1.98, (0.0, 0.007, 0.018)),
    (0.0, 0.11655, 0.0, 0.615, (0.0, 0.0, -0.026)),
)


def makers_model(urdf: Robot) -> Robot:
    """The URDF's robot with the maker's masses and centres of mass."""
    rotations, positions = (np.asarray(x) for x in ji.body_poses(urdf, jnp.zeros(urdf.nq)))
    # The maker's base frame is the URDF's turned by π about z (its link `base`); joints agree at zero.
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    chosen, bodies = [], []
    for name, (a, d, alpha, mass, com) in zip(LINKS, _MAKER, strict=True):
        pose = pose @ _link(a, d, alpha)
        i = urdf.body_index(name)
        com_here = rotations[i].T @ ((pose @ [*com, 1.0])[:3] - positions[i])
        old = urdf.pi[i]
        about = inertial_parameters.rotational_inertia(
            old
            - inertial_parameters.from_com(
                old[0], inertial_parameters.centre_of_mass(old), jnp.zeros((3, 3))
            )
        )
        chosen.append(i)
        bodies.append(
            inertial_parameters.from_com(
                jnp.asarray(mass), jnp.asarray(com_here), about * mass / old[0]
            )
        )
    return urdf.with_pi(tuple(chosen), jnp.stack(bodies))


def _link(a: float, d: float, alpha: float) -> np.ndarray:
    """Denavit–Hartenberg transformation at joint angle zero."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -s, 0], [0, s, c, d], [0, 0, 0, 1.0]])
