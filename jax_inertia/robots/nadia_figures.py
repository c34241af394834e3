"""Published figures of the humanoid Nadia, and the few that we replace.

Source: the public robot description of Nadia V17 (IHMC; cycloidal arms of 4 joints, simple knees),
24 links, 23 joints, 90.898 kg. `LINKS` and `JOINTS` carry it as published, errors included;
`links()` and `effort_limit()` give what the model uses, and `DEVIATIONS` lists every difference:

| item | published | used | reason |
|---|---|---|---|
| `right_shoulder_roll_link` | Ixx, Ixy, Izz < 0; com x flipped | left, mirrored | not physical |
| effort, legs and spine | 1000 N m | 150 to 350 N m | placeholder; limits of the class, below |

Every other link is physical (its pseudo-inertia is positive definite) and is kept, although the
right side is not always the mirror image of the left:

- `right_shin_link` differs by up to 0.6 mm in its centre of mass and 6 % in Iyz;
- `right_foot_link` has its centre of mass 15 mm higher, and the inertia copied, not mirrored;
- `right_shoulder_pitch_link` has its centre of mass mirrored, but not Ixy and Iyz;
- `right_shoulder_yaw_link` and `right_elbow_pitch_link` are plain copies of the left;
- the right arm's effort limits are lower.

In the source every inertia's frame is parallel to its link's (rpy 0). The effort limits of legs and
spine are those of NASA's Valkyrie, a humanoid of the same class, from its public description: hip
yaw 190, hip roll, hip pitch and knee 350, ankle 205, torso yaw 190, torso roll and pitch 150 N m.
(A public variant of Nadia V17 gives its knee 350 N m too.)
"""

from typing import NamedTuple

Vector = tuple[float, float, float]


class Link(NamedTuple):
    """Mass (kg), centre of mass (m), inertia about it (kg m²; xx xy xz yy yz zz), link axes."""

    mass: float
    com: Vector
    inertia: tuple[float, float, float, float, float, float]


class Joint(NamedTuple):
    """Hinge from `parent` to `child`.

    Pose of the child's frame in the parent's (m; rpy about fixed axes, rad), axis in the child's
    frame, range (rad), effort limit (N m).
    """

    parent: str
    child: str
    pos: Vector
    axis: Vector
    range: tuple[float, float]
    effort: float
    rpy: Vector = (0.0, 0.0, 0.0)


class Deviation(NamedTuple):
    """A difference between source and model: where, what was published, what is used, and why."""

    item: str
    published: str
    used: str
    reason: str


ROOT = "pelvis_link"
DAMPING = 0.05  # N m s/rad, published for every joint
SOLE_X = (-0.072, 0.178)  # m, heel and toe edge in the foot's frame
SOLE_HALF_WIDTH = 0.06  # m
# m below the foot's frame. The figures give no depth; published contact points of this robot do.
SOLE_DEPTH = 0.083

_X: Vector = (1.0, 0.0, 0.0)
_Y: Vector = (0.0, 1.0, 0.0)
_Z: Vector = (0.0, 0.0, 1.0)
_DOWN: Vector = (0.0, 0.0, -1.0)

# fmt: off
LINKS: dict[str, Link] = {
    "pelvis_link": Link(19.0917, (0.02073086, 2.023e-05, -0.0309812),
        (0.0942, 6.05e-06, 0.000379, 0.0416, 3.37e-07, 0.112)),
    "left_hip_yaw_link": Link(1.814, (-0.00629727, 0.00606893, -0.03971844),
        (0.004741914, 0.000527, -0.000307, 0.00414, 1.36e-05, 0.00569)),
    "left_hip_roll_link": Link(0.762, (-0.01327037, 0.00316985, -0.05399997),
        (0.001028994, -9.31e-06, 0.000352, 0.00138, 3.22e-05, 0.000663)),
    "left_thigh_link": Link(10.953, (-0.00093749, 0.01134511, -0.17863144),
        (0.1622268263, -0.000749, 0.0156, 0.174, 0.00213, 0.0528)),
    "left_shin_link": Link(5.42, (-0.01841492, 0.00228086, -0.22054239),
        (0.064437783, -0.000214, -0.00538, 0.0583, -0.000962, 0.0136)),
    "left_ankle_link": Link(0.56, (-0.00072338, -6.619e-05, -0.00399965),
        (0.000459, 2.65e-08, -2.43e-06, 0.000336, 1.48e-07, 0.000645)),
    "left_foot_link": Link(1.75, (0.03075449, 7.807e-05, -0.04382467),
        (0.00345011, -7.3e-06, 0.0014225, 0.00955764, -2.269e-07, 0.00881313)),
    "right_hip_yaw_link": Link(1.814, (-0.00629727, -0.00606893, -0.03971844),
        (0.004741914, -0.000527, -0.000307, 0.00414, -1.36e-05, 0.00569)),
    "right_hip_roll_link": Link(0.762, (-0.01327037, -0.00316985, -0.05399997),
        (0.001028994, 9.31e-06, 0.000352, 0.00138, -3.22e-05, 0.000663)),
    "right_thigh_link": Link(10.953, (-0.00093749, -0.01134511, -0.17863144),
        (0.1622268263, 0.000749, 0.0156, 0.174, -0.00213, 0.0528)),
    "right_shin_link": Link(5.42, (-0.01837047, -0.00241134, -0.21991278),
        (0.064443143, 0.000202, -0.00539, 0.0583, 0.000906, 0.0136)),
    "right_ankle_link": Link(0.56, (-0.00072338, 6.619e-05, -0.00399965),
        (0.000459, -2.65e-08, -2.43e-06, 0.000336, -1.48e-07, 0.000645)),
    "right_foot_link": Link(1.75, (0.032048, 4e-06, -0.028422),
        (0.00345011, -7.3e-06, 0.0014225, 0.00955764, -2.269e-07, 0.00881313)),
    "spine_yaw_link": Link(0.91, (-0.00853118, -2.697e-05, 0.03791445),
        (0.00374289408, 1.25497934e-07, 0.000271325072, 0.00403002777, -1.38015692e-07,
         0.0062129847)),
    "spine_roll_link": Link(0.44, (-0.01904983, 7e-08, 0.01979244),
        (0.000373262301, -1.51441878e-10, -6.69067307e-05, 0.000649978475, -1.27858402e-10,
         0.000419408851)),
    "torso_link": Link(13.5, (-0.03613868, -2.81e-06, 0.25908586),
        (0.534504681, 8.41519717e-05, -0.00672956305, 0.505409852, 0.000207996773, 0.379402013)),
    "left_shoulder_pitch_link": Link(2.917, (-0.00117, 0.1400097, -0.00621),
        (0.0108367, 0.0001356, -2.666e-05, 0.00498324, 0.00090758, 0.01142661)),
    "left_shoulder_roll_link": Link(1.17068, (0.01053, 0.02124, -0.105269),
        (0.00787035, 0.0001667, -0.00075945, 0.00727481, 0.000988837, 0.00182144)),
    "left_shoulder_yaw_link": Link(2.53059, (0.00479, 0.00062, -0.3624141),
        (0.02277422, 5.053e-05, 0.0012266, 0.0225956, -0.0002571, 0.00260312)),
    "left_elbow_pitch_link": Link(0.6007, (-0.01090935, -0.01147189, -0.10388715),
        (0.00760733, 2.242e-05, -0.0002583, 0.00767556, 0.00061995, 0.0004554)),
    "right_shoulder_pitch_link": Link(2.917, (-0.00117, -0.1400097, -0.00621),
        (0.0108367, 0.0001356, -2.666e-05, 0.00498324, 0.00090758, 0.01142661)),
    # Not physical: see `DEVIATIONS`.
    "right_shoulder_roll_link": Link(1.17068, (-0.01053, -0.02124, -0.105269),
        (-0.00787035, -0.0001667, -0.00075945, 0.00727481, -0.000988837, -0.00182144)),
    "right_shoulder_yaw_link": Link(2.53059, (0.00479, 0.00062, -0.3624141),
        (0.02277422, 5.053e-05, 0.0012266, 0.0225956, -0.0002571, 0.00260312)),
    "right_elbow_pitch_link": Link(0.6007, (-0.01090935, -0.01147189, -0.10388715),
        (0.00760733, 2.242e-05, -0.0002583, 0.00767556, 0.00061995, 0.0004554)),
}

JOINTS: dict[str, Joint] = {
    "left_hip_z": Joint("pelvis_link", "left_hip_yaw_link",
        (0.0, 0.115, -0.07185), _DOWN, (-0.7854, 0.7854), 1000.0),
    "left_hip_x": Joint("left_hip_yaw_link", "left_hip_roll_link",
        (0.035, 0.015, -0.04975), _X, (-0.5236, 1.0472), 1000.0),
    "left_hip_y": Joint("left_hip_roll_link", "left_thigh_link",
        (0.0, 0.0, -0.079068), _Y, (-1.57, 0.314), 1000.0),
    "left_knee_y": Joint("left_thigh_link", "left_shin_link",
        (0.0, 0.0, -0.38), _Y, (0.0, 2.62), 1000.0),
    "left_ankle_y": Joint("left_shin_link", "left_ankle_link",
        (-0.00830222, 0.0, -0.40213938), _Y, (-1.0472, 0.698132), 1000.0),
    "left_ankle_x": Joint("left_ankle_link", "left_foot_link",
        (0.0, 0.0, -0.01), _X, (-0.436332, 0.436332), 1000.0),
    "right_hip_z": Joint("pelvis_link", "right_hip_yaw_link",
        (0.0, -0.115, -0.07185), _DOWN, (-0.7854, 0.7854), 1000.0),
    "right_hip_x": Joint("right_hip_yaw_link", "right_hip_roll_link",
        (0.035, -0.015, -0.04975), _X, (-1.0472, 0.5236), 1000.0),
    "right_hip_y": Joint("right_hip_roll_link", "right_thigh_link",
        (0.0, 0.0, -0.079068), _Y, (-1.57, 0.314), 1000.0),
    "right_knee_y": Joint("right_thigh_link", "right_shin_link",
        (0.0, 0.0, -0.38), _Y, (0.0, 2.62), 1000.0),
    "right_ankle_y": Joint("right_shin_link", "right_ankle_link",
        (-0.00830222, 0.0, -0.40213938), _Y, (-1.0472, 0.698132), 1000.0),
    "right_ankle_x": Joint("right_ankle_link", "right_foot_link",
        (0.0, 0.0, -0.01), _X, (-0.436332, 0.436332), 1000.0),
    "spine_z": Joint("pelvis_link", "spine_yaw_link",
        (0.08, 0.0, 0.00635), _Z, (-1.0472, 1.0472), 1000.0),
    "spine_x": Joint("spine_yaw_link", "spine_roll_link",
        (0.0, 0.0, 0.08205), _X, (-0.523599, 0.523599), 1000.0),
    "spine_y": Joint("spine_roll_link", "torso_link",
        (0.0, 0.0, 0.01), _Y, (-1.0472, 1.0472), 1000.0),
    "left_shoulder_y": Joint("torso_link", "left_shoulder_pitch_link",
        (0.001, 0.185, 0.173), _Y, (-3.141592, 1.22173), 51.87,
        rpy=(0.785398163, 0.0, -0.785398163)),
    "left_shoulder_x": Joint("left_shoulder_pitch_link", "left_shoulder_roll_link",
        (0.0, 0.15676, -0.013), _X, (-0.261799, 2.87979), 57.45, rpy=(-0.785398163, 0.0, 0.0)),
    "left_shoulder_z": Joint("left_shoulder_roll_link", "left_shoulder_yaw_link",
        (0.0, 0.035, 0.0), _Z, (-1.91986, 1.22173), 24.47),
    "left_elbow_y": Joint("left_shoulder_yaw_link", "left_elbow_pitch_link",
        (0.015, 0.0, -0.4), _Y, (-2.35619, 0.174532925), 24.47),
    "right_shoulder_y": Joint("torso_link", "right_shoulder_pitch_link",
        (0.001, -0.185, 0.173), _Y, (-3.141592, 1.22173), 41.5,
        rpy=(-0.785398163, 0.0, 0.785398163)),
    "right_shoulder_x": Joint("right_shoulder_pitch_link", "right_shoulder_roll_link",
        (0.0, -0.15676, -0.013), _X, (-2.87979, 0.261799), 41.5, rpy=(0.785398163, 0.0, 0.0)),
    "right_shoulder_z": Joint("right_shoulder_roll_link", "right_shoulder_yaw_link",
        (0.0, -0.035, 0.0), _Z, (-1.22173, 1.91986), 22.59),
    "right_elbow_y": Joint("right_shoulder_yaw_link", "right_elbow_pitch_link",
        (0.015, 0.0, -0.4), _Y, (-2.35619, 0.174532925), 22.59),
}
# fmt: on

_CLASS_EFFORT = {  # N m; replaces the placeholder, keyed by the joint's name without its side
    "hip_z": 190.0,
    "hip_x": 350.0,
    "hip_y": 350.0,
    "knee_y": 350.0,
    "ankle_y": 205.0,
    "ankle_x": 205.0,
    "spine_z": 190.0,
    "spine_x": 150.0,
    "spine_y": 150.0,
}

DEVIATIONS: tuple[Deviation, ...] = (
    Deviation(
        "right_shoulder_roll_link",
        "Ixx, Ixy and Izz negative, com x negated",
        "mirror image of left_shoulder_roll_link",
        "not physical: a slip in mirroring",
    ),
    *(
        Deviation(name, "effort 1000 N m", f"{effort:g} N m", "placeholder; limit of the class")
        for name, joint in JOINTS.items()
        if (effort := _CLASS_EFFORT.get(name.removeprefix("left_").removeprefix("right_")))
        and joint.effort == 1000.0
    ),
)


def mirrored(link: Link) -> Link:
    """Mirror image of a link in its x-z plane: com y, Ixy and Iyz change sign."""
    x, y, z = link.com
    ixx, ixy, ixz, iyy, iyz, izz = link.inertia
    return Link(link.mass, (x, -y, z), (ixx, -ixy, ixz, iyy, -iyz, izz))


def links() -> dict[str, Link]:
    """Links as the model uses them: as published, the unphysical one mirrored from the left."""
    return LINKS | {"right_shoulder_roll_link": mirrored(LINKS["left_shoulder_roll_link"])}


def effort_limit(joint: str) -> float:
    """Effort limit that the model uses, in N m: arms as published, legs and spine of the class."""
    kind = joint.removeprefix("left_").removeprefix("right_")
    return _CLASS_EFFORT.get(kind, JOINTS[joint].effort)
