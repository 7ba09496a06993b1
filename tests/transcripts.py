"""Request bytes -> reply bytes, port by port, as the documentation of the protocol and measurements of it say.

Each row: what it shows, the request, the replies; hexadecimal, the header first. `..` stands for any byte, `*` for any
bytes to the end.
"""

LINK = (
    ("an echo", "fc 00 11 22", ["fc 00 11 22"]),
    (
        "who is there",
        "fd 00",
        ["fd 42 69 74 63 72 61 7a 65 20 43 72 61 7a 79 66 6c 69 65" + " 00" * 12],
    ),
    ("a sink", "fe 01 02", []),
    ("a packet that says nothing", "ff", []),
)
PLATFORM = (
    ("the version of the protocol is 12", "dd 00", ["dd 00 0c 00 00 00"]),
    ("the release", "dd 01", ["dd 01 32 30 32 35 2e 31 32"]),
    (
        "the kind of drone: Crazyflie 2.1",
        "dd 02",
        ["dd 02 43 72 61 7a 79 66 6c 69 65 20 32 2e 31"],
    ),
    ("arm, the old way", "dc 01 01", ["dc 01 01 01"]),
    ("recover, the old way", "dc 02", ["dc 02 01 01"]),
    ("a notification has an empty answer", "dc 03 01", ["dc"]),
    ("a continuous wave is echoed", "dc 00 01", ["dc 00 01"]),
    (
        "without a command: the byte of the packet before, 0, the protocol",
        "dd",
        ["dd 00 0c 00 00 00"],
    ),
    ("arm, the old way, without an argument", "dc 01", ["dc 01 01 01"]),
    ("an application that is not there", "de 01 02", []),
)
LOG = (
    ("settings without a command", "5d", ["5d 00 00 08"]),
    ("reset", "5d 05", ["5d 05 00 00"]),
    ("how many, 16 blocks, 128 variables", "5c 03", ["5c 03 .. .. .. .. .. .. 10 80"]),
    ("the first: acc.x, a float", "5c 02 00 00", ["5c 02 00 00 07 61 63 63 00 78 00"]),
    ("beyond the last", "5c 02 ff 7f", ["5c 02"]),
    ("create a block of acc.x, twice", "5d 06 01 77 00 00", ["5d 06 01 00"]),
    ("it is there", "5d 06 01 77 00 00", ["5d 06 01 11"]),
    ("append acc.y", "5d 07 01 77 01 00", ["5d 07 01 00"]),
    ("append to what is not there", "5d 07 09 77 01 00", ["5d 07 09 02"]),
    ("append no such variable", "5d 07 01 77 ff 7f", ["5d 07 01 02"]),
    (
        "append five floats more: 28 bytes",
        "5d 07 01" + " 77 01 00" * 5,
        ["5d 07 01 07"],
    ),
    (
        "append acc.z without a type, which has no bytes",
        "5d 07 01 00 02 00",
        ["5d 07 01 00"],
    ),
    ("start", "5d 03 01 0a", ["5d 03 01 00"]),
    ("start in ms", "5d 08 01 0a 00", ["5d 08 01 00"]),
    ("start what is not there", "5d 03 09 0a", ["5d 03 09 02"]),
    ("stop", "5d 04 01", ["5d 04 01 00"]),
    ("delete", "5d 02 01", ["5d 02 01 00"]),
    ("delete again", "5d 02 01", ["5d 02 01 02"]),
    ("no such command", "5d 63 01", ["5d 63 01 08"]),
    *(
        (f"block {n} of 16", f"5d 06 {n:02x} 77 00 00", [f"5d 06 {n:02x} 00"])
        for n in range(1, 17)
    ),
    ("a 17th", "5d 06 11 77 00 00", ["5d 06 11 0c"]),
)
PARAM = (
    ("how many", "2c 03", ["2c 03 .. .. .. .. .. .."]),
    (
        "the first: colAv.bboxMaxX, a float",
        "2c 02 00 00",
        ["2c 02 00 00 06 63 6f 6c 41 76 00 62 62 6f 78 4d 61 78 58 00"],
    ),
    ("beyond the last", "2c 02 ff 7f", ["2c 02"]),
    ("read commander.enHighLevel, uint8", "2d 10 00", ["2d 10 00 00 00"]),
    ("read what there is not", "2d ff 7f", ["2d ff 7f 02"]),
    ("write it", "2e 10 00 07", ["2e 10 00 07"]),
    ("read it back", "2d 10 00", ["2d 10 00 00 07"]),
    ("write what there is not", "2e ff 7f 07", ["2e ff 7f 02"]),
    ("it has no extended type, of version 2", "2f 07 10 00", ["2f 07 10 00 02"]),
    ("it has no extended type, of version 1", "2f 02 10 00", ["2f 02 10 00 02"]),
    ("the extended type of what there is not", "2f 07 ff 7f", ["2f 07 ff 7f 02"]),
    ("its default, of version 2", "2f 08 10 00", ["2f 08 10 00 00 00"]),
    ("its default, of version 1", "2f 06 10 00", ["2f 06 10 00 00"]),
    ("store a parameter that is not persistent", "2f 03 10 00", ["2f 03 10 00 02"]),
    ("its state: not stored, and the default", "2f 04 10 00", ["2f 04 10 00 00 00"]),
    (
        "set by name",
        "2f 00 6c 65 64 00 62 69 74 6d 61 73 6b 00 08 80",
        ["2f 00 6c 65 64 00 62 69 74 6d 61 73 6b 00 00"],
    ),
    (
        "by name, of another type",
        "2f 00 6c 65 64 00 62 69 74 6d 61 73 6b 00 06 00 00 00 00",
        ["2f 00 6c 65 64 00 62 69 74 6d 61 73 6b 00 16"],
    ),
    (
        "a read-only parameter by name",
        "2f 00 63 70 75 00 66 6c 61 73 68 00 09 01 00",
        ["2f 00 63 70 75 00 66 6c 61 73 68 00 0d"],
    ),
    (
        "no such name",
        "2f 00 6e 6f 00 6f 6e 65 00 08 01",
        ["2f 00 6e 6f 00 6f 6e 65 00 02"],
    ),
)
MEMORY = (
    ("how many without a deck", "4c 01", ["4c 01 04"]),
    (
        "the first, an EEPROM of 8191 bytes",
        "4c 02 00",
        ["4c 02 00 00 ff 1f 00 00" + " 00" * 8],
    ),
    (
        "the second, trajectories in 4096 bytes",
        "4c 02 01",
        ["4c 02 01 12 00 10 00 00" + " 00" * 8],
    ),
    (
        "the third, the tester of 4096 bytes",
        "4c 02 02",
        ["4c 02 02 15 00 10 00 00" + " 00" * 8],
    ),
    (
        "the last, five sections of decks, of 0x10000000 bytes",
        "4c 02 03",
        ["4c 02 03 19 00 00 00 50" + " 00" * 8],
    ),
    ("write 4 bytes at 8", "4e 01 08 00 00 00 01 02 03 04", ["4e 01 08 00 00 00 00"]),
    ("read them", "4d 01 08 00 00 00 04", ["4d 01 08 00 00 00 00 01 02 03 04"]),
    ("write across the end", "4e 01 fe 0f 00 00 01 02 03", ["4e 01 fe 0f 00 00 05"]),
    ("read across the end", "4d 01 fe 0f 00 00 03", ["4d 01 fe 0f 00 00 05"]),
    ("read too much across the end", "4d 01 fe 0f 00 00 19", ["4d 01 fe 0f 00 00 05"]),
    (
        "the last byte of the EEPROM",
        "4d 00 fe 1f 00 00 01",
        ["4d 00 fe 1f 00 00 00 00"],
    ),
    ("beyond it", "4d 00 fe 1f 00 00 02", ["4d 00 fe 1f 00 00 05"]),
    (
        "the tester's bytes are their addresses",
        "4d 02 fe 00 00 00 03",
        ["4d 02 fe 00 00 00 00 fe ff 00"],
    ),
    (
        "the version of deck memories",
        "4d 03 00 00 00 00 02",
        ["4d 03 00 00 00 00 00 03 00"],
    ),
    ("no deck to read", "4d 03 00 00 00 10 01", ["4d 03 00 00 00 10 05"]),
    ("none to write", "4e 03 00 00 00 00 01", ["4e 03 00 00 00 00 05"]),
)
SUPERVISOR = (
    (
        "all bits: armed, arms itself, can fly, plan ended",
        "9c 0c",
        ["9c 8c 0e 02"],
    ),
    ("one of them: can fly", "9c 04", ["9c 84 01"]),
    ("one of them: flying", "9c 05", ["9c 85 00"]),
    ("no such request", "9c 20", []),
    ("arm", "9d 01 01", ["9d 81 01 01"]),
    ("arm without an argument: that of the packet before", "9d 01", ["9d 81 01 01"]),
    ("a request with more than it needs", "9c 04 77", ["9c 84 01"]),
    ("a request of nothing", "9c", []),
    ("disarm", "9d 01 00", ["9d 81 01 00"]),
    ("recover", "9d 02", ["9d 82 01 01"]),
    ("the watchdog says nothing", "9d 04", []),
    ("an emergency stop says nothing", "9d 03", []),
)
HIGH_LEVEL = (
    (
        "a take-off is echoed in three bytes, 0: done",
        "8c 07 00 00 00 00 3f 00 00 00 00 01 00 00 80 3f",
        ["8c 07 00 00 00"],
    ),
    (
        "another: it flies already",
        "8c 07 00 00 00 00 3f 00 00 00 00 01 00 00 80 3f",
        ["8c 07 00 00 01"],
    ),
    ("go_to", "8c 0c 00 01 00" + " 00" * 16 + " 00 00 80 3f", ["8c 0c 00 01 00"]),
    (
        "one for another group: nobody is meant, so all is well",
        "8c 03 02",
        ["8c 03 02 .. 00"],
    ),
    ("the group's mask", "8c 00 02", ["8c 00 02 .. 00"]),
    ("stop, for this group", "8c 03 02", ["8c 03 02 .. 00"]),
    ("define a trajectory", "8c 06 01 01 00 00 00 00 00 01", ["8c 06 01 01 00"]),
    ("one of too high a number", "8c 06 63 01 00 00 00 00 00 01", ["8c 06 63 01 08"]),
    (
        "define a trajectory behind the memory",
        "8c 06 02 01 00 00 10 00 00 01",
        ["8c 06 02 01 00"],
    ),
    (
        "define a trajectory in no memory",
        "8c 06 03 00 00 00 00 00 00 01",
        ["8c 06 03 00 00"],
    ),
    (
        "start what is not defined: nothing happens",
        "8c 0d 00 00 00 00 05 00 00 80 3f",
        ["8c 0d 00 00 00"],
    ),
    (
        "start a number that there is not",
        "8c 0d 00 00 00 00 63 00 00 80 3f",
        ["8c 0d 00 00 00"],
    ),
    (
        "a take-off to no height, NaN",
        "8c 07 00 00 00 c0 7f 00 00 00 00 01 00 00 80 3f",
        ["8c 07 00 00 00"],
    ),
    ("no such command", "8c 63", ["8c 63 .. .. 08"]),
)
LOCALIZATION = (
    ("a position says nothing", "6c" + " 00" * 12, []),
    ("a pose says nothing", "6d 08" + " 00" * 24 + " 00 00 80 3f", []),
    ("packed poses say nothing", "6d 09 e7 01 00 02 00 03 00 00 00 00 c0", []),
    ("packed positions say nothing", "6e e7 01 00 02 00 03 00", []),
    ("lighthouses are made persistent", "6d 0b 01 00 00 00", ["6d 0b 01"]),
    (
        "a packet of the local positioning is not sent on",
        "6d 02 07 01 02",
        ["6d 02 07 00"],
    ),
)
COMMANDER = (
    ("set-points say nothing", "3c" + " 00" * 14, []),
    ("nor do others", "7c 0a" + " 00" * 16, []),
    ("nor does their end", "7d 00 00 00 00 00", []),
    ("nor what nobody knows", "7c 63 01 02", []),
)
SILENT = (
    ("the console takes nothing", "0c 01", []),
    ("nor does a port that there is not", "ac 01", []),
)
ALL = {
    "link": LINK,
    "platform": PLATFORM,
    "log": LOG,
    "param": PARAM,
    "memory": MEMORY,
    "supervisor": SUPERVISOR,
    "high_level": HIGH_LEVEL,
    "localization": LOCALIZATION,
    "commander": COMMANDER,
    "silent": SILENT,
}
