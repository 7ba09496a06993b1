"""What a Crazyflie computes on board: estimator, commander, planner, supervisor, controllers, power distribution.

Derived anew from the firmware's equations and figures (crazyflie-firmware, August 2026), not from its code.
"""
