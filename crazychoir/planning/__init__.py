"""Planning: from goals to smooth references."""
