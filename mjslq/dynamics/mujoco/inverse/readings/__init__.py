"""Sensors: rows of C and D, in closed form or by differences of the stage of MuJoCo's pipeline that they belong to."""
