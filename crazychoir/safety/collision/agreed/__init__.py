"""Agreed paths: drones with a planner on board say what they will fly and avoid what they granted."""
