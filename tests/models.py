"""Small robots that are hard on purpose: every way MJCF has of joining bodies, in few links.

`MODELS` maps a name to MJCF text. No body has a geom, so nothing collides, and every inertial is
written out: off-centre, fully populated or in a rotated frame. Comments say what each one is for.
"""

_HEAD = """
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="Euler"{gravity}>
    <flag contact="disable" eulerdamp="disable"/>
  </option>
"""


def _model(name: str, world: str, gravity: str = "") -> str:
    head = _HEAD.format(gravity=f' gravity="{gravity}"' if gravity else "")
    return f'<mujoco model="{name}">{head}  <worldbody>{world}  </worldbody>\n</mujoco>\n'


# The simplest arm, in a vertical plane; the inertia frames are turned within that plane, and the
# second joint's zero is not the pose the bodies are drawn in (`ref`).
_PLANAR_2R = """
    <body name="upper" pos="0 0 1">
      <inertial pos="0.02 0 -0.2" mass="1.7" diaginertia="0.021 0.024 0.004" euler="0 0.2 0"/>
      <joint name="shoulder" axis="0 1 0"/>
      <body name="lower" pos="0 0 -0.45">
        <inertial pos="0.01 0 -0.15" mass="0.9" diaginertia="0.009 0.01 0.002" euler="0 -0.3 0"/>
        <joint name="elbow" axis="0 1 0" ref="0.4"/>
      </body>
    </body>
"""

# Two hinges on one body, with their own anchors and axes that are neither aligned with anything nor
# orthogonal; the body frame lies on neither axis. A child shows whether the pose is passed on.
_UNIVERSAL = """
    <body name="gimbal" pos="0.1 -0.2 0.8" quat="0.9 0.1 -0.3 0.2">
      <inertial pos="0.05 -0.03 0.08" mass="2.3"
        fullinertia="0.031 0.027 0.019 0.002 -0.003 0.0015"/>
      <joint name="first" pos="0.02 0.05 -0.04" axis="1 0.3 -0.2"/>
      <joint name="second" pos="-0.03 0.01 0.06" axis="0.2 -1 0.5"/>
      <body name="tip" pos="0.1 0.2 -0.15" quat="0.7 -0.4 0.5 0.1">
        <inertial pos="-0.02 0.06 0.03" mass="0.8"
          fullinertia="0.004 0.006 0.005 -0.0007 0.0004 0.0009"/>
        <joint name="third" pos="0.01 -0.02 0.03" axis="-0.4 0.1 1"/>
      </body>
    </body>
"""

# Three joints on one body, a slide between two hinges, so that the slide's axis turns with the
# first hinge and the second hinge's anchor moves with the slide. `ref` on the slide too.
_THREE_JOINTS = """
    <body name="head" pos="0 0.1 0.5" euler="0.3 -0.2 0.5">
      <inertial pos="0.03 0.04 -0.06" mass="1.4"
        fullinertia="0.012 0.015 0.01 0.001 0.002 -0.0012"/>
      <joint name="pan" pos="0.02 0 0.03" axis="0.1 0.2 1"/>
      <joint name="reach" type="slide" axis="1 -0.4 0.3" ref="0.15"/>
      <joint name="tilt" pos="-0.04 0.03 0.01" axis="0 1 0.6" ref="-0.3"/>
      <body name="tool" pos="0.12 0.05 0.02" euler="-0.6 0.1 0.2">
        <inertial pos="0.02 -0.01 0.07" mass="0.6" diaginertia="0.003 0.004 0.002"
          euler="0.5 0.2 -0.7"/>
        <joint name="push" type="slide" axis="0.3 0.2 -1"/>
        <joint name="roll" axis="0 0.2 1" pos="0 0.02 0.01"/>
      </body>
    </body>
"""

# Bodies without joints: one welded to the world (heavy, and it must not matter), a moving body
# under it, a welded child with a welded child of its own, and a welded body between two moving
# ones.
_WELDED = """
    <body name="pedestal" pos="0.2 0.1 0.3" euler="0.2 0.1 -0.4">
      <inertial pos="0.1 0 0.2" mass="25" fullinertia="1.1 1.2 0.9 0.05 0.1 -0.06"/>
      <body name="column" pos="0 0 0.2" euler="0 0 0.8">
        <inertial pos="0 0.02 0.1" mass="3" diaginertia="0.05 0.06 0.03"/>
        <body name="link" pos="0.05 0 0.3" euler="0.1 0.7 0">
          <inertial pos="0.04 0.01 0.1" mass="2.1"
            fullinertia="0.03 0.028 0.012 0.001 -0.002 0.003"/>
          <joint name="base" axis="0.1 1 0.2" pos="0.01 0 0.02"/>
          <body name="clamp" pos="0.06 0.02 0.2" euler="-0.5 0.3 1.1">
            <inertial pos="0.02 0.03 -0.01" mass="0.7" diaginertia="0.002 0.0025 0.003"
              euler="0.3 0.9 -0.2"/>
            <body name="gripped" pos="-0.03 0.08 0.05" euler="0.9 0 0.3">
              <inertial pos="0.05 -0.02 0.04" mass="1.1"
                fullinertia="0.006 0.005 0.007 0.0008 -0.0005 0.0011"/>
            </body>
          </body>
          <body name="spacer" pos="0 -0.05 0.25" euler="0.4 -0.3 0.2">
            <inertial pos="0.01 0.02 0.05" mass="0.5" diaginertia="0.001 0.0012 0.0008"/>
            <body name="far" pos="0.02 0.03 0.15" euler="-0.2 0.5 0.1">
              <inertial pos="-0.01 0.05 0.08" mass="1.3"
                fullinertia="0.009 0.008 0.004 -0.0006 0.0009 0.0007"/>
              <joint name="far" axis="1 0.2 -0.3" pos="0 0.01 -0.02"/>
            </body>
          </body>
        </body>
      </body>
    </body>
"""

# A ball joint whose anchor is not the body's origin, below a hinge and above another.
_BALL = """
    <body name="mount" pos="0 0 1" euler="0.1 0.4 -0.3">
      <inertial pos="0.03 0.02 -0.05" mass="1.2" diaginertia="0.006 0.007 0.004"
        euler="0.2 0.1 0.6"/>
      <joint name="swing" axis="0.2 1 0.1" pos="0.01 0.02 0"/>
      <body name="bob" pos="0.05 -0.04 -0.3" euler="0.6 -0.1 0.2">
        <inertial pos="0.04 0.07 -0.12" mass="1.9"
          fullinertia="0.022 0.018 0.014 0.003 -0.002 0.0025"/>
        <joint name="ball" type="ball" pos="0.03 -0.05 0.08"/>
        <body name="tail" pos="0 0.06 -0.2" euler="0 0.3 0.9">
          <inertial pos="0.01 -0.03 -0.06" mass="0.4"
            fullinertia="0.0016 0.0013 0.0009 0.0001 -0.0002 0.00015"/>
          <joint name="flick" axis="1 0 0.3" pos="0.01 0 0.02"/>
        </body>
      </body>
    </body>
"""

# Slides along skew axes, one body with two of them, in a gravity that is not along z.
_SLIDES = """
    <body name="carriage" pos="0 0 0.4" euler="0.1 0.2 0.3">
      <inertial pos="0.02 0.01 0.03" mass="4" fullinertia="0.04 0.05 0.06 0.002 -0.004 0.003"/>
      <joint name="x" type="slide" axis="1 0.1 0"/>
      <joint name="y" type="slide" axis="0.3 1 -0.2" ref="0.05"/>
      <body name="quill" pos="0.1 0 -0.2" euler="0.5 0.1 0">
        <inertial pos="0 0.04 -0.1" mass="1.5" diaginertia="0.02 0.021 0.003" euler="0.3 0.2 0.1"/>
        <joint name="spin" axis="0.1 0.2 1" pos="0.03 0 0"/>
        <body name="plunger" pos="0.02 0.03 -0.1" euler="-0.3 0.6 0.2">
          <inertial pos="0.01 0.02 -0.05" mass="0.7"
            fullinertia="0.003 0.0035 0.001 0.0002 -0.0003 0.0001"/>
          <joint name="z" type="slide" axis="0.2 -0.1 1"/>
        </body>
      </body>
    </body>
"""

# One body in the air: its centre of mass is far from its frame, and all six inertia terms count.
_FREE_BODY = """
    <body name="brick" pos="0.3 -0.2 1.1" quat="0.8 0.3 -0.4 0.2">
      <inertial pos="0.12 -0.07 0.2" mass="3.1"
        fullinertia="0.08 0.07 0.05 0.012 -0.009 0.007"/>
      <freejoint name="free"/>
    </body>
"""

# A floating base with branches: a leg of hinges, an arm with a ball joint, a welded pack with a
# slide under it. Springs, damping and armature on some joints.
_FLOATING_TREE = """
    <body name="trunk" pos="0.1 0.2 0.9" quat="0.9 -0.2 0.1 0.3">
      <inertial pos="0.03 -0.02 0.06" mass="6.2"
        fullinertia="0.11 0.09 0.07 0.006 -0.008 0.004"/>
      <freejoint name="base"/>
      <body name="thigh" pos="0.02 0.12 -0.1" euler="0.2 0 0.1">
        <inertial pos="0.01 0.02 -0.15" mass="2.4"
          fullinertia="0.03 0.031 0.008 0.001 0.002 -0.001"/>
        <joint name="hip_roll" axis="1 0.1 0" pos="0 -0.02 0.03" armature="0.03" damping="0.4"/>
        <joint name="hip_pitch" axis="0 1 0.2" armature="0.02"/>
        <body name="shank" pos="0 0.01 -0.3" euler="0 0.2 0">
          <inertial pos="0.02 0 -0.12" mass="1.3" diaginertia="0.012 0.013 0.002"
            euler="0.1 0.3 0.4"/>
          <joint name="knee" axis="0.1 1 0" ref="0.5" damping="0.2" stiffness="3" springref="0.7"/>
        </body>
      </body>
      <body name="arm" pos="0.05 -0.15 0.2" euler="-0.3 0.2 0.6">
        <inertial pos="0.02 -0.05 -0.1" mass="1.1"
          fullinertia="0.007 0.006 0.004 0.0008 0.0005 -0.0006"/>
        <joint name="shoulder" type="ball" pos="0.02 0.03 0.05" damping="0.1" armature="0.01"/>
        <body name="forearm" pos="0 -0.05 -0.22" euler="0.4 0 -0.2">
          <inertial pos="0.01 0.02 -0.09" mass="0.6"
            fullinertia="0.003 0.0028 0.0008 0.0001 0.0002 0.0003"/>
          <joint name="elbow" axis="1 0.3 0.1" armature="0.005"/>
        </body>
      </body>
      <body name="pack" pos="-0.15 0.01 0.1" euler="0.1 0.4 0.2">
        <inertial pos="-0.03 0.02 0.05" mass="1.8" diaginertia="0.014 0.011 0.009"
          euler="0.7 -0.2 0.3"/>
        <body name="tail" pos="-0.05 0 -0.1" euler="0 -0.5 0.3">
          <inertial pos="-0.04 0.01 0.02" mass="0.5"
            fullinertia="0.0012 0.002 0.0018 0.0002 -0.0001 0.0003"/>
          <joint name="tail" type="slide" axis="1 0.2 0.4" damping="1.5"/>
        </body>
      </body>
    </body>
"""

# A collaborative arm of 7 joints and 18 kg. The figures are our own, of the usual size; every frame
# is turned against its parent, as such arms are described, and every inertia frame against its
# body.
_ARM7 = """
    <body name="base" pos="0 0 0.1">
      <inertial pos="-0.02 0 0.05" mass="2.9" diaginertia="0.012 0.013 0.01"/>
      <body name="link1" pos="0 0 0.23" quat="1 0 0 0">
        <inertial pos="0.003 -0.03 -0.07" mass="4.1" diaginertia="0.034 0.03 0.011"
          euler="0.3 0.1 0.05"/>
        <joint name="joint1" axis="0 0 1" armature="0.12" damping="0.8" frictionloss="0.4"/>
        <body name="link2" quat="0.7071 -0.7071 0 0">
          <inertial pos="-0.004 -0.07 0.03" mass="3.3" diaginertia="0.026 0.01 0.025"
            euler="-0.2 0.15 0.1"/>
          <joint name="joint2" axis="0 0 1" armature="0.12" damping="0.8"/>
          <body name="link3" pos="0 -0.31 0" quat="0.7071 0.7071 0 0">
            <inertial pos="0.03 0.035 -0.06" mass="2.7"
              fullinertia="0.018 0.017 0.009 -0.002 -0.0025 0.0018"/>
            <joint name="joint3" axis="0 0 1" armature="0.09" frictionloss="0.25"/>
            <body name="link4" pos="0.08 0 0" quat="0.7071 0.7071 0 0">
              <inertial pos="-0.04 0.06 0.03" mass="2.6"
                fullinertia="0.017 0.01 0.018 0.003 -0.0015 0.0012"/>
              <joint name="joint4" axis="0 0 1" armature="0.09" damping="0.5" stiffness="2.5"
                springref="-1.2" ref="-0.6"/>
              <body name="link5" pos="-0.08 0.37 0" quat="0.7071 -0.7071 0 0">
                <inertial pos="-0.01 0.04 -0.11" mass="2.2" diaginertia="0.025 0.022 0.007"
                  euler="0.35 -0.1 0.2"/>
                <joint name="joint5" axis="0 0 1" armature="0.05" damping="0.3"/>
                <body name="link6" quat="0.7071 0.7071 0 0">
                  <inertial pos="0.05 -0.01 -0.01" mass="1.6"
                    fullinertia="0.0025 0.005 0.0055 0.0003 0.0002 -0.0004"/>
                  <joint name="joint6" axis="0 0 1" armature="0.05" frictionloss="0.15"/>
                  <body name="link7" pos="0.09 0 0" quat="0.7071 0.7071 0 0">
                    <inertial pos="0.01 0.01 0.07" mass="0.8" diaginertia="0.0016 0.0014 0.0009"
                      euler="0.1 -0.25 0.4"/>
                    <joint name="joint7" axis="0 0 1" armature="0.03" stiffness="0.4"/>
                    <body name="flange" pos="0 0 0.11" quat="0.9239 0 0 -0.3827">
                      <inertial pos="0.005 0 0.03" mass="0.7" diaginertia="0.001 0.0012 0.0006"/>
                    </body>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
"""

MODELS: dict[str, str] = {
    "planar_2r": _model("planar_2r", _PLANAR_2R),
    "universal": _model("universal", _UNIVERSAL),
    "three_joints": _model("three_joints", _THREE_JOINTS),
    "welded": _model("welded", _WELDED),
    "ball": _model("ball", _BALL),
    "slides": _model("slides", _SLIDES, gravity="1.3 -0.7 -9.6"),
    "free_body": _model("free_body", _FREE_BODY),
    "floating_tree": _model("floating_tree", _FLOATING_TREE),
    "arm7": _model("arm7", _ARM7),
    # Two robots in one world, one of them floating: two trees.
    "two_trees": _model("two_trees", _FREE_BODY + _BALL),
}
