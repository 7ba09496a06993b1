"""Recordings and live data in forms that ROS 2 can read."""
