"""Constraint rows: their forces and how these change, contacts and the discrete integrator's weights included."""
