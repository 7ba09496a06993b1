"""What the missions in agents/ need beside their laws: options, their own swarms, checks, reports, pictures."""
