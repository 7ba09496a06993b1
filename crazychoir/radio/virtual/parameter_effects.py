"""Which parameters of a virtual drone have an effect, and the effects of a write.

The parameters of the firmware model are in `PARAMETER_PLACES`, those of the drone around it here.
All others are *inert*: they are stored and read back, and the drone says so at the first write.
"""

from collections.abc import Callable
from typing import Protocol

from crazychoir.radio.virtual.toc import TocEntry
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.parameters import PARAMETER_PLACES, RESET_ESTIMATION

DRONE_PARAMETERS: dict[str, str] = {
    "commander.enHighLevel": "none, as in the firmware: its planner is always on",
    "cppm.angPitch": "largest pitch of an emulated receiver",
    "cppm.angRoll": "largest roll of an emulated receiver",
    "cppm.ratePitch": "largest pitch rate of an emulated receiver",
    "cppm.rateRoll": "largest roll rate of an emulated receiver",
    "cppm.rateYaw": "largest yaw rate of an emulated receiver",
    "crtpsrv.echoDelay": "ms that an echo waits",
    "hlCommander.groupmask": "groups of the drone",
    "led.bitmask": "LEDs, as `crazychoir virtual state` shows them",
    "lighthouse.fwdToEstimator": "0: the estimator gets no poses of a lighthouse deck",
    "memTst.resetW": "the next write to the tester counts its errors from 0",
    "motion.disable": "the estimator gets no velocities of a flow deck",
    "pm.criticalLowVoltage": "V: the battery is critical below it",
    "pm.lowVoltage": "V: the battery is low below it",
    "supervisor.infdmp": "the console says the state of the supervisor",
    "system.assertInfo": "the console says whether an assertion has failed",
    "system.doAssert": "an assertion fails: the drone restarts, and does not fly",
    "system.storageReformat": "all stored parameters are forgotten",
    "system.storageStats": "the console says how many parameters are stored",
    "system.testLogParam": "value of the log variable sys.testLogParam",
}
"""What the parameters do that the drone around the firmware model reads, by name."""


def is_modelled(name: str) -> bool:
    """Return whether a parameter has its effect."""
    return (
        name in PARAMETER_PLACES or name in DRONE_PARAMETERS or name == RESET_ESTIMATION
    )


class StoredParameters(Protocol):
    """The parameters of a drone, as their effects use them."""

    stored: dict[str, float]
    """Values that survive a restart."""
    values: dict[str, float]
    """Values that were set since the start."""


class WriteEffects:
    """Does what a client's write of a parameter causes at once.

    onboard: model of the firmware
    parameters: parameters of the drone
    has_asserted: whether the drone has started after a failed assertion
    say: prints a text on the console
    """

    def __init__(
        self,
        onboard: Onboard,
        parameters: StoredParameters,
        has_asserted: bool,
        say: Callable[[str], None],
    ) -> None:
        self._onboard = onboard
        self._parameters = parameters
        self._has_asserted = has_asserted
        self._say = say
        self._told: set[str] = set()
        self._effects: dict[str, Callable[[], None]] = {
            "supervisor.infdmp": self._tell_supervisor,
            "system.assertInfo": self._tell_assertion,
            "system.storageReformat": self._parameters.stored.clear,
            "system.storageStats": self._tell_storage,
        }

    def apply(self, entry: TocEntry, value: float) -> None:
        """Do what a written value causes.

        The first value of an inert parameter that is not its value after a start is told.
        """
        name = entry.full
        if name in self._effects and value:
            self._effects[name]()
        if not is_modelled(name) and value != entry.boot and name not in self._told:
            self._told.add(name)
            self._say(f"PARAM: {name} is not simulated: no effect\n")

    def _tell_supervisor(self) -> None:
        info = self._onboard.info
        self._say(f"SUP: state: {self._onboard.state}\nSUP: info: 0x{info:04x}\n")
        self._parameters.values["supervisor.infdmp"] = 0.0

    def _tell_assertion(self) -> None:
        found = "an assertion has failed" if self._has_asserted else "no failed assert"
        self._say(f"SYS: {found}\n")
        self._parameters.values["system.assertInfo"] = 0.0

    def _tell_storage(self) -> None:
        self._say(f"STORAGE: {len(self._parameters.stored)} parameters\n")
        self._parameters.values["system.storageStats"] = 0.0
