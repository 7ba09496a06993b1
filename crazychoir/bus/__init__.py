"""How messages travel: topics, codec, frames, local delivery, Zenoh, presence, commands, impairment."""
