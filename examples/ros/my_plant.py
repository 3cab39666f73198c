"""A train of one mass as a plain ROS 2 node, for ``train-ato run xuzhou_metro:ideal --external plant --domain 42``.

Start it with ``ROS_DOMAIN_ID=42 python my_plant.py``, before or after the run; ``--real-time`` waits for no command.
"""

import sys
from contextlib import suppress

import rclpy
from builtin_interfaces.msg import Time
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

MASS, TICK_MS = 192_200, 50  # kg, ms
BEGIN_S = 1_767_225_600  # stamp of the first measurement: 2026-01-01
READERS = 4  # recorder, profile, observer, controller


class MyPlant(Node):
    """Sends a measurement, waits for the command with its stamp, and moves the train by one tick."""

    def __init__(self):
        super().__init__("my_plant")
        self.tick, self.position, self.speed, self.force, self.real_time = -1, 0.0, 0.0, 0.0, "--real-time" in sys.argv
        self.measurement = self.create_publisher(JointState, "train/measurement", 1000)
        self.create_subscription(Header, "recorder/progress", self._begin, 1000)
        self.create_subscription(JointState, "ato/command", self._obey, 1000)

    def _begin(self, _):
        if self.tick < 0 and self.measurement.get_subscription_count() >= READERS:
            self._measure()
            if self.real_time:
                self.create_timer(TICK_MS * 1e-3, self._move)

    def _measure(self):
        self.tick += 1
        seconds, milliseconds = divmod(self.tick * TICK_MS, 1000)
        self.stamp = Time(sec=BEGIN_S + seconds, nanosec=milliseconds * 1_000_000)
        state = {"position": [self.position], "velocity": [self.speed], "effort": [self.force]}
        self.measurement.publish(JointState(header=Header(stamp=self.stamp), name=["unit_0"], **state))

    def _obey(self, command):
        self.force = command.effort[0]
        if not self.real_time and command.header.stamp == self.stamp:
            self._move()

    def _move(self):
        resistance = 4e3 + 8.0 * self.speed**2 if self.speed > 0 else 0.0
        self.speed = max(0.0, self.speed + (self.force - resistance) / MASS * TICK_MS * 1e-3)
        self.position += self.speed * TICK_MS * 1e-3
        self._measure()


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(MyPlant())
