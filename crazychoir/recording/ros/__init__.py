"""Recordings and live data in the forms that ROS 2 reads."""
