"""A running swarm as an object, blocking and asynchronous."""
