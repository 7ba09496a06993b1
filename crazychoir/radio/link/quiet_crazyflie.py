"""cflib's object of one drone, without the traffic that cflib starts by itself."""

from collections.abc import Callable
from types import MethodType
from typing import Any

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.param import ParamTocElement
from cflib.crazyflie.toc import TocFetcher

from crazychoir.firmware.requests import LINK_CHANNELS
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.crtp import CrtpPort


def make_quiet_crazyflie(contents: TableOfContents) -> Crazyflie:
    """Return cflib's object of a drone.

    It takes its tables from the cache, and reads a parameter only on request.
    """
    cf = Crazyflie()
    cf._toc_cache = contents
    # cflib's own refresh also reads the memories of decks, and never ends if one fails.
    cf.mem.refresh = _skip_memories
    cf.remove_port_callback(CrtpPort.MEMORY, cf.mem._new_packet_cb)
    cf.param.request_update_of_all_params = _do_nothing
    cf.param.refresh_toc = MethodType(_load_parameter_table, cf.param)
    _disable_echoes(cf)
    return cf


def _skip_memories(done: Callable[[], None]) -> None:
    """Replace cflib's reading of all memories at each connection."""
    done()


def _do_nothing() -> None:
    """Replace cflib's reading of all parameters at each connection, and its thread of echoes."""


def _disable_echoes(cf: Crazyflie) -> None:
    """Keep cflib's thread of echoes from starting. Signal strength of a radio is still reported."""
    latency = cf.link_statistics.latency
    latency.start = _do_nothing
    latency.stop = _do_nothing
    cf.remove_header_callback(latency._ping_response, CrtpPort.LINK, LINK_CHANNELS.echo)


def _load_parameter_table(
    param: Any, done: Callable[[], None], contents: TableOfContents
) -> None:
    """Replace cflib's loading of the parameter table.

    cflib's own asks for each parameter, one after the other, whether it is persistent.
    """
    TocFetcher(
        param.cf, ParamTocElement, CrtpPort.PARAMETERS, param.toc, done, contents
    ).start()
