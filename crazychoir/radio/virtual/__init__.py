"""Virtual Crazyflies: a CRTP server over UDP, the behaviour of the firmware, and a simulated
body.
"""
