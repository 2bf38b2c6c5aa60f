"""Rollouts of any plant under any law: integrators, the closed loop, metrics, lanes over devices."""
