"""Virtual Crazyflies: a server that speaks CRTP over UDP, the firmware's behaviour and a simulated body behind it."""
