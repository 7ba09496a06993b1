"""The fault campaign in virtual time: every seed is a scenario with its own faults, and invariants that hold in all."""
