"""The operator's web page: it subscribes and commands, and is never in the control path."""
