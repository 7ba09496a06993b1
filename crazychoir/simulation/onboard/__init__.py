"""Firmware of a Crazyflie: estimator, commander, planner, supervisor, controllers, mixing.

Derived anew from the firmware's equations and figures (crazyflie-firmware, August 2026), not from
its code.
"""
