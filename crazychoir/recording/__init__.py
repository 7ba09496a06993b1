"""What a flight was, in a file: MCAP with ROS 2 messages, read back, measured and drawn."""
