"""Who is connected with the certificate of a host, and says nothing that the swarm knows."""

from crazychoir.bus.network.foreign_connections import ForeignConnections


def test_a_program_more_than_processes_is_told_at_the_second_look_and_once():
    connections = ForeignConnections()
    links = [("a", "1"), ("b", "2"), ("b", "2"), ("b", "3"), (None, "4")]
    assert [connections.look(links, ["a", "b"]) for _ in range(3)] == [[], ["b"], []]


def test_who_has_connected_and_will_say_that_it_is_there_is_given_time():
    connections = ForeignConnections()
    assert connections.look([("b", "2")], []) == []
    assert connections.look([("b", "2")], ["b"]) == []
    assert connections.look([("b", "3")], []) == []
    assert connections.look([("b", "3")], []) == ["b"]


def test_who_has_a_token_and_no_connection_of_his_own_is_nobody_to_tell_of():
    connections = ForeignConnections()
    assert [connections.look([], ["a", "b"]) for _ in range(3)] == [[], [], []]
