"""A viewer that shares no code with Lacuna's live view: `websockets` speaking `foxglove.sdk.v1`.

    view_client.py watch PORT OUT.bin      connects (waits for the server), subscribes to every topic, keeps what comes
                                           until the server leaves; prints the topics with their types as JSON
    view_client.py compare OUT.bin RUN.mcap   decodes what came and the same messages of the recording, both with
                                           `mcap-ros2-support`, and prints per topic: how many came, how many are equal,
                                           the stamps, and the first difference if there is one
    view_client.py probe                   exits 0 if these packages are there
"""

import json
import pickle
import struct
import sys
import time


def connect(port):
    from websockets.sync.client import connect

    until = time.monotonic() + 20
    while True:
        try:
            return connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None)
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.02)


def watch(port, out):
    from websockets.exceptions import ConnectionClosed

    channels, messages, info = {}, [], None
    with connect(port) as socket:
        if socket.subprotocol != "foxglove.sdk.v1":
            sys.exit(f"found subprotocol {socket.subprotocol}; expected foxglove.sdk.v1")
        try:
            for frame in socket:
                if isinstance(frame, str):
                    said = json.loads(frame)
                    if said["op"] == "serverInfo":
                        info = said
                    elif said["op"] == "advertise":
                        new = [{"id": 1000 + c["id"], "channelId": c["id"]} for c in said["channels"]]
                        channels.update({1000 + c["id"]: c for c in said["channels"]})
                        socket.send(json.dumps({"op": "subscribe", "subscriptions": new}))
                elif frame[0] == 1:
                    subscription, log_time = struct.unpack_from("<IQ", frame, 1)
                    messages.append((subscription, log_time, bytes(frame[13:])))
        except ConnectionClosed:
            pass
    with open(out, "wb") as file:
        pickle.dump((channels, messages), file)
    topics = {c["topic"]: [c["schemaName"], c["schemaEncoding"], c["encoding"]] for c in channels.values()}
    json.dump({"server": info["name"], "capabilities": info["capabilities"], "topics": topics}, sys.stdout)


def plain(message):
    """All fields of a decoded message."""
    if hasattr(message, "__slots__"):
        return {name: plain(getattr(message, name)) for name in message.__slots__ if not name.startswith("_")}
    return [plain(v) for v in message] if isinstance(message, (list, tuple)) else message


def compare(came, recording):
    from mcap.reader import make_reader
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    recorded = {}
    with open(recording, "rb") as file:
        for _, channel, message, decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            recorded[channel.topic, message.log_time] = plain(decoded)
    with open(came, "rb") as file:
        channels, messages = pickle.load(file)
    # The factory remembers a schema by its number: those of the viewer have numbers of their own.
    factory, decoders, result = DecoderFactory(), {}, {}
    for subscription, log_time, data in messages:
        channel = channels[subscription]
        topic = channel["topic"]
        if topic not in decoders:
            text = channel["schema"].encode()
            schema = Schema(id=len(decoders) + 1, name=channel["schemaName"], encoding=channel["schemaEncoding"], data=text)
            decoders[topic] = factory.decoder_for(channel["encoding"], schema)
        entry = result.setdefault(topic, {"came": 0, "equal": 0, "stamps": [], "difference": None})
        entry["came"] += 1
        entry["stamps"].append(log_time)
        found, expected = plain(decoders[topic](data)), recorded.get((topic, log_time))
        # NaN stands for a signal that is not there: equal by its text.
        if repr(found) == repr(expected):
            entry["equal"] += 1
        elif entry["difference"] is None:
            entry["difference"] = f"at {log_time}: {found} instead of {expected}"
    json.dump(result, sys.stdout)


def main():
    if sys.argv[1:] == ["probe"]:
        import mcap_ros2.decoder  # noqa: F401
        import websockets.sync.client  # noqa: F401

        return
    how, first, second = sys.argv[1:]
    {"watch": watch, "compare": compare}[how](first, second)


if __name__ == "__main__":
    main()
