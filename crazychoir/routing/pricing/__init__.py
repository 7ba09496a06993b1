"""Route pricing: labels, dominance and bounds."""
