"""cflib's object without the traffic that cflib starts by itself."""

from pathlib import Path

from crazychoir.radio.link.quiet_crazyflie import make_quiet_crazyflie
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.crtp import CrtpPort


def test_nothing_is_read_at_a_connection_but_the_tables() -> None:
    contents = TableOfContents(Path("nowhere"))
    cf = make_quiet_crazyflie(contents)
    assert cf._toc_cache is contents
    done = []
    cf.mem.refresh(lambda: done.append("memories"))
    assert done == ["memories"], "cflib goes on at once"
    cf.param.request_update_of_all_params()
    cf.link_statistics.latency.start()
    ports = [callback.port for callback in cf.incoming.cb]
    assert CrtpPort.MEMORY not in ports
