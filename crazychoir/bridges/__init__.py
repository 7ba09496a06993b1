"""Live views and commands of a running swarm in tools of others: Foxglove, and ROS 2."""
