"""The linear algebra of the sweeps: arrays in and arrays out, compiled; no models, no problems."""
