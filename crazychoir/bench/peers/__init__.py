"""The programs that crazychoir is compared with, one file a peer."""
