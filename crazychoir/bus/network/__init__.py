"""Messages between processes and hosts over Zenoh: links, peers, access and keys."""

CERTIFICATE_DAYS = 825  # days for which a new certificate is valid
