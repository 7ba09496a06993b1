"""What the firmware of a Crazyflie does at its link: codes, bits and times, for radios and models."""
