"""The fence, the limits and the table of what a drone does when something fails."""
