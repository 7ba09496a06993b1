"""The middle of a bad cable: passes Ethernet frames on between two devices, late, not all, or none.

In a process of its own:  python relay.py DEVICE DEVICE  in the namespace of the cable; a line of its standard input is
a change, as {"loss": 0.01, "delay": 0.005, "cut": 1}. With one device, it is made ready for such a cable.
"""

import array
import contextlib
import fcntl
import heapq
import json
import os
import random
import select
import socket
import struct
import sys
import time

ETHERNET_P_ALL = 3
OUTGOING = 4
"""The kind of a packet that this machine has sent itself."""
SIOCETHTOOL = 0x8946
OFFLOADS = (0x15, 0x17, 0x1F, 0x24, 0x2C)
"""ETHTOOL_S of rx, tx, tso, gso, gro: a frame must be whole, with its checksum, when it is passed on."""


def whole_frames(device: str) -> None:
    """The kernel leaves nothing of the frames of this device to hardware."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        for setting in OFFLOADS:
            value = array.array("B", struct.pack("II", setting, 0))
            request = struct.pack("16sP", device.encode(), value.buffer_info()[0])
            with contextlib.suppress(OSError):
                fcntl.ioctl(door, SIOCETHTOOL, request)


def relay(devices: tuple[str, str]) -> None:
    """Until standard input ends."""
    now_on = {"loss": 0.0, "delay": 0.0, "cut": 0.0}
    draw = random.Random(1)  # noqa: S311 - of frames
    ends = []
    for device in devices:
        end = socket.socket(
            socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERNET_P_ALL)
        )
        end.bind((device, 0))
        end.setblocking(False)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        ends.append(end)
    late: list[tuple[float, int, int, bytes]] = []
    poll, number = select.poll(), 0
    for descriptor in (0, *(end.fileno() for end in ends)):
        poll.register(descriptor, select.POLLIN)
    os.write(2, b"relaying\n")
    while True:
        while late and late[0][0] <= time.monotonic():
            _, _, side, frame = heapq.heappop(late)
            with contextlib.suppress(OSError):
                ends[side].send(frame)
        wait = 1000.0 * max(0.0, late[0][0] - time.monotonic()) if late else 1000.0
        for descriptor, _ in poll.poll(wait):
            if descriptor == 0:
                said = os.read(0, 4096)
                if not said:
                    return
                for line in said.splitlines():
                    now_on |= json.loads(line)
                continue
            side = 0 if descriptor == ends[0].fileno() else 1
            with contextlib.suppress(BlockingIOError):
                while True:
                    frame, address = ends[side].recvfrom(65535)
                    if (
                        address[2] == OUTGOING
                        or now_on["cut"]
                        or draw.random() < now_on["loss"]
                    ):
                        continue
                    number += 1
                    heapq.heappush(
                        late,
                        (time.monotonic() + now_on["delay"], number, 1 - side, frame),
                    )


if __name__ == "__main__":
    for each in sys.argv[1:]:
        whole_frames(each)
    if len(sys.argv) > 2:
        relay((sys.argv[1], sys.argv[2]))
