"""Reads a recording with readers that share no code with Lacuna and prints what they found as JSON.

    read_mcap.py mcap FILE.mcap     Python `mcap` + `mcap-ros2-support`, through the index and the checksums
    read_mcap.py linear FILE.mcap   the same, front to back without the index (works on cut files)
    read_mcap.py rosbags FOLDER     `rosbags`, on a ROS 2 bag folder
    read_mcap.py probe              exits 0 if these packages are there

Output: {"topics": {topic: {"log_time": [...], "stamp": [...], "fields": {name: [per message]}}},
"metadata": {name: {...}}, "attachments": {name: size}, "profile", "schemas": {topic: type}}. Floating-point fields are strings that hold all digits,
since JSON readers may round.
"""

import json
import struct
import sys


def plain(value):
    """A message field as JSON can hold it."""
    if isinstance(value, bool):
        return value
    if isinstance(value, (int, str)):
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, (list, tuple, bytes)):
        return [plain(v) for v in value]
    raise TypeError(f"no JSON for {type(value)}")


def field_names(message):
    names = getattr(message, "__slots__", None) or list(vars(message))
    return [n for n in names if not n.startswith("_") and n != "header"]


class Found:
    def __init__(self):
        self.topics = {}
        self.metadata = {}
        self.attachments = {}
        self.profile = None
        self.schemas = {}

    def add(self, topic, log_time, message):
        entry = self.topics.setdefault(topic, {"log_time": [], "stamp": [], "fields": {}})
        entry["log_time"].append(log_time)
        stamp = message.header.stamp
        entry["stamp"].append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        for name in field_names(message):
            entry["fields"].setdefault(name, []).append(plain(getattr(message, name)))

    def print(self):
        json.dump(vars(self), sys.stdout)


def read_indexed(path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found = Found()
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        found.profile = reader.get_header().profile
        found.schemas = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            found.add(channel.topic, message.log_time, decoded)
        for record in reader.iter_metadata():
            found.metadata[record.name] = record.metadata
        for attachment in reader.iter_attachments():
            found.attachments[attachment.name] = len(attachment.data)
        counted = {summary.channels[c].topic: n for c, n in summary.statistics.channel_message_counts.items()}
        read = {topic: len(entry["log_time"]) for topic, entry in found.topics.items()}
        if counted != read:
            sys.exit(f"the index counts {counted}, but {read} were read")
        if len(summary.chunk_indexes) != summary.statistics.chunk_count:
            sys.exit("the number of chunk indexes is not the number of chunks")
    return found


def read_linear(path):
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader
    from mcap_ros2.decoder import DecoderFactory

    found, schemas, channels, decoders, factory = Found(), {}, {}, {}, DecoderFactory()
    with open(path, "rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Metadata):
                    found.metadata[record.name] = record.metadata
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    if channel.id not in decoders:
                        schema = schemas[channel.schema_id]
                        decoders[channel.id] = factory.decoder_for(channel.message_encoding, schema)
                    found.add(channel.topic, record.log_time, decoders[channel.id](record.data))
        except (McapError, EOFError, struct.error):
            pass  # the file stops here, perhaps within a number
    return found


def read_rosbags(folder):
    from pathlib import Path

    from rosbags.highlevel import AnyReader

    found = Found()
    with AnyReader([Path(folder)]) as reader:
        count = reader.message_count
        for connection, log_time, raw in reader.messages():
            found.add(connection.topic, log_time, reader.deserialize(raw, connection.msgtype))
    read = sum(len(entry["log_time"]) for entry in found.topics.values())
    if count != read:
        sys.exit(f"metadata.yaml counts {count} messages, but {read} were read")
    return found


def main():
    if sys.argv[1:] == ["probe"]:
        import mcap_ros2.decoder  # noqa: F401
        import rosbags.highlevel  # noqa: F401

        return
    how, path = sys.argv[1:]
    {"mcap": read_indexed, "linear": read_linear, "rosbags": read_rosbags}[how](path).print()


if __name__ == "__main__":
    main()
