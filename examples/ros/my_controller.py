"""A controller as a plain ROS 2 node, for ``train-ato run demo --external controller --domain 42``.

Start it with ``ROS_DOMAIN_ID=42 python my_controller.py``, before or after the run.
"""

import time
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

READERS = 2  # plant and recorder


class MyController(Node):
    """Sends a force in proportion to the speed error, for every measurement with its stamp."""

    def __init__(self):
        super().__init__("my_controller")
        self.steps = {}
        self.create_subscription(JointTrajectory, "ato/reference", self._keep_reference, 1000)
        self.create_subscription(JointState, "train/measurement", self._keep_measurement, 1000)
        self.command = self.create_publisher(JointState, "ato/command", 1000)

    def _keep_reference(self, message):
        self._answer(message.header, target=message.points[0].velocities[0])

    def _keep_measurement(self, message):
        units = [name for name in message.name if name.startswith("unit")]
        self._answer(message.header, units=units, speed=message.velocity[0])

    def _answer(self, header, **known):
        step = self.steps.setdefault((header.stamp.sec, header.stamp.nanosec), {})
        step |= known
        if len(step) == 3:
            while self.command.get_subscription_count() < READERS:  # before that an answer is lost
                time.sleep(0.01)
            force = 600e3 * (step["target"] - step["speed"])
            force = max(-200e3, min(200e3, force))
            self.command.publish(JointState(header=header, name=step["units"], effort=[force] * len(step["units"])))
            self.steps.clear()


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(MyController())
