"""The flight of a drone that does nothing but obey its operator."""

from crazychoir.guidance.flights import (
    FLIGHT_LIMITS,
    FLYING_MODES,
    OBEYING_GATE,
    wait_for_command,
)
from crazychoir.guidance.guidance import COMMAND_TIMEOUT, CFGuidance
from crazychoir.guidance.member import (
    HELD_FLIGHT_PATIENCE,
    Interrupted,
    describe_state,
    wait_for_touchdown,
)
from crazychoir.safety.rules.modes import Mode


async def obey_operator(guidance: CFGuidance, at_once: bool = False) -> None:
    """Take off, hover, and obey the operator until the drone has landed.

    The operator flies the drone by the commands go-to, velocity, fly and hold. The drone also lands
    after HELD_FLIGHT_PATIENCE s without a flight of the operator.

    at_once: whether to take off without the operator's command. Else the drone waits for it on the
        ground, at most COMMAND_TIMEOUT s.
    Raises Interrupted if no command comes in time, and as `take_off` and `land` of CFGuidance.
    """
    member = guidance.member
    pilot = member.pilot
    if at_once:
        pilot.permission.start()
        await guidance.take_off()
    pilot.permission.await_operator()
    if not at_once:
        await wait_for_command(
            member, "take-off", COMMAND_TIMEOUT, lambda: not pilot.airborne
        )
    await wait_for_command(
        member, OBEYING_GATE, HELD_FLIGHT_PATIENCE, lambda: pilot.mode in FLYING_MODES
    )
    await wait_for_touchdown(pilot, FLIGHT_LIMITS.touchdown_time)
    if pilot.mode is not Mode.GROUND:
        raise Interrupted(f"drone {guidance.id}: {describe_state(pilot)}")
