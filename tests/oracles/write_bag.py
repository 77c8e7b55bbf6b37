"""Writes ROS 2 bags of JointState messages with `rosbags`, as other people's robots leave them, for the reader's
tests. No code is shared with Lacuna.

    write_bag.py FOLDER

Makes FOLDER/arm (one MCAP bag): /joint_states with the arm's joints elbow, shoulder (in this order, after a joint
that the robot file does not name) alternating with messages of a gripper; /diagnostics of another type. Sample k of
0..199: header stamp 1.7e18 + k * 2 ms, log time 1 ms later, shoulder position sin(0.1 k), effort 3 sin(0.1 k),
elbow position cos(0.1 k), effort k.
Makes FOLDER/unstamped: the same arm without the gripper, on /robot/states, all header stamps 0.
Makes FOLDER/two: JointState topics /left and /right.
"""

import math
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
JOINT_STATE = STORE.types["sensor_msgs/msg/JointState"]
HEADER = STORE.types["std_msgs/msg/Header"]
TIME = STORE.types["builtin_interfaces/msg/Time"]
STRING = STORE.types["std_msgs/msg/String"]
START = 1_700_000_000_000_000_000


def joint_state(stamp, names, position, effort):
    header = HEADER(stamp=TIME(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="base")
    empty = np.array([], dtype=np.float64)
    as_array = lambda values: np.array(values, dtype=np.float64)
    return JOINT_STATE(
        header=header, name=names, position=as_array(position), velocity=empty, effort=as_array(effort)
    )


def arm(k, stamp):
    s, c = math.sin(0.1 * k), math.cos(0.1 * k)
    return joint_state(stamp, ["wheel", "elbow", "shoulder"], [9.0, c, s], [8.0, float(k), 3 * s])


def write(folder, topics, messages):
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=STORE) for topic, kind in topics.items()
        }
        for topic, log_time, message in messages:
            kind = topics[topic]
            writer.write(connections[topic], log_time, STORE.serialize_cdr(message, kind))


def main():
    folder = Path(sys.argv[1])
    kind = "sensor_msgs/msg/JointState"
    messages = []
    for k in range(200):
        stamp = START + k * 2_000_000
        messages.append(("/joint_states", stamp + 1_000_000, arm(k, stamp)))
        gripper = joint_state(stamp, ["finger"], [0.1], [])
        messages.append(("/joint_states", stamp + 1_000_001, gripper))
        messages.append(("/diagnostics", stamp + 1_000_002, STRING(data="fine")))
    write(folder / "arm", {"/joint_states": kind, "/diagnostics": "std_msgs/msg/String"}, messages)

    messages = [("/robot/states", START + k * 2_000_000, arm(k, 0)) for k in range(200)]
    write(folder / "unstamped", {"/robot/states": kind}, messages)

    messages = [(t, START, arm(0, START)) for t in ("/left", "/right")]
    write(folder / "two", {"/left": kind, "/right": kind}, messages)


if __name__ == "__main__":
    main()
