"""A ROS 2 node that weighs what a robot holds, from its joint states: an example to copy.

    python3 docs/ros2_node.py --ros-args -p model:=corrected.xml -p body:=hand -r joint_states:=/joint_states

It needs rclpy, which comes with ROS 2 and not with pip. Joint states must hold position, velocity and effort [N m].
Publishes on ~/payload (std_msgs/Float64MultiArray) mass [kg], its 95 % half-width and the centre of mass [m] in the
body's frame; on ~/verdict (std_msgs/String) what that says.
"""

import jax
import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

import jax_inertia as ji

EVERY = 0.25
"""Seconds from answer to answer."""


class Payload(Node):
    """Joint states in, mass and centre out."""

    def __init__(self) -> None:
        super().__init__("payload")
        usual = {
            "model": "corrected.xml",
            "body": "hand",
            "sigma_tau": 0.3,
            "load": 2.0,
            "reach": 0.2,
            "window": 5,
        }
        given = {name: self.declare_parameter(name, value).value for name, value in usual.items()}
        self.robot, self.body = ji.load_model(given["model"]), given["body"]
        estimator = ji.make_estimator(
            self.robot,
            [self.body],
            sigma_tau=given["sigma_tau"],
            prior=ji.Load(given["load"], given["reach"]),
        )
        self.stream = ji.Stream(estimator, window=given["window"], block=25)
        self.state, self.rows = self.stream.start(), []
        self.own = float(self.robot.pi[self.robot.body_index(self.body), 0])
        self.payload = self.create_publisher(Float64MultiArray, "~/payload", 10)
        self.verdict = self.create_publisher(String, "~/verdict", 10)
        self.create_subscription(JointState, "joint_states", self.take, 100)
        self.create_timer(EVERY, self.answer)

    def take(self, message: JointState) -> None:
        """Keep one joint state, its joints by name; what lacks a joint or a channel is left out."""
        place = {name: k for k, name in enumerate(message.name)}
        channels = message.position, message.velocity, message.effort
        lacking = any(len(x) != len(message.name) for x in channels)
        if lacking or not set(self.robot.joint_names) <= set(place):
            return
        order = [place[name] for name in self.robot.joint_names]
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if not self.rows or stamp > self.rows[-1][0]:
            self.rows.append((stamp, *(np.asarray(x, float)[order] for x in channels)))

    def answer(self) -> None:
        """Filter what came since, and say what is known."""
        # The last row waits: what comes next goes on from it.
        if len(self.rows) < 2:
            return
        rows, self.rows = self.rows[:-1], self.rows[-1:]
        time, qpos, qvel, tau = (np.array(x) for x in zip(*rows, strict=True))
        chunk = ji.Log(time=time, joint_names=self.robot.joint_names, qpos=qpos, qvel=qvel, tau=tau)
        self.state, part = self.stream.feed(self.state, chunk)
        if part is None:
            return
        now = part.trace.estimate
        mass, half = float(now.pi[-1, 0, 0]), 1.96 * float(now.sigma_pi[-1, 0, 0])
        self.payload.publish(Float64MultiArray(data=[mass, half, *map(float, now.com[-1, 0])]))
        more = mass - self.own
        said = (
            f"{self.body} holds {more:.2f} ± {half:.2f} kg" if abs(more) > half else "nothing held"
        )
        self.verdict.publish(String(data=said))


def main() -> None:
    """Run until Ctrl-C."""
    jax.config.update("jax_enable_x64", True)
    rclpy.init()
    node = Payload()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()


if __name__ == "__main__":
    main()
