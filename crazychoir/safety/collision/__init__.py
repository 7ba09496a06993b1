"""The collision filter: what is heard of the others, and the nearest acceleration with which nobody is hit."""
