"""Who may take part in a swarm: certificates of an authority, and what each of them may say."""

DAYS = 825
"""For which a certificate is good."""
