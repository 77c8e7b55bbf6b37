#!/usr/bin/env python3
"""Makes the small EtherCAT captures that the recording crate's tests read, and the table of what is in them.

    pip install scapy==2.8.0
    python3 tests/oracles/ethercat_captures.py services/recording/tests/data

Frames are built by scapy's EtherCAT layers, which share nothing with our parser. Two drives on a ring, 1 kHz:
an LRW moves position, torque and status of drive 1 and position and torque of drive 2 (logical addresses), an FPRD
of station 1002 its status word. The tap sees every frame twice, on its way out (working counter 0) and back.

cycle 20     drive 2 does not answer (working counter short)
cycle 30     lost
cycles 40-49 drive 1 not in "operation enabled"
drive 1's position counter passes 2^31 on its way
"""
import struct
import sys
from pathlib import Path

from scapy.all import Dot1Q, Ether
from scapy.contrib.ethercat import EtherCat, EtherCatFPRD, EtherCatLRW

CYCLES = 60
LOGICAL = 0x01000000
EPOCH_NS = 1_700_000_000_123_456_000
ON, OFF = 0x1237, 0x1233


def truth(k):
    """Counts of cycle k: position 1, torque 1, status 1, position 2, torque 2, status 2."""
    p1 = 2**31 - 25_000 + 1000 * k
    p1 = p1 - 2**32 if p1 >= 2**31 else p1
    return p1, 10 * k - 300, OFF if 40 <= k < 50 else ON, -777 * k, 5 - k, ON


def frames(k):
    """(offset in ns, Ethernet frame) of cycle k."""
    p1, t1, s1, p2, t2, s2 = truth(k)
    answers = 20 != k
    image = struct.pack("<ihHih", p1, t1, s1, p2 if answers else 0, t2 if answers else 0)
    out = bytes(len(image))
    master, handled = "10:22:33:44:55:66", "12:22:33:44:55:66"

    def frame(source, data, counters, status, tag):
        head = Ether(dst="ff:ff:ff:ff:ff:ff", src=source)
        if tag:
            head /= Dot1Q(vlan=3)
        lrw = EtherCatLRW(_cmd=12, idx=k % 256, adr=LOGICAL, data=list(data), wkc=counters[0])
        fprd = EtherCatFPRD(_cmd=4, idx=(k + 1) % 256, adp=1002, ado=0x1100, data=list(status), wkc=counters[1])
        return head / EtherCat(type=1) / lrw / fprd

    tag = k % 2 == 1
    back = (6 if answers else 3, 1)
    return [
        (0, bytes(frame(master, out, (0, 0), b"\0\0", tag))),
        (37_000, bytes(frame(handled, image, back, struct.pack("<H", s2), tag))),
    ]


def packets():
    other = bytes(Ether(dst="ff:ff:ff:ff:ff:ff", src="10:22:33:44:55:66", type=0x0806)) + bytes(46)
    yield EPOCH_NS - 5_000_000, other
    for k in range(CYCLES):
        if k != 30:
            for offset, data in frames(k):
                yield EPOCH_NS + 1_000_000 * k + offset, data


def pcap(path, packets, big_endian, nanoseconds):
    e = ">" if big_endian else "<"
    magic, unit = (0xA1B23C4D, 1) if nanoseconds else (0xA1B2C3D4, 1000)
    with open(path, "wb") as f:
        f.write(struct.pack(e + "IHHiIII", magic, 2, 4, 0, 0, 65535, 1))
        for ns, data in packets:
            f.write(struct.pack(e + "IIII", ns // 10**9, ns % 10**9 // unit, len(data), len(data)) + data)


def pcapng(path, packets):
    """Two interfaces: microseconds by default for what goes out, nanoseconds for what comes back."""

    def block(kind, body):
        body += bytes(-len(body) % 4)
        size = struct.pack("<I", len(body) + 12)
        return struct.pack("<I", kind) + size + body + size

    with open(path, "wb") as f:
        f.write(block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
        f.write(block(1, struct.pack("<HHI", 1, 0, 0)))
        f.write(block(1, struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHB3x", 9, 1, 9) + struct.pack("<HH", 0, 0)))
        for ns, data in packets:
            handled = data[6] & 2 != 0
            ticks = ns if handled else ns // 1000
            head = struct.pack("<IIIII", int(handled), ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data))
            f.write(block(6, head + data))


def main(folder):
    every = list(packets())
    pcap(folder / "drives_us.pcap", every, False, False)
    pcap(folder / "drives_ns_be.pcap", every, True, True)
    pcapng(folder / "drives.pcapng", every)
    with open(folder / "drives.csv", "w") as f:
        f.write("stamp_ns,position1,torque1,status1,position2,torque2,status2\n")
        for k in range(CYCLES):
            if k not in (20, 30):
                f.write(",".join(map(str, (EPOCH_NS + 1_000_000 * k + 37_000, *truth(k)))) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
