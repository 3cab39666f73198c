"""Logs for the tests of the tables: of train_ato, of two trains, and of another tool."""

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import get_types_from_msg
from test_wire import message

from train_ato.log.bag_layout import qos_profiles, qos_text
from train_ato.log.definitions import from_typestore
from train_ato.log.log_writer import LogFile, RunLog
from train_ato.messages.cdr import typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topic import TrainLayout
from train_ato.messages.topics import BY_NAME, EPOCH_NS, Rate, topics_of
from train_ato.messages.types import Command

TICK = 100_000_000


def write_log(folder, layout, ticks) -> None:
    """Write a run of random messages on every topic."""
    wire = Wire(layout)
    with RunLog(folder, topics_of(layout)) as log:
        for tick in range(ticks):
            for topic in topics_of(layout):
                if topic.recorded and (topic.rate is Rate.TICK or tick in (0, 7)):
                    content = message(topic.name, layout, tick * TICK, seed=tick)
                    log.add(
                        topic.name, EPOCH_NS + tick * TICK, EPOCH_NS + tick * TICK, wire.encode(topic.name, content)
                    )


def write_two_trains(folder) -> None:
    """Write the commands of two trains in two namespaces."""
    topic, wire = BY_NAME["ato/command"], Wire(TrainLayout(1, 1))
    known = from_typestore(topic.type)
    log = LogFile(folder)
    numbers = [
        log.channel(f"/{train}/ato/command", topic.type, known.text, known.hash, qos_text(qos_profiles(topic)))
        for train in ("one", "two")
    ]
    for tick in range(3):
        for number, sign in zip(numbers, (1.0, -1.0), strict=True):
            moment = EPOCH_NS + tick * TICK
            data = wire.encode("ato/command", Command(tick * TICK, np.array([sign * (tick + 1)])))
            log.write(number, moment, moment, data)
    log.close()


def write_foreign(path) -> None:
    """Write a log as another tool would: other topics and types, one that is no ROS message, one that is broken."""
    types = typestore()
    t = types.types
    types_mine = get_types_from_msg("int32 depth\nstring who", "mine/msg/Mine")
    assert types_mine
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")

        def channel(topic, kind, encoding="cdr", text=None):
            schema_encoding = "ros2msg" if encoding == "cdr" else "protobuf"
            content = (text or from_typestore(kind).text).encode()
            schema = writer.register_schema(name=kind, encoding=schema_encoding, data=content)
            return writer.register_channel(topic=topic, message_encoding=encoding, schema_id=schema)

        def add(number, k, data):
            moment = 10**18 + k * 250_000_000
            writer.add_message(number, log_time=moment, publish_time=moment, data=data)

        def header(k):
            stamp = t["builtin_interfaces/msg/Time"](sec=10**9, nanosec=k * 250_000_000)
            return t["std_msgs/msg/Header"](stamp=stamp, frame_id="base")

        imu = channel("/imu", "sensor_msgs/msg/Imu")
        vector, quaternion = t["geometry_msgs/msg/Vector3"], t["geometry_msgs/msg/Quaternion"]
        for k in range(3):
            content = t["sensor_msgs/msg/Imu"](
                header=header(k), orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
                orientation_covariance=np.arange(9.0), angular_velocity=vector(x=0.0, y=0.0, z=k / 2),
                angular_velocity_covariance=np.arange(9.0), linear_acceleration=vector(x=0.0, y=0.0, z=0.0),
                linear_acceleration_covariance=np.arange(9.0),
            )  # fmt: skip
            add(imu, k, bytes(types.serialize_cdr(content, "sensor_msgs/msg/Imu")))
        rosout = channel("/rosout", "rcl_interfaces/msg/Log")
        for k in range(200):
            stamp = t["builtin_interfaces/msg/Time"](sec=10**9 + k, nanosec=0)
            content = t["rcl_interfaces/msg/Log"](
                stamp=stamp, level=20, name="node", msg=f"line {'x' * k}", file="f.py", function="g", line=k
            )
            add(rosout, k, bytes(types.serialize_cdr(content, "rcl_interfaces/msg/Log")))
        joints = channel("/joints", "sensor_msgs/msg/JointState")
        for k in range(2):
            content = t["sensor_msgs/msg/JointState"](
                header=header(k), name=["wrist", "elbow"], position=np.array([9.0, k + 1.0]),
                velocity=np.zeros(0), effort=np.zeros(0),
            )  # fmt: skip
            add(joints, k, bytes(types.serialize_cdr(content, "sensor_msgs/msg/JointState")))
        camera = channel("/camera", "sensor_msgs/msg/Image")
        content = t["sensor_msgs/msg/Image"](
            header=header(0), height=10, width=100, encoding="rgb8", is_bigendian=0, step=300,
            data=np.zeros(3000, np.uint8),
        )  # fmt: skip
        add(camera, 0, bytes(types.serialize_cdr(content, "sensor_msgs/msg/Image")))
        add(channel("/proto", "Proto", encoding="protobuf", text="x"), 0, b"123")
        mine = channel("/mine", "mine/msg/Mine", text="int32 depth\nstring who\n")
        for k in range(2):
            add(mine, k, b"\x00\x01\x00\x00" + (3 + k).to_bytes(4, "little") + b"\x04\x00\x00\x00you\x00")
        add(channel("/broken", "mine/msg/Mine", text="int32 depth\nstring who\n"), 0, b"\x00\x01\x00\x00\x00")
        writer.finish()
