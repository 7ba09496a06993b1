"""Virtual Crazyflies: a server that speaks CRTP over UDP, with the firmware's behaviour and a simulated body behind it."""
