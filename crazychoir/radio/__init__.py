"""Radio: real drones through cflib, and virtual Crazyflies that speak CRTP. Units are the firmware's in here alone."""
