"""The operator's web page: a subscriber and a commander, never in the control path."""
