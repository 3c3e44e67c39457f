"""Smooth forces and their derivatives: in closed form, along moving moment arms, or by differences of their own."""
