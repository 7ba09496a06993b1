"""Programs that connect with the certificate of a host but are no process of the swarm."""

from crazychoir.bus.network.foreign_connections import ForeignConnections


def test_a_program_more_than_processes_is_told_at_the_second_look_and_once():
    connections = ForeignConnections()
    links = [("a", "1"), ("b", "2"), ("b", "2"), ("b", "3"), (None, "4")]
    assert [connections.look(links, ["a", "b"]) for _ in range(3)] == [[], ["b"], []]


def test_a_new_connection_is_given_time_to_announce_itself():
    connections = ForeignConnections()
    assert connections.look([("b", "2")], []) == []
    assert connections.look([("b", "2")], ["b"]) == []
    assert connections.look([("b", "3")], []) == []
    assert connections.look([("b", "3")], []) == ["b"]


def test_a_token_without_its_own_connection_is_not_reported():
    connections = ForeignConnections()
    assert [connections.look([], ["a", "b"]) for _ in range(3)] == [[], [], []]
