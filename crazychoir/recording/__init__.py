"""Recordings of flights: MCAP files with ROS 2 messages, read back, measured and drawn."""
