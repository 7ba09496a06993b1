"""Virtual Crazyflies: a CRTP server over UDP, the firmware's behaviour, and a simulated body."""
