"""Port 0: the console of a virtual drone, on which the firmware says what it does."""

from crazychoir.firmware.supervision import SUPERVISOR_STATES
from crazychoir.radio.protocol.crtp import CRTP_FORMAT, CrtpPort, Packet
from crazychoir.simulation.onboard.onboard import Onboard

ESTIMATOR_WARNING_PAUSE = 2000
"""ms between two lines about an estimate out of bounds (estimator_kalman.c)."""
STATE_LINES = {
    SUPERVISOR_STATES.locked: "SUP: Locked, reboot required\n",
    SUPERVISOR_STATES.crashed: "SUP: Crashed, recovery required\n",
}
"""What the supervisor says in a state, on each platform."""
FALL_LINE = "SUP: free falling!\n"
"""What the supervisor says when a drone begins to fall freely, as its accelerometer shows."""
ARMING_LINE = "SUP: Ready to fly\n"
"""What the supervisor says of a drone that was armed by a program."""
DISARMING_LINE = "SUP: Disarming\n"
"""What the supervisor says when it disarms a drone that a program arms."""


class FirmwareConsole:
    """Collects the lines of the firmware, and makes packets of them.

    onboard: model of the firmware
    """

    def __init__(self, onboard: Onboard) -> None:
        self._onboard = onboard
        self._packets: list[Packet] = []
        self._state = int(onboard.record["state"])
        self._resets = int(onboard.record["resets"])
        self._warned_at = -ESTIMATOR_WARNING_PAUSE
        self._is_falling = False

    def say(self, text: str) -> None:
        """Print a text. A packet ends with its line, and no character is split between packets."""
        for line in text.splitlines(keepends=True):
            part = b""
            for character in line:
                more = character.encode()
                if len(part) + len(more) > CRTP_FORMAT.payload_size:
                    self._packets.append(Packet(CrtpPort.CONSOLE, 0, part))
                    part = b""
                part += more
            self._packets.append(Packet(CrtpPort.CONSOLE, 0, part))

    def say_start(
        self, device: str, release: str, decks: tuple[str, ...], failure: str
    ) -> None:
        """Print the lines of a start.

        device: kind of drone
        decks: names of the decks
        failure: assertion that has failed before; empty after a start by the switch
        """
        self.say("SYS: ----------------------------\n")
        self.say(f"SYS: {device} is up and running!\n")
        self.say(f"SYS: Production release {release}\n")
        self.say(f"DECK_CORE: {len(decks)} deck(s) found\n")
        for place, deck in enumerate(decks):
            self.say(f"DECK_CORE: Calling INIT on driver {deck} for deck {place}\n")
        self.say("IMU: BMI088 gyro self-test [OK]\n")
        self.say("ESTIMATOR: Using Kalman (2) estimator\n")
        self.say("CONTROLLER: Using PID (1) controller\n")
        for place in range(len(decks)):
            self.say(f"DECK_CORE: Deck {place} test [OK].\n")
        if failure:
            self.say("SYS: The system resumed after a failed assert [WARNING]\n")
            self.say(f"SYS: Assert failed: {failure}\n")
            self.say("SYS: cfAssertNormalStart [FAIL]\n")
        else:
            self.say("SYS: Self test passed!\n")

    def watch(self, now: int) -> None:
        """Print what the supervisor and the estimator say at this ms of uptime."""
        self._watch_supervisor()
        self._watch_fall()
        resets = int(self._onboard.record["resets"])
        if resets > self._resets and now - self._warned_at >= ESTIMATOR_WARNING_PAUSE:
            self._warned_at = now
            self.say("ESTKALMAN: State out of bounds, resetting\n")
        self._resets = resets

    def _watch_supervisor(self) -> None:
        before = self._state
        self._state = int(self._onboard.record["state"])
        if self._state == before:
            return
        self.say(STATE_LINES.get(self._state, ""))
        if not self._onboard.firmware.needs_arming:
            return
        if self._state == SUPERVISOR_STATES.ready:
            self.say(ARMING_LINE)
        elif self._state == SUPERVISOR_STATES.reset:
            self.say(DISARMING_LINE)

    def _watch_fall(self) -> None:
        was_falling = self._is_falling
        self._is_falling = bool(self._onboard.record["falling"])
        if self._is_falling and not was_falling:
            self.say(FALL_LINE)

    def take(self) -> list[Packet]:
        """Return the packets since the last call."""
        packets = self._packets
        self._packets = []
        return packets
