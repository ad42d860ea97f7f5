"""A ROS 2 node between a rig and topics: hand out, wall in. Not run: no ROS 2 was at hand when it was written.

Topics are for the state and the wall, not for the loop: a late or lost message leaves the wall where it was.
"""

from pathlib import Path

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

import canhaptic

RIG = Path(__file__).resolve().parents[2] / "configs" / "far_world.yaml"


class Bridge(Node):
    """Publishes `hand`; takes `wall`: [place in m, speed in m/s, side], side 0 for none, -1 pushes down, 1 up."""

    def __init__(self) -> None:
        super().__init__("canhaptic")
        self.hand = self.create_publisher(JointState, "hand", 10)
        self.create_subscription(Float64MultiArray, "wall", self.take, 10)
        self.wall = (0.0, 0.0, 0.0)

    def take(self, message: Float64MultiArray) -> None:
        """Keeps the newest wall."""
        self.wall = tuple(message.data)


if __name__ == "__main__":
    rclpy.init()
    node = Bridge()
    with canhaptic.World("loopback", scene=RIG) as world:
        for state in world:
            rclpy.spin_once(node, timeout_sec=1 / 60)
            place, speed, side = node.wall
            if side:
                world["handle"].wall(at=place, speed=speed, stiffness=2000.0, pushes="-" if side < 0 else "+")
            else:
                world["handle"].free()
            now = state["handle"]
            node.hand.publish(JointState(name=["handle"], position=[now.position], velocity=[now.velocity]))
