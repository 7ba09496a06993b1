"""Messages between drones, processes and hosts: topics, codec,
frames, ports, Zenoh, presence, commands, impairment.
"""
