"""From goals to smooth references."""
