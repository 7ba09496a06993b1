"""The missions that come with crazychoir, one file each."""
