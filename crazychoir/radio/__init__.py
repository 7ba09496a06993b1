"""Radio: real drones through cflib, and virtual Crazyflies that speak CRTP.

Only code in this room uses the firmware's units.
"""
