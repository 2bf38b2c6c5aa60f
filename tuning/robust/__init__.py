"""Gains for robots that are not exactly the modelled one, and compromises between figures of merit."""
