"""Messages between processes and hosts over Zenoh: links, peers, access and keys."""
