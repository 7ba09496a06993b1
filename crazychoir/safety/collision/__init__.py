"""The collision filter, between planner and controller: what is heard of the others, and the acceleration that is safe."""
