"""The process around a stage in Python: bus, wake-up, end of stream, what the supervisor hears.

It does what `services/stage` does for stages in Rust, by the same rules: nothing is lost in a replay, nothing waits on
a live graph, and what is dropped or missing is counted. A stage is a class with `__init__(robot, model, config)`, which
may raise `BadInput`, and `step(sample, out)`, which fills `out` for one sample; the header is copied before.

Needs Python 3.11, `pip install iceoryx2==0.10.0` and the messages: `lacuna messages --python --out lacuna_messages.py`
into this folder or onto PYTHONPATH.
"""

import argparse
import json
import os
import re
import sys
import threading
import time
import tomllib
import traceback

import iceoryx2 as iox2

import lacuna_messages as wire

NOTIFY_EVERY = 64
OPEN_S, STALL_S, LIVE_CONNECT_S = 10.0, 60.0, 0.1


class BadInput(Exception):
    """Bad input or use: the run ends with exit code 2 and this line."""


class Failed(Exception):
    """Anything else: exit code 1."""


def say(event, **fields):
    print(json.dumps({"event": event, **fields}), flush=True)


class Bus:
    """This process's place on the bus of a run."""

    def __init__(self, run, node):
        with open(f"{run}/graph.toml", "rb") as file:
            self.graph = tomllib.load(file)
        self.live = self.graph["mode"] == "live"
        self.node = next((n for n in self.graph["node"] if n["name"] == node), None)
        if self.node is None:
            raise BadInput(f"--node {node}: the graph has no such node")
        iox2.set_log_level(iox2.LogLevel.Fatal)
        iox2.config.setup_global_config_from_file(iox2.FilePath.new(f"{run}/domain.toml"))
        builder = iox2.NodeBuilder.new().name(iox2.NodeName.new(node))
        # SIGTERM ends Python at once, also within a blocked send.
        self.iox = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)

    def readers(self, topic):
        return [n["name"] for n in self.graph["node"] if topic in n.get("inputs", [])]

    def buffer(self, node):
        """Messages that an input of a node can hold."""
        return node.get("buffer", self.graph.get("buffer", 512))

    def buffers(self, topic):
        return [self.buffer(n) for n in self.graph["node"] if topic in n.get("inputs", [])] or [self.buffer({})]

    def topic(self, topic, message):
        readers, spare = len(self.readers(topic)), 2 if self.live else 0
        builder = self.iox.service_builder(iox2.ServiceName.new(topic)).publish_subscribe(message)
        builder = builder.enable_safe_overflow(False).history_size(0).subscriber_max_buffer_size(max(self.buffers(topic)))
        builder = builder.subscriber_max_borrowed_samples(2).max_publishers(1 + spare)
        builder = builder.max_subscribers(max(readers + spare, 1)).max_nodes(readers + 2 + 2 * spare)
        until = time.monotonic() + OPEN_S
        while True:
            try:
                return builder.open_or_create()
            except Exception as error:
                if "IncompatibleTypes" in str(error):
                    raise BadInput(
                        f"topic \"{topic}\": this stage speaks {message.type_name()}, the topic carries "
                        f"{self.carried(topic)}; expected the same message and layout on both sides"
                    ) from None
                if time.monotonic() > until:
                    raise Failed(f"topic \"{topic}\": cannot be opened on the bus: {error}") from None
                time.sleep(0.005)

    def carried(self, topic):
        """Type name of the message that a topic carries."""
        pattern, config = iox2.MessagingPattern.PublishSubscribe, iox2.config.global_config()
        details = iox2.Service.details(iox2.ServiceName.new(topic), config, pattern, iox2.ServiceType.Ipc)
        found = re.search(r"lacuna\.\w+\.[0-9a-f]{16}", str(details))
        return found[0] if found else "another message"

    def wake(self, node):
        builder = self.iox.service_builder(iox2.ServiceName.new(f"wake/{node}")).event()
        return builder.max_listeners(4).max_notifiers(32).max_nodes(36).open_or_create()


class Input:
    """The reading end of a topic."""

    def __init__(self, bus, topic, message):
        self.topic, self.live = topic, bus.live
        self.port = bus.topic(topic, message).subscriber_builder().buffer_size(bus.buffer(bus.node)).create()
        self.last, self.received, self.missing = None, 0, 0

    def receive(self):
        """The next sample, the number of those lost before it, and whether it is the end; None if there is none."""
        while (sample := self.port.receive()) is not None:
            header = sample.payload().contents.header
            end = bool(header.flags & wire.END_OF_STREAM)
            # A replay begins at 1; a live reader may join later.
            expected = self.last + 1 if self.last is not None else header.seq if self.live else 1
            if header.seq < expected:
                if end and self.live:
                    return sample, 0, True
                sample.delete()
                continue
            gap = header.seq - expected
            if gap and not self.live:
                raise Failed(f"topic \"{self.topic}\": sample {header.seq} came where {expected} was expected")
            self.last, self.missing = header.seq, self.missing + gap
            self.received += not end
            return sample, gap, end
        return None


class Output:
    """The writing end of a topic."""

    def __init__(self, bus, topic, message):
        self.topic, self.live, self.message = topic, bus.live, message
        self.factory = bus.topic(topic, message)
        how = iox2.BackpressureStrategy.DiscardData if self.live else iox2.BackpressureStrategy.RetryUntilDelivered
        self.port = self.factory.publisher_builder().max_loaned_samples(1).backpressure_strategy(how).create()
        self.bells = [bus.wake(node).notifier_builder().create() for node in bus.readers(topic)]
        self.expected = len(self.bells)
        self.every = min(NOTIFY_EVERY, max(min(bus.buffers(topic)) // 2, 1))
        self.unnotified, self.connected, self.published, self.dropped = 0, False, 0, 0

    def readers(self):
        return self.factory.dynamic_config.number_of_subscribers

    def connect(self):
        until = time.monotonic() + (LIVE_CONNECT_S if self.live else OPEN_S)
        while self.readers() < self.expected and time.monotonic() < until:
            time.sleep(0.001)
        if self.readers() < self.expected and not self.live:
            raise Failed(f"topic \"{self.topic}\": {self.readers()} of {self.expected} readers connected")
        self.connected = True

    def deliver(self, message):
        sample = self.port.loan_uninit().write_payload(message)
        header = sample.payload().contents.header
        if header.hops < wire.MAX_HOPS:
            header.hop_ns[header.hops] = time.monotonic_ns()
        header.hops += 1
        header.dropped += self.dropped
        return sample.send()

    def send(self, message):
        if not self.connected:
            self.connect()
        delivered = self.deliver(message)
        if delivered < self.expected and self.live:
            self.dropped += self.expected - delivered
        # Replay: a reader that has not looked at its port yet is left out; those that have the sample drop the copy.
        until = time.monotonic() + OPEN_S
        while delivered < self.expected and not self.live:
            if self.readers() < self.expected or time.monotonic() > until:
                raise Failed(f"topic \"{self.topic}\": sample {message.header.seq} did not reach all readers")
            self.ring()
            time.sleep(0.0002)
            delivered = self.deliver(message)
        self.published += 1
        self.unnotified += 1
        if self.unnotified >= self.every:
            self.ring()

    def ring(self):
        self.unnotified = 0
        for bell in self.bells:
            bell.notify()

    def finish(self, seq, joints):
        """Says that the stream is over and waits until every reader has taken it and let go."""
        if not self.connected:
            self.connect()
        end = self.message()
        end.header.seq, end.header.joints, end.header.flags = seq, joints, wire.END_OF_STREAM
        until, said = time.monotonic() + STALL_S, 0.0
        delivered = 0
        while self.readers() > 0:
            if delivered < self.expected or (self.live and time.monotonic() - said > 0.02):
                delivered, said = max(delivered, self.deliver(end)), time.monotonic()
                self.ring()
            if time.monotonic() > until:
                raise Failed(f"topic \"{self.topic}\": {self.readers()} readers did not take the end of the stream")
            time.sleep(0.001)


def listen(ended):
    """Hears the supervisor; when its end of standard input closes it is gone, and so is the run."""
    for line in sys.stdin:
        match line.split():
            case ["ended", topic]:
                ended.add(topic)
    os._exit(1)


def relay(bus, stage, source, sink, restarts, ended):
    """Passes every sample through the stage until the stream ends; returns the last number and the number of joints."""
    bell = bus.wake(bus.node["name"]).listener_builder().create()
    say("ready")
    message, last, told, flags, sleep_ms = sink.message(), 0, time.monotonic(), 0, 1
    while True:
        # Asked before the buffer is looked at: what came until then is still taken.
        over = bus.live and source.topic in ended
        got = source.receive()
        if got is None:
            if over:
                return last, message.header.joints
            if sink.unnotified:
                sink.ring()
            # A ring can be lost within iceoryx2 0.10: short sleeps after a ring, longer ones the longer nothing comes.
            rung = bell.timed_wait(iox2.Duration.from_millis(sleep_ms))
            sleep_ms = 1 if rung else min(2 * sleep_ms, 100)
        else:
            sample, gap, end = got
            if end:
                sample.delete()
                return last, message.header.joints
            taken = sample.payload().contents
            message.header = taken.header
            if gap or (restarts and not last):
                message.header.flags |= wire.GAP
            message.header.restarts += restarts
            flags |= message.header.flags
            stage.step(taken, message)
            sample.delete()
            last = message.header.seq
            sink.send(message)
            if restarts and sink.published == 1:
                say("flowing", at_ns=time.monotonic_ns())
        if time.monotonic() - told > 0.5:
            told = time.monotonic()
            gauge = {"dropped": sink.dropped, "missing": source.missing, "flags": flags}
            say("progress", samples=source.received, fraction=None, gauge=gauge)
            flags = 0


def body(stage_class, reads, writes):
    parser = argparse.ArgumentParser(description="A stage of a Lacuna graph; started by `lacuna up`, not by hand.")
    parser.add_argument("--run", required=True)
    parser.add_argument("--node", required=True)
    parser.add_argument("--restarts", type=int, default=0)
    args = parser.parse_args()
    ended = set()
    threading.Thread(target=listen, args=(ended,), daemon=True).start()
    bus = Bus(args.run, args.node)
    with open(bus.graph["robot"], "rb") as file:
        robot = tomllib.load(file)
    path = bus.node.get("model") or bus.graph.get("model", "")
    model = None
    if path:
        with open(path, "rb") as file:
            model = tomllib.load(file)
    stage = stage_class(robot, model, bus.node.get("config", {}))
    source = Input(bus, bus.node["inputs"][0], reads)
    sink = Output(bus, bus.node["output"], writes)
    last, joints = relay(bus, stage, source, sink, args.restarts, ended)
    if not bus.live and sink.published != source.received:
        raise Failed(f"took {source.received} samples and gave {sink.published}; expected one for one")
    report = {"received": {source.topic: source.received}, "published": sink.published, "last_seq": last}
    report |= {"dropped": sink.dropped, "missing": source.missing}
    # Letting go of the input tells the writer that the sentinel was taken.
    source.port.delete()
    sink.finish(last + 1, joints)
    say("done", report=report)


def give_up(reason, code):
    reason = " ".join(str(reason).split())
    say("failed", reason=f"{os.path.basename(sys.argv[0])}: {reason}", code=code)
    sys.exit(code)


def run_stage(stage_class, reads, writes):
    """`main` of a stage that reads and writes these messages."""
    try:
        body(stage_class, reads, writes)
    except (BadInput, Failed, OSError, tomllib.TOMLDecodeError, KeyError) as error:
        give_up(error, 1 if isinstance(error, Failed) else 2)
    except Exception as error:
        traceback.print_exc()
        give_up(f"{type(error).__name__}: {error}", 1)
