"""Sweeps: axes -> lanes -> chunks -> devices and processes -> store."""
